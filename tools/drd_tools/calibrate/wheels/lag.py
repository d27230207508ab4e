"""Lag of the wheels behind the gyro or, if there is none, behind the reference. (56)"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd_tools.calibrate.wheels.covariance import MANY_RECORDINGS
from drd_tools.calibrate.wheels.spread import spread
from drd_tools.calibrate.wheels.turns import (
    EARLIEST_S,
    LATEST_S,
    LEAST_SIGMA_RAD,
    Turns,
    between_fixes,
    of_reference,
    of_wheels,
)
from drd_tools.recordings.folder import Recording

GRID_S: Final = 0.05
# A lag with a larger standard deviation is not determined: at 1 rad/s it is 3 deg.
LIMIT_S: Final = 0.05
CLEARLY: Final = 2.0
# A value that lasts for more rows is held; with new values in each row, jitter stays below this.
HELD_ROWS: Final = 1.5
# Per change: a slower wheel may repeat the same count for a row or two without a hold.
FEWEST_COUNTS: Final = 3
# A speed that lasts longer is constant, as in simulations: no drive updates that slowly.
LONGEST_HOLD_S: Final = 1.0
MAX_STEPS: Final = 25
CONVERGED_S: Final = 1e-5


@dataclass(frozen=True)
class Lag:
    """Delay of the wheels behind the gyro, or behind the reference.

    `spread_s`: standard deviation between recordings; nan for a single one. `hold_s`: time for which the drive holds a
    wheel speed, 0 if it does not. `each`: lag by recording. `determined`: its sigma is small enough.
    """

    against: str
    lag_s: float
    sigma_s: float
    spread_s: float
    hold_s: float
    each: dict[str, float] = field(default_factory=dict)

    @property
    def is_usual(self) -> bool:
        """Whether it lies within the lags that sensors have; at either limit the true lag may be beyond it."""
        return EARLIEST_S < self.lag_s < LATEST_S

    @property
    def determined(self) -> bool:
        """Whether the recordings determine it."""
        return self.sigma_s <= LIMIT_S and self.is_usual

    @property
    def applies(self) -> bool:
        """Whether to correct the next drive for it.

        Against a gyro always. A reference has its own delay, which may vary between drives: there the wheels must be
        late by clearly more than the lag's uncertainty and spread.
        """
        return self.determined and (self.against == "gyro" or self.lag_s > CLEARLY * self.next_s)

    @property
    def next_s(self) -> float:
        """Standard deviation of the next drive's lag."""
        return math.hypot(self.sigma_s, 0.0 if math.isnan(self.spread_s) else self.spread_s)


class _Scores(NamedTuple):
    """Information on the lag in one recording, and the score of each block of rows, (b,).

    `by_noise`: sum of squared scores expected from the rows' noise alone, since with few informative turns the blocks
    may agree by chance.
    """

    information: float
    by_block: Array
    by_noise: float

    @property
    def tells(self) -> bool:
        """Whether it determines a lag and its uncertainty on its own."""
        return self.information > 0.0 and len(self.by_block) > 1


def find_lag(recordings: Sequence[Recording]) -> Lag | None:
    """Estimate the lag common to all recordings; None if no recording has dense enough rows."""
    against = "gyro" if any(recording.fog is not None for recording in recordings) else "reference"
    made = (of_wheels(recording, against) for recording in recordings)
    hold_s = float(np.median([held_s(recording) for recording in recordings]))
    return _found(against, [part for part in made if part is not None], hold_s)


def reference_lag(recording: Recording) -> Lag | None:
    """Delay of the reference's headings behind the gyro; None without either, or if rows are few or too far apart."""
    turns = of_reference(recording) or between_fixes(recording)
    return None if turns is None else _found("gyro", [turns], 0.0)


