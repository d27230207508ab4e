"""Count of whole turns between sparse rows of a reference, which only the wheels determine."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from drd_tools.calibrate.wheels.drive import Drive, counted
from drd_tools.calibrate.wheels.fit import NAMES, new_part, setting_out, solve

TOLD_NATS: Final = 5.0  # by which a count of turns must be likelier than its rivals: 150 to 1
SAME_TREAD: Final = 0.1  # counts of treads less different than this differ only in a row or two
TREADS: Final = (1.0, *np.geomspace(0.5, 2.5, 24))  # over the nominal: close enough that one of them is a good start


def with_turns(drives: Sequence[Drive]) -> list[Drive]:
    """Count whole turns between sparse rows in one robot's drives, with the tread of the smallest residuals; with the
    nominal tread if another fits nearly as well. (53)
    """
    distinct: dict[bytes, list[Drive]] = {}
    as_given = np.concatenate([drive.reference_heading_rad for drive in drives])
    for tread in TREADS:
        tried = [counted(drive, tread * drive.nominal.tread_m) for drive in drives]
        more = np.concatenate([drive.reference_heading_rad for drive in tried]) - as_given
        distinct.setdefault(np.round(more / math.tau).tobytes(), tried)
    by_nominal, *others = distinct.values()
    if not others:
        return by_nominal
    found = []
    for tried in (by_nominal, *others):
        parts = [new_part(drive) for drive in tried]
        try:
            shared = solve(parts, np.ones(len(NAMES), bool), setting_out(tried))
        except np.linalg.LinAlgError:  # headings so wrong that the normal equations are singular
            continue
        found.append((sum(part.cost for part in parts), 1.0 + float(shared[2]), tried))
    least, tread, best = min(found, key=lambda f: f[0], default=(math.inf, 1.0, by_nominal))
    rivals = (cost for cost, other, _ in found if abs(other / tread - 1.0) > SAME_TREAD)
    return best if least < min(rivals, default=math.inf) - TOLD_NATS else by_nominal
