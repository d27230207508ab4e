"""Growth of the lag of wheels or reference during a recording, which shows a drifting clock. (79)"""

import math
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd_tools.calibrate.wheels.lag import CONVERGED_S, GRID_S, MAX_STEPS
from drd_tools.calibrate.wheels.turns import (
    EARLIEST_S,
    LATEST_S,
    LEAST_SIGMA_RAD,
    Turns,
    of_reference,
    of_wheels,
    over,
)
from drd_tools.recordings.folder import Recording

# Standard deviation of the lag of a reference, and of a skid-steer robot's wheels, within a drive. Against a gyro:
# lidar odometry 0.04 to 0.3 s, motion capture 0.06 s (median of 37), wheels 0.02 to 0.05 s.
REFERENCE_WANDER_S, WHEELS_WANDER_S = 0.1, 0.03
# Range of growths searched: a gyro's clock may be 3 % off. At the drive's end the grid's lags are END_GRID_S apart.
MOST_GROWTH: Final = 0.05
END_GRID_S: Final = 0.2
MOST_BEFORE_S: Final = 10.0  # largest drift of a clock before the robot first turns: 3 % in five minutes at rest
SOME_ROWS: Final = 500


class Drift(NamedTuple):
    """Lag at time 0, s, and its growth, s/s; `sigma`: standard deviation of the growth."""

    lag_s: float
    growth: float
    sigma: float

    @property
    def begins_usual(self) -> bool:
        """Whether the lag at time 0 is one that sensors have; a clock that drifted before the start exceeds it."""
        return EARLIEST_S < self.lag_s < LATEST_S


def find_drift(recording: Recording, against: str) -> Drift | None:
    """Fit the growth of the wheels' lag behind gyro or reference; None if the rows do not determine it."""
    return _drift(of_wheels(recording, against), MOST_GROWTH if against == "gyro" else 0.0)


def reference_drift(recording: Recording) -> Drift | None:
    """Fit the growth of the reference's lag behind the gyro; None without either, or if it is undetermined."""
    return _drift(of_reference(recording), MOST_GROWTH)


def _drift(part: Turns | None, most: float) -> Drift | None:
    if part is None:
        return None
    x = _likeliest_growth(part, most)
    for _ in range(MAX_STEPS):
        late_s = x[0] + x[1] * part.at_s
        part.reweigh(part.regress(late_s)[0])
        residual, slope, by_wheels, _ = part.regress(late_s)
        # The wheels' own slope is the instrument, since it is free of the other sensor's noise.
        S, Z = (np.column_stack([column, column * part.at_s]) for column in (slope, by_wheels))
        instrument = Z * part.weights[:, None]
        try:
            inverse = np.linalg.inv(instrument.T @ S)
        except np.linalg.LinAlgError:
            return None
        score = instrument * residual[:, None]
        move = inverse @ score.sum(axis=0)
        x = x + move
        if np.abs(move * [1.0, part.at_s[-1]]).max() < CONVERGED_S:
            break
    blocks = part.by_block(score)
    # With few informative turns the blocks may agree by chance: the rows' noise gives a lower limit.
    squares = (blocks.T @ blocks, part.noise_square * instrument.T @ instrument)
    sigma = math.sqrt(max(float((inverse @ square @ inverse.T)[1, 1]) for square in squares))
    return Drift(float(x[0]), float(x[1]), sigma) if np.isfinite(x).all() else None


def _likeliest_growth(part: Turns, most: float) -> Array:
    """Starting point of the fit: lag at time 0, s, and growth, up to `most` s/s, shape (2,)."""
    some = slice(None, None, max(1, len(part.at_s) // SOME_ROWS))
    at_s, half_s = part.at_s[some], np.broadcast_to(part.half_s, part.at_s.shape)[some]
    turn = over(part.time_s, part.turn, at_s, half_s)
    turn -= turn.mean()

    def alike(late: tuple[float, float]) -> float:
        other = over(part.other_s, part.other, at_s - late[0] - late[1] * at_s, half_s)
        other -= other.mean()
        return float(turn @ other) / max(float(np.linalg.norm(turn) * np.linalg.norm(other)), LEAST_SIGMA_RAD**2)

    step = END_GRID_S / float(np.abs(at_s).max())
    most = min(most, MOST_BEFORE_S / max(abs(float(at_s[0])), 1.0))
    lags = np.arange(EARLIEST_S, LATEST_S + 0.5 * END_GRID_S, END_GRID_S if most else GRID_S).tolist()
    growths = (step * np.arange(-round(most / step), round(most / step) + 1)).tolist()
    return np.array(max(((lag_s, growth) for lag_s in lags for growth in growths), key=alike))
