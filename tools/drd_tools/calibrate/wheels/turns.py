"""Turns of two sensors over the same short windows, which determine the lag of one and the tread. (56)"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array, cumulative
from drd.batch.logs import FogLog
from drd_tools import robust
from drd_tools.calibrate.wheels.fit import HUBER
from drd_tools.recordings.folder import Recording

# Length of the windows: longer than the 0.25 to 0.5 s for which slow drives hold their speeds.
WINDOW_S: Final = 0.8
# Not a multiple of a usual sampling period, so that rows fall on all phases between the interpolated samples.
STEP_S: Final = 0.097
# Range of lags searched. The daemon's own key ends at 1 s; no gyro's filter delays by half a second.
EARLIEST_S, LATEST_S = -0.5, 1.0
# Rows are used within this time of motion, since the start and the end of a turn determine the lag.
NEAR_S: Final = 1.5
MOVED_TREADS: Final = 0.01
# A log with longer steps does not show when a turn begins.
LONGEST_STEP_S: Final = 0.4
# Blocks of rows whose scores count as independent: longer than a typical turn.
BLOCK_S: Final = 10.0
FEWEST_ROWS: Final = 100  # 10 s of motion
# Turns between the fixes of a sparse reference: over longer gaps the gyro's drift exceeds the effect of a lag.
FEWEST_FIXES: Final = 20
LONGEST_GAP_S: Final = 10.0
LEAST_SIGMA_RAD: Final = 1e-6  # rounding; a recording without errors would have infinite weight
DERIVATIVE_S: Final = 0.01


@dataclass
class Turns:
    """Turns of wheels or a reference, and those of another sensor, in one recording.

    Angles and travel over tread, (n,); angle of the other sensor; the times `at_s` (m,) at the middle of windows of
    `half_s` to each side, over which turns are compared; and weights.
    """

    name: str
    time_s: Array
    turn: Array
    travel: Array
    other_s: Array
    other: Array
    at_s: Array
    weights: Array
    half_s: float | Array = 0.5 * WINDOW_S
    sigma: float = 1.0

    def columns(self, lag_s: float | Array) -> tuple[Array, Array]:
        """Turns (m,), and their regressors (m, 3): those of the other sensor, travel, and time."""
        X = [
            over(self.other_s, self.other, self.at_s - lag_s, self.half_s),
            over(self.time_s, self.travel, self.at_s, self.half_s),
            np.zeros_like(self.at_s) + 2.0 * self.half_s,
        ]
        return over(self.time_s, self.turn, self.at_s, self.half_s), np.column_stack(X)

    def regress(self, lag_s: float | Array) -> tuple[Array, Array, Array, float]:
        """Residual, derivative of the model by the lag, the same from the wheels, and ratio of wheels' to other turn.

        The first three are orthogonal to the regressors.
        """
        (y, X), root = self.columns(lag_s), np.sqrt(self.weights)[:, None]
        slope = _slope(self.other_s, self.other, self.at_s - lag_s, self.half_s)
        columns = np.column_stack([y, slope, _slope(self.time_s, self.turn, self.at_s, self.half_s)])
        solved = np.linalg.lstsq(X * root, columns * root, rcond=None)[0]
        residual, slope, by_wheels = (columns - X @ solved).T
        scale = float(solved[0, 0])
        return residual, -scale * slope, -by_wheels, scale

    def reweigh(self, residual: Array) -> None:
        """Set the noise from the residuals' robust deviation, and Huber's weights against slip and jumps."""
        self.sigma = max(LEAST_SIGMA_RAD, robust.deviation(residual, 0.0))
        self.weights = np.minimum(1.0, HUBER * self.sigma / np.maximum(np.abs(residual), 1e-12))

    @property
    def noise_square(self) -> float:
        """Variance of a row's turn times the number of rows that overlap, since their turns are correlated."""
        return self.sigma**2 * float(np.mean(2.0 * self.half_s) / np.median(np.diff(self.at_s)))

    def by_block(self, scores: Array) -> Array:
        """Sums of scores (m, ...) over blocks of BLOCK_S, (b, ...)."""
        first = np.flatnonzero(np.diff(self.at_s // BLOCK_S, prepend=-1.0))
        return np.asarray(np.add.reduceat(scores, first, axis=0))


def of_wheels(recording: Recording, against: str) -> Turns | None:
    """Turns of wheels and other sensor; None without that sensor, with little motion, or with rows too far apart."""
    fog, reference = recording.fog, recording.reference
    if against == "gyro" and fog is not None:
        other_s, other = fog.time_s, _angle(fog)
    elif against == "reference" and reference is not None:
        other_s, other = reference.time_s, reference.heading_rad
    else:
        return None
    left, right = recording.wheel_angles_rad()
    time_s, per_tread = recording.encoders.time_s, recording.nominal.wheel_radius_m / recording.nominal.tread_m
    turn, travel = (right - left) * per_tread, 0.5 * (right + left) * per_tread
    moved = cumulative(np.maximum(np.abs(np.diff(left)), np.abs(np.diff(right)))) * per_tread
    return _compared(recording.name, time_s, turn, travel, moved, other_s, other)


def of_reference(recording: Recording) -> Turns | None:
    """Turns of reference and gyro; None without one of them, or if rows are too far apart."""
    fog, reference = recording.fog, recording.reference
    if fog is None or reference is None:
        return None
    turn = reference.time_s, reference.heading_rad
    return _compared(recording.name, *turn, np.zeros_like(turn[0]), turn[1], fog.time_s, _angle(fog))


def between_fixes(recording: Recording) -> Turns | None:
    """Turns from each fix of a sparse reference to the next; None if they are few or far apart."""
    fog, reference = recording.fog, recording.reference
    if fog is None or reference is None:
        return None
    time_s, other_s = reference.time_s, fog.time_s
    at_s, half_s = 0.5 * (time_s[1:] + time_s[:-1]), 0.5 * np.diff(time_s)
    known = (at_s - half_s - LATEST_S > other_s[0]) & (at_s + half_s - EARLIEST_S < other_s[-1])
    known &= (half_s > 0.5 * LONGEST_STEP_S) & (half_s < 0.5 * LONGEST_GAP_S) & _is_dense(other_s, at_s, half_s)
    if known.sum() < FEWEST_FIXES:
        return None
    turn, still = reference.heading_rad, np.zeros_like(time_s)
    at_s, half_s = at_s[known], half_s[known]
    return Turns(recording.name, time_s, turn, still, other_s, _angle(fog), at_s, np.ones_like(at_s), half_s)


def _angle(fog: FogLog) -> Array:
    """Integral of a gyro's readings, rad."""
    return np.asarray(np.cumsum(fog.rate_rad_s * np.diff(fog.time_s, prepend=fog.time_s[0])))


def _compared(
    name: str, time_s: Array, turn: Array, travel: Array, moved: Array, other_s: Array, other: Array
) -> Turns | None:
    """Select rows at which the angles can be compared: dense, and near motion."""
    if not len(time_s) or not len(other_s):
        return None
    half_s = 0.5 * WINDOW_S
    first_s, last_s = max(time_s[0], other_s[0] + LATEST_S) + half_s, min(time_s[-1], other_s[-1] + EARLIEST_S) - half_s
    at_s = np.arange(first_s, last_s, STEP_S)
    near = np.abs(np.interp(at_s + NEAR_S, time_s, moved) - np.interp(at_s - NEAR_S, time_s, moved)) > MOVED_TREADS
    at_s = at_s[near & _is_dense(time_s, at_s) & _is_dense(other_s, at_s)]
    if len(at_s) < FEWEST_ROWS:
        return None
    return Turns(name, time_s, turn, travel, other_s, other, at_s, np.ones_like(at_s))


def over(time_s: Array, angle: Array, at_s: Array, half_s: float | Array) -> Array:
    """Change of the angle over the window around each time."""
    return np.asarray(np.interp(at_s + half_s, time_s, angle) - np.interp(at_s - half_s, time_s, angle))


def _slope(time_s: Array, angle: Array, at_s: Array, half_s: float | Array) -> Array:
    """Derivative of `over` by time."""
    ahead, behind = (over(time_s, angle, at_s + shift_s, half_s) for shift_s in (DERIVATIVE_S, -DERIVATIVE_S))
    return np.asarray((ahead - behind) / (2.0 * DERIVATIVE_S))


def _is_dense(time_s: Array, at_s: Array, half_s: float | Array = 0.5 * WINDOW_S) -> npt.NDArray[np.bool_]:
    """Whether the log has no long step within the reach of each row, over all lags."""
    long = cumulative(np.diff(time_s) > LONGEST_STEP_S)
    reach_s = LATEST_S + half_s
    before, after = (np.searchsorted(time_s, at_s + shift_s) for shift_s in (-reach_s, reach_s))
    dense: npt.NDArray[np.bool_] = long[np.minimum(after, len(time_s) - 1)] == long[np.maximum(before - 1, 0)]
    return dense