def _found(against: str, parts: Sequence[Turns], hold_s: float) -> Lag | None:
    if not parts:
        return None
    lag_s = _best_of_grid(parts)
    for _ in range(MAX_STEPS):
        found = [part.regress(lag_s) for part in parts]
        for part, (residual, *_) in zip(parts, found, strict=True):
            part.reweigh(residual)
        scores = [_scores(part, *part.regress(lag_s)[:3]) for part in parts]
        information = sum(of.information for of in scores)
        move_s = sum(float(of.by_block.sum()) for of in scores) / information if information > 0.0 else 0.0
        lag_s = min(max(lag_s + move_s, EARLIEST_S), LATEST_S)
        if abs(move_s) < CONVERGED_S:
            break
    if information <= 0.0 or min(scale for *_, scale in found) <= 0.0:
        return Lag(against, lag_s, math.inf, math.nan, hold_s)
    return _result(against, parts, scores, lag_s, hold_s)


def _result(against: str, parts: Sequence[Turns], scores: Sequence[_Scores], lag_s: float, hold_s: float) -> Lag:
    information = sum(of.information for of in scores)
    clusters = [np.concatenate([of.by_block for of in scores])]
    if len(parts) >= MANY_RECORDINGS:
        clusters.append(np.array([of.by_block.sum() for of in scores]))
    squares = (sum(of.by_noise for of in scores), *map(_scatter, clusters))
    sigma_s = math.sqrt(max(squares)) / information
    informative = [(part.name, of) for part, of in zip(parts, scores, strict=True) if of.tells]
    each = np.array([lag_s + of.by_block.sum() / of.information for _, of in informative])
    variances = np.array([max(_scatter(of.by_block), of.by_noise) / of.information**2 for _, of in informative])
    names = {name: float(own_s) for (name, _), own_s in zip(informative, each, strict=True)}
    return Lag(against, lag_s, sigma_s, spread(each, variances), hold_s, names)


def held_s(recording: Recording) -> float:
    """Median time for which the drive holds a wheel's speed, or its count; 0 if that is a single row."""
    log = recording.encoders
    are_counts = log.left_counts is not None
    held_s = [np.zeros(0)]
    for values in (log.left_counts, log.right_counts, log.left_rad_s, log.right_rad_s):
        if values is not None:
            steps = np.diff(values)
            changes = np.flatnonzero(steps) + 1
            # A standstill does not count as a hold.
            told = np.abs(steps[changes[1:] - 1]) >= FEWEST_COUNTS if are_counts else values[changes[:-1]] != 0.0
            held_s.append(np.diff(log.time_s[changes])[told])
    times_s = np.concatenate(held_s)
    times_s = times_s[times_s <= LONGEST_HOLD_S]
    hold_s = float(np.median(times_s)) if len(times_s) else 0.0
    return hold_s if hold_s > HELD_ROWS * float(np.median(np.diff(log.time_s))) else 0.0


def _best_of_grid(parts: Sequence[Turns]) -> float:
    """Starting point of the search: the lag of largest likelihood, each recording's noise being unknown."""
    grid = np.arange(EARLIEST_S, LATEST_S + 0.5 * GRID_S, GRID_S)

    def misfit(lag_s: float) -> float:
        squares = ((len(part.at_s), float(np.mean(part.regress(lag_s)[0] ** 2))) for part in parts)
        return sum(count * math.log(max(square, LEAST_SIGMA_RAD**2)) for count, square in squares)

    return float(min(grid, key=misfit))


def _scores(part: Turns, residual: Array, slope: Array, by_wheels: Array) -> _Scores:
    """Scores with the wheels' own slope as the instrument: the other slope contains noise, which would be squared."""
    instrument = part.weights / part.sigma**2 * by_wheels
    by_noise = part.noise_square * float(instrument @ instrument)
    return _Scores(float(instrument @ slope), part.by_block(instrument * residual), by_noise)


def _scatter(clusters: Array) -> float:
    """Sum of squared scores, with the usual correction for few clusters; infinite for one."""
    count = len(clusters)
    return float(clusters @ clusters) * count / (count - 1) if count > 1 else math.inf
