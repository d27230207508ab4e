"""How late the wheels are, against the gyro or, where there is none, against the reference. (56)"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.batch.logs import FogLog
from drd_tools.calibrate.wheels.fit import HUBER, MANY_RECORDINGS
from drd_tools.calibrate.wheels.spread import spread
from drd_tools.recordings.folder import Recording

# Turns are compared over so long: more than the 0.25 to 0.5 s for which slow drives hold their speeds.
WINDOW_S: Final = 0.8
# No multiple of a usual sampling period: rows fall on all phases of the samples, between which is interpolated.
STEP_S: Final = 0.097
# Lags that are looked at. The daemon's own key ends at 1 s; no gyro's filter delays by half a second.
EARLIEST_S, LATEST_S = -0.5, 1.0
GRID_S: Final = 0.05
# Rows count while the wheels move within so long: the start and the end of a turn tell the lag.
NEAR_S: Final = 1.5
MOVED_TREADS: Final = 0.01
# A log with longer steps does not show when a turn begins.
LONGEST_STEP_S: Final = 0.4
# Blocks of rows whose scores count as independent: longer than a typical turn.
BLOCK_S: Final = 10.0
# A lag that is less sure is not determined: at 1 rad/s it is 3 deg.
LIMIT_S: Final = 0.05
CLEARLY: Final = 2.0
FEWEST_ROWS: Final = 100  # 10 s of motion
LEAST_SIGMA_RAD: Final = 1e-6  # rounding; an errorless recording would have infinite weight
# A value that lasts for so many rows is held; new values each row jitter by less.
HELD_ROWS: Final = 1.5
# A speed that stays for longer is constant, as simulated ones are: no drive is that slow.
LONGEST_HOLD_S: Final = 1.0
DERIVATIVE_S: Final = 0.01
# By how much the lag of a reference, and of a skid-steer robot's wheels, changes in a drive, deviations: lidar
# odometry's by 0.04 to 0.3 s beside a gyro, the wheels' by 0.02 to 0.05 s.
REFERENCE_WANDER_S, WHEELS_WANDER_S = 0.1, 0.03
# Growths that are looked at: a gyro's clock may be 3 % off; at the drive's end their lags are END_GRID_S apart.
MOST_GROWTH: Final = 0.05
END_GRID_S: Final = 0.2
SOME_ROWS: Final = 500
MAX_STEPS: Final = 25
CONVERGED_S: Final = 1e-5


@dataclass(frozen=True)
class Lag:
    """Delay of the wheels behind the gyro, or behind the reference.

    `spread_s`: standard deviation from recording to recording; nan for a single one. `hold_s`: for how long the drive
    holds a wheel speed, 0 where it does not. `each`: lag by recording. `determined`: its sigma is small enough.
    """

    against: str
    lag_s: float
    sigma_s: float
    spread_s: float
    hold_s: float
    each: dict[str, float] = field(default_factory=dict)

    @property
    def determined(self) -> bool:
        """Whether the recordings tell it."""
        return self.sigma_s <= LIMIT_S and EARLIEST_S < self.lag_s < LATEST_S

    @property
    def applies(self) -> bool:
        """Whether the next drive should be rid of it.

        Against a gyro always. A reference has a delay of its own, which may differ from drive to drive: there the
        wheels must be later by clearly more than the lag is unsure and differs.
        """
        return self.determined and (self.against == "gyro" or self.lag_s > CLEARLY * self.next_s)

    @property
    def next_s(self) -> float:
        """Standard deviation of the next drive's lag."""
        return math.hypot(self.sigma_s, 0.0 if math.isnan(self.spread_s) else self.spread_s)

    @property
    def timing_s(self) -> float:
        """Standard deviation of one reading's lag: sigma, spread, and where in its hold it was read."""
        return math.hypot(self.next_s, self.hold_s / math.sqrt(12.0))


