"""Results of the wheel calibration from recordings."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drd.arrays import Array
from drd.config.keys import Encoders, Fog
from drd_tools.calibrate.wheels import words
from drd_tools.calibrate.wheels.drive import Drive
from drd_tools.calibrate.wheels.fit import WheelFit, fit_wheels
from drd_tools.calibrate.wheels.heldout import HeldOut, compare, leave_one_out
from drd_tools.calibrate.wheels.lag import Lag, find_lag
from drd_tools.calibrate.wheels.rest import Rest, at_rest
from drd_tools.calibrate.wheels.spread import wheel_spread
from drd_tools.recordings.folder import Recording


@dataclass(frozen=True)
class Found:
    """The fit of `drives`, and its performance on held-out drives.

    `apart`: spread of left radius, right radius and tread between the drives, see `wheel_spread`. `other`: a fit of
    the held-out drives `tests` alone, if there are any. `lag` and `rest`: see there. `notes`: sentences on what is
    not determined, `doubts`: on reasons to doubt the fit.
    """

    drives: Sequence[Drive]
    tests: Sequence[Drive]
    fit: WheelFit
    apart: tuple[float, ...]
    other: WheelFit | None
    lag: Lag | None
    rest: Rest | None
    figures: Sequence[HeldOut]
    wheels_hz: float
    gyro_hz: float
    notes: Sequence[str]
    doubts: Sequence[str]


def find(
    recordings: Sequence[Recording],
    drives: Sequence[Drive],
    tests: Sequence[Drive],
    fit: WheelFit,
    *,
    judged: bool = True,
) -> Found:
    """Estimate spread, lag and standstill noise from `recordings`, whose drives were fitted, and test the fit.

    It is tested on `tests`; without them, if `judged`, by leaving out each drive in turn, which takes long for many.
    """
    figures = [compare(drive, fit) for drive in tests] if tests else leave_one_out(drives, fit) if judged else []
    other = fit_wheels(tests) if tests else None
    lag, rest = find_lag(recordings), at_rest(recordings)
    gyros = [recording.fog.time_s for recording in recordings if recording.fog is not None]
    return Found(
        drives,
        tests,
        fit,
        wheel_spread(drives, fit),
        other,
        lag,
        rest,
        figures,
        _rate_hz([recording.encoders.time_s for recording in recordings], Encoders().rate_hz),
        _rate_hz(gyros, Fog().rate_hz),
        [*words.not_determined(fit, drives), *words.lag_sentences(lag), *words.rest_sentences(rest)],
        words.warnings(fit, drives) + words.held_out_warnings(fit, drives, other, tests, figures),
    )


def _rate_hz(times_s: Sequence[Array], default_hz: float) -> float:
    """Rows per second in the slowest of the logs."""
    steps_s = [float(np.median(np.diff(time_s))) for time_s in times_s if len(time_s) > 1]
    return 1.0 / max(steps_s) if steps_s else default_hz
