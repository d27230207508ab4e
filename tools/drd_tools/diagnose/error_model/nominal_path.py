"""The path around which errors are linearised: the best estimate from fixes and sensors."""

from typing import Final

import numpy as np
from scipy.ndimage import maximum_filter1d

from drd.arrays import Array, cumulative
from drd_tools.diagnose.error_model.linear import Linear
from drd_tools.diagnose.error_model.path import Path, dead_reckon
from drd_tools.diagnose.observe.evidence import Evidence
from drd_tools.recordings.folder import wrapped

ROUNDS: Final = 2  # the second linearises around a path that is already bent to the fixes
DRIFT_S: Final = 10.0  # short enough for a linear drift of what warms up, long enough for a median
SLOWLY_RAD: Final = 0.5  # between fixes; of headings without meaning, one in six changes by less


def follow(e: Evidence) -> Path:
    """Dead-reckon with the measured constants, then smooth the path to the fixes, trusting the sensors less than their
    datasheets do.
    """
    # A tread 70 % off makes half a turn too much in a few seconds without gyro: no fix tells it from half too little.
    turn = e.apart_m / (e.tread_m * e.robot.tread)
    if e.gyro_rad is not None:
        known = e.still & (e.time_s < e.time_s[0] + e.standstill_s)
        bias = float(e.gyro_rad[known].sum() / e.step_s[known].sum()) if known.any() else 0.0
        turn = np.where(e.gyroless, turn, e.gyro_rad - bias * e.step_s)
        turn = turn + _drift(e, turn)
    path = dead_reckon(turn, 0.5 * (e.left_m + e.right_m), e.fix[0] if len(e.fix) else np.zeros(3))
    for _ in range(ROUNDS if len(e.fix) else 0):
        path = inflated_model(e, path).smoothed()
    return path


def _drift(e: Evidence, turn_rad: Array) -> Array:
    """Slow error of the gyro's turns, (n,), from the fixes: nothing is linear around a path half a turn off."""
    if not len(e.fix):
        return np.zeros(len(turn_rad))
    heading = e.fix[0, 2] + cumulative(turn_rad)
    off = _unwrapped(e.fix[:, 2] - np.interp(e.fix_time_s, e.edges_s, heading))
    first = np.flatnonzero(np.diff(e.fix_time_s // DRIFT_S, prepend=-np.inf))
    times_s, medians = ([np.median(part) for part in np.split(x, first[1:])] for x in (e.fix_time_s, off))
    return np.diff(np.interp(e.edges_s, times_s, medians))


def _unwrapped(off_rad: Array) -> Array:
    """Errors of headings, (m,), within half a turn, and beyond it where they change slowly.

    A leap by nearly a turn beside other leaps is no drift: such headings are wrong.
    """
    off_rad = wrapped(off_rad)
    leaps = np.diff(off_rad)
    turns = np.round(leaps / (2.0 * np.pi))
    is_slow = maximum_filter1d(np.abs(leaps - 2.0 * np.pi * turns), 3) < SLOWLY_RAD if len(leaps) else turns
    return off_rad - 2.0 * np.pi * cumulative(turns * is_slow)


def inflated_model(e: Evidence, path: Path, like: Linear | None = None) -> Linear:
    """Linear model with inflated noise, to bend a path to the fixes; `like`: a model whose gains are reused if near.

    With gains of another path the smoothed path is close to the best but not exact: compare only those of `follow`.
    """
    return Linear(e, path, e.datasheet.inflated(), like=like)
