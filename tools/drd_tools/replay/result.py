"""Result of a replay: the poses, the configuration in force, a hash of every bit, and the output files."""

import dataclasses
import hashlib
import json
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from drd import __version__
from drd.batch.run import latest
from drd.config.keys import Config
from drd.estimation.calibration import Calibration
from drd.estimation.uncertainty import position_bound_m
from drd.samples import Pose, Reason, Validity
from drd.units import DEG_PER_RAD, S_PER_NS
from drd_tools.recordings.folder import ESTIMATES, ESTIMATES_FORM, write_table

FORMAT: Final = "drd-replay/1"
# t_ns, sequence; x, y, heading, speed, rate, their two sigmas; the covariance's six; the bound.
BITS: Final = struct.Struct("<2q14d")


class Start(NamedTuple):
    """Pose from which the estimate starts: the whole path is rotated and moved there."""

    x_m: float
    y_m: float
    heading_rad: float


ORIGIN: Final = Start(0.0, 0.0, 0.0)


@dataclass
class Replayed:
    """Result of a replay.

    `began_ns`: time at which the dead reckoning began, with a pose of zero by definition (None: not known).
    `zero_ns`: the poses' time at which the recording's `time_s` is 0. `samples` and `counters` are by part and name.
    `inputs`: SHA-256 of each file that was read. `notes`: sentences for the summary. `set_ns`: times of the first pose
    after each one set from outside, and after each reset.
    """

    source: Path
    poses: list[Pose]
    config: Config
    calibration: Calibration | None
    zero_ns: int = 0
    began_ns: int | None = None
    samples: dict[str, int] = field(default_factory=dict)
    counters: dict[str, dict[str, int]] = field(default_factory=dict)
    inputs: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    set_ns: list[int] = field(default_factory=list)

    @property
    def duration_s(self) -> float:
        """Time from the start of dead reckoning, or from the first pose, to the last one."""
        if not self.poses:
            return 0.0
        return (self.poses[-1].t_ns - (self.began_ns or self.poses[0].t_ns)) * S_PER_NS

    def digest(self) -> str:
        """Digest of all poses, see `digest`."""
        return digest(self.poses)


def digest(poses: Sequence[Pose]) -> str:
    """Compute the SHA-256 in hex over all bits of all poses, which differs if any bit differs.

    Per pose: BITS, little-endian, then one line of UTF-8 text: the validity and for each reason source, text and
    since_ns, all separated by U+001F and ended by a line feed.
    """
    sha = hashlib.sha256()
    lines: dict[tuple[str, tuple[Reason, ...]], bytes] = {}  # thousands of poses share a few
    for p in poses:
        key = (p.validity.value, p.reasons)
        line = lines.get(key)
        if line is None:
            texts = [p.validity.value, *(str(value) for reason in p.reasons for value in reason)]
            line = lines[key] = ("\x1f".join(texts) + "\n").encode()
        sha.update(packed(p) + line)
    return sha.hexdigest()


def packed(p: Pose) -> bytes:
    """Pack all numbers of a pose, bit for bit."""
    rates = (p.speed_m_s, p.rate_rad_s, p.speed_sigma_m_s, p.rate_sigma_rad_s)
    return BITS.pack(p.t_ns, p.sequence, p.x_m, p.y_m, p.heading_rad, *rates, *p.covariance, p.position_bound_m)


def table(replayed: Replayed, start: Start = ORIGIN) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The poses as numbers, shape (n, 12): time_s, x_m, y_m, heading_rad, the covariance, placed at `start`, the
    position's 99 % bound in m, and 1 if the pose is valid.

    The first row is `start` itself, at `began_ns`, if that is known and before the first pose. Position and
    covariance rotate with the start, as the filter does not depend on the direction of x.
    """
    zero, began, poses = replayed.zero_ns, replayed.began_ns, latest(replayed.poses)
    # A generator: a list of tuples would take 270 MB more for ten hours.
    numbers = (
        (
            *((p.t_ns - zero) * S_PER_NS, p.x_m, p.y_m, p.heading_rad, *p.covariance, p.position_bound_m),
            p.validity is Validity.VALID,
        )
        for p in poses
    )
    rows = np.fromiter(numbers, np.dtype((float, len(ESTIMATES))), len(poses))
    if began is not None and poses and began < poses[0].t_ns:
        i = replayed.config.estimation.initial
        xx, hh = i.position_m**2, math.radians(i.heading_deg) ** 2
        covariance = xx, 0.0, 0.0, xx, 0.0, hh
        first = ((began - zero) * S_PER_NS, 0.0, 0.0, 0.0, *covariance, position_bound_m(covariance), 0.0)
        rows = np.concatenate([[first], rows])
    time_s, x, y, heading, xx_, xy, xh, yy, yh, hh_, bound, valid = rows.T
    c, s = math.cos(start.heading_rad), math.sin(start.heading_rad)
    return np.column_stack(
        [
            time_s,
            start.x_m + c * x - s * y,
            start.y_m + s * x + c * y,
            start.heading_rad + heading,
            c * c * xx_ - 2.0 * c * s * xy + s * s * yy,
            c * s * (xx_ - yy) + (c * c - s * s) * xy,
            c * xh - s * yh,
            s * s * xx_ + 2.0 * c * s * xy + c * c * yy,
            s * xh + c * yh,
            hh_,
            bound,
            valid,
        ]
    )


def write_poses(file: Path, replayed: Replayed, start: Start = ORIGIN, extra: dict[str, Any] | None = None) -> Path:
    """Write `file` (CSV with ESTIMATES) and beside it the provenance, as JSON; return the latter's path.

    Raises OSError. `extra` is added to the JSON.
    """
    rows = table(replayed, start)
    rows[:, 3] *= DEG_PER_RAD
    write_table(file, ESTIMATES, rows, ESTIMATES_FORM)
    beside = file.with_suffix(".json")
    beside.write_text(json.dumps(provenance(replayed, start) | (extra or {}), indent=1) + "\n", encoding="utf-8")
    return beside


def provenance(replayed: Replayed, start: Start = ORIGIN) -> dict[str, Any]:
    """Provenance of the poses, in plain types for JSON: digest, inputs, configuration in force, counters."""
    calibration = replayed.calibration
    return {
        "format": FORMAT,
        "drd": __version__,
        "recording": str(replayed.source),
        "sha256": replayed.inputs,
        "digest": replayed.digest(),
        "poses": len(replayed.poses),
        "duration_s": replayed.duration_s,
        "start": {"x_m": start.x_m, "y_m": start.y_m, "heading_deg": start.heading_rad * DEG_PER_RAD},
        "samples": replayed.samples,
        "counters": replayed.counters,
        "notes": replayed.notes,
        "config": dataclasses.asdict(replayed.config),
        "calibration": dataclasses.asdict(calibration) if calibration is not None else None,
    }