@dataclass
class _Part:
    """One recording: angles of wheels, travel over tread, and of gyro or reference; the rows that are compared."""

    name: str
    time_s: Array
    turn: Array
    travel: Array
    other_s: Array
    other: Array
    at_s: Array
    weights: Array
    sigma: float = 1.0

    def regress(self, lag_s: float | Array) -> tuple[Array, Array, Array, float]:
        """Residual, slope of the model over the lag, the same slope by the wheels, and wheels' turn per other turn.

        What the other regressors explain is taken off the first three.
        """
        wheels = (self.time_s, self.turn, self.at_s)
        y, y_slope = _over(*wheels), _slope(*wheels)
        other = (self.other_s, self.other, self.at_s - lag_s)
        X = np.column_stack([_over(*other), _over(self.time_s, self.travel, self.at_s), np.ones_like(y)])
        columns, root = np.column_stack([y, _slope(*other), y_slope]), np.sqrt(self.weights)[:, None]
        solved = np.linalg.lstsq(X * root, columns * root, rcond=None)[0]
        residual, slope, by_wheels = (columns - X @ solved).T
        scale = float(solved[0, 0])
        return residual, -scale * slope, -by_wheels, scale

    def reweigh(self, residual: Array) -> None:
        """Set the noise by the middle of the residuals, and Huber's weights against slip and jumps."""
        self.sigma = max(LEAST_SIGMA_RAD, 1.4826 * float(np.median(np.abs(residual))))
        self.weights = np.minimum(1.0, HUBER * self.sigma / np.maximum(np.abs(residual), 1e-12))


def find_lag(recordings: Sequence[Recording]) -> Lag | None:
    """The lag that all recordings share; None where none has rows that are dense enough."""
    against = "gyro" if any(recording.fog is not None for recording in recordings) else "reference"
    made = (_part(recording, against) for recording in recordings)
    hold_s = float(np.median([held_s(recording) for recording in recordings]))
    return _found(against, [part for part in made if part is not None], hold_s)


def reference_lag(recording: Recording) -> Lag | None:
    """Delay of the reference's headings behind the gyro; None without one, or where rows are too far apart."""
    part = _reference_part(recording)
    return None if part is None else _found("gyro", [part], 0.0)


class Drift(NamedTuple):
    """Lag at time 0, s, and by how much it grows, s/s; `sigma`: standard deviation of that growth."""

    lag_s: float
    growth: float
    sigma: float

    @property
    def begins_usual(self) -> bool:
        """Whether the lag at time 0 is one that sensors have: of a clock that ran off before that it is not."""
        return EARLIEST_S < self.lag_s < LATEST_S


def find_drift(recording: Recording, against: str) -> Drift | None:
    """Fit how the wheels' lag behind gyro or reference grows in a recording; None where the rows do not tell."""
    return _drift(_part(recording, against), MOST_GROWTH if against == "gyro" else 0.0)


def reference_drift(recording: Recording) -> Drift | None:
    """Fit how the reference's lag behind the gyro grows; None without one, or where the rows do not tell."""
    return _drift(_reference_part(recording), MOST_GROWTH)


def _drift(part: _Part | None, most: float) -> Drift | None:
    if part is None:
        return None
    x = _likeliest_growth(part, most)
    for _ in range(MAX_STEPS):
        late_s = x[0] + x[1] * part.at_s
        part.reweigh(part.regress(late_s)[0])
        residual, slope, by_wheels, _ = part.regress(late_s)
        # The wheels' own slope as the instrument: the other's noise is not in it.
        S, Z = (np.column_stack([column, column * part.at_s]) for column in (slope, by_wheels))
        try:
            inverse = np.linalg.inv((Z * part.weights[:, None]).T @ S)
        except np.linalg.LinAlgError:
            return None
        score = Z * (part.weights * residual)[:, None]
        move = inverse @ score.sum(axis=0)
        x = x + move
        if np.abs(move * [1.0, part.at_s[-1]]).max() < CONVERGED_S:
            break
    blocks = np.add.reduceat(score, np.flatnonzero(np.diff(part.at_s // BLOCK_S, prepend=-1.0)), axis=0)
    covariance = inverse @ (blocks.T @ blocks) @ inverse.T
    sigma = math.sqrt(max(float(covariance[1, 1]), 0.0))
    return Drift(float(x[0]), float(x[1]), sigma) if np.isfinite(x).all() else None


def _likeliest_growth(part: _Part, most: float) -> Array:
    """Lag at time 0, s, and its growth, up to `most` s/s, (2,), from which a fit sets out."""
    at_s = part.at_s[:: max(1, len(part.at_s) // SOME_ROWS)]
    turn, since_s = _over(part.time_s, part.turn, at_s), at_s - at_s[0]
    turn -= turn.mean()

    def alike(late: tuple[float, float]) -> float:
        other = _over(part.other_s, part.other, at_s - late[0] - late[1] * since_s)
        other -= other.mean()
        return float(turn @ other) / max(float(np.linalg.norm(turn) * np.linalg.norm(other)), LEAST_SIGMA_RAD**2)

    step = END_GRID_S / float(since_s[-1])
    lags = np.arange(EARLIEST_S, LATEST_S + 0.5 * END_GRID_S, END_GRID_S if most else GRID_S).tolist()
    growths = (step * np.arange(-round(most / step), round(most / step) + 1)).tolist()
    lag_s, growth = max(((lag_s, growth) for lag_s in lags for growth in growths), key=alike)
    return np.array([lag_s - growth * at_s[0], growth])


def _found(against: str, parts: Sequence[_Part], hold_s: float) -> Lag | None:
    if not parts:
        return None
    lag_s = _best_of_grid(parts)
    for _ in range(MAX_STEPS):
        found = [part.regress(lag_s) for part in parts]
        for part, (residual, *_) in zip(parts, found, strict=True):
            part.reweigh(residual)
        scores = [_scores(part, *part.regress(lag_s)[:3]) for part in parts]
        information = sum(of[0] for of in scores)
        move_s = sum(float(of[1].sum()) for of in scores) / information if information > 0.0 else 0.0
        lag_s = min(max(lag_s + move_s, EARLIEST_S), LATEST_S)
        if abs(move_s) < CONVERGED_S:
            break
    if information <= 0.0 or min(scale for *_, scale in found) <= 0.0:
        return Lag(against, lag_s, math.inf, math.nan, hold_s)
    return _result(against, parts, scores, lag_s, hold_s)


def _result(
    against: str, parts: Sequence[_Part], scores: Sequence[tuple[float, Array]], lag_s: float, hold_s: float
) -> Lag:
    information = sum(of[0] for of in scores)
    clusters = [np.concatenate([of[1] for of in scores])]
    if len(parts) >= MANY_RECORDINGS:
        clusters.append(np.array([of[1].sum() for of in scores]))
    sigma_s = max(math.sqrt(_scatter(cluster)) / information for cluster in clusters)
    informative = [(part, *of) for part, of in zip(parts, scores, strict=True) if of[0] > 0.0 and len(of[1]) > 1]
    each = np.array([lag_s + by_block.sum() / own for _, own, by_block in informative])
    variances = np.array([_scatter(by_block) / own**2 for _, own, by_block in informative])
    names = {part.name: float(own_s) for (part, *_), own_s in zip(informative, each, strict=True)}
    return Lag(against, lag_s, sigma_s, spread(each, variances), hold_s, names)


def _part(recording: Recording, against: str) -> _Part | None:
    """The recording's curves; None where it has no such sensor, hardly moves, or has rows too far apart."""
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
    moved = np.concatenate([[0.0], np.cumsum(np.maximum(np.abs(np.diff(left)), np.abs(np.diff(right))))]) * per_tread
    return _compared(recording.name, time_s, turn, travel, moved, other_s, other)


def _reference_part(recording: Recording) -> _Part | None:
    """The curves of reference and gyro; None without one of them, or where rows are too far apart."""
    fog, reference = recording.fog, recording.reference
    if fog is None or reference is None:
        return None
    turn = reference.time_s, reference.heading_rad
    return _compared(recording.name, *turn, np.zeros_like(turn[0]), turn[1], fog.time_s, _angle(fog))


def _angle(fog: FogLog) -> Array:
    """Sum of a gyro's readings, rad."""
    return np.asarray(np.cumsum(fog.rate_rad_s * np.diff(fog.time_s, prepend=fog.time_s[0])))


def _compared(
    name: str, time_s: Array, turn: Array, travel: Array, moved: Array, other_s: Array, other: Array
) -> _Part | None:
    """Rows in which one angle can be compared with another: dense, and near motion."""
    half_s = 0.5 * WINDOW_S
    first_s, last_s = max(time_s[0], other_s[0] + LATEST_S) + half_s, min(time_s[-1], other_s[-1] + EARLIEST_S) - half_s
    at_s = np.arange(first_s, last_s, STEP_S)
    near = np.abs(np.interp(at_s + NEAR_S, time_s, moved) - np.interp(at_s - NEAR_S, time_s, moved)) > MOVED_TREADS
    at_s = at_s[near & _is_dense(time_s, at_s) & _is_dense(other_s, at_s)]
    if len(at_s) < FEWEST_ROWS:
        return None
    return _Part(name, time_s, turn, travel, other_s, other, at_s, np.ones_like(at_s))


def _over(time_s: Array, angle: Array, at_s: Array) -> Array:
    """Change of the angle over the window around each time."""
    half_s = 0.5 * WINDOW_S
    return np.asarray(np.interp(at_s + half_s, time_s, angle) - np.interp(at_s - half_s, time_s, angle))


def _slope(time_s: Array, angle: Array, at_s: Array) -> Array:
    """Derivative of `_over` in time."""
    ahead, behind = (_over(time_s, angle, at_s + shift_s) for shift_s in (DERIVATIVE_S, -DERIVATIVE_S))
    return np.asarray((ahead - behind) / (2.0 * DERIVATIVE_S))


def _is_dense(time_s: Array, at_s: Array) -> npt.NDArray[np.bool_]:
    """Whether the log has no long step within the times that a row may look at."""
    long = np.concatenate([[0.0], np.cumsum(np.diff(time_s) > LONGEST_STEP_S)])
    reach_s = LATEST_S + 0.5 * WINDOW_S
    before, after = (np.searchsorted(time_s, at_s + shift_s) for shift_s in (-reach_s, reach_s))
    dense: npt.NDArray[np.bool_] = long[np.minimum(after, len(time_s) - 1)] == long[np.maximum(before - 1, 0)]
    return dense


def held_s(recording: Recording) -> float:
    """Time for which the drive holds a wheel speed: the median, and 0 where that is a single row."""
    log = recording.encoders
    held_s = []
    for speed in (log.left_rad_s, log.right_rad_s):
        if speed is not None:
            changes = np.flatnonzero(np.diff(speed) != 0.0) + 1
            held_s.append(np.diff(log.time_s[changes])[speed[changes][:-1] != 0.0])  # a standstill is no hold
    times_s = np.concatenate([*held_s, np.zeros(0)])
    times_s = times_s[times_s <= LONGEST_HOLD_S]
    hold_s = float(np.median(times_s)) if len(times_s) else 0.0
    return hold_s if hold_s > HELD_ROWS * float(np.median(np.diff(log.time_s))) else 0.0


def _best_of_grid(parts: Sequence[_Part]) -> float:
    """The lag from which the search sets out: the largest likelihood, noise of each recording unknown."""
    grid = np.arange(EARLIEST_S, LATEST_S + 0.5 * GRID_S, GRID_S)

    def misfit(lag_s: float) -> float:
        squares = ((len(part.at_s), float(np.mean(part.regress(lag_s)[0] ** 2))) for part in parts)
        return sum(count * math.log(max(square, LEAST_SIGMA_RAD**2)) for count, square in squares)

    return float(min(grid, key=misfit))


def _scores(part: _Part, residual: Array, slope: Array, by_wheels: Array) -> tuple[float, Array]:
    """Information on the lag, and the score of each block of rows.

    The wheels' own slope is the instrument: the noise of the other sensor is in its slope, and would square.
    """
    weights = part.weights / part.sigma**2
    block = ((part.at_s - part.at_s[0]) / BLOCK_S).astype(np.intp)
    by_block: Array = np.bincount(block, weights * by_wheels * residual).astype(np.float64)
    return float(weights @ (slope * by_wheels)), by_block[np.bincount(block) > 0]


def _scatter(clusters: Array) -> float:
    """Sum of the squared scores, with the usual factor for few clusters; infinite for one."""
    count = len(clusters)
    return float(clusters @ clusters) * count / (count - 1) if count > 1 else math.inf
