"""One robot's constant over time: its level in each segment, by Gaussian process regression, robust to outliers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from drd.arrays import Array
from drd_tools.fleet.changes import CREEP, OUTLIERS
from drd_tools.fleet.population import Population
from drd_tools.fleet.series import Constant, Log

LEAST_SEEN: Final = 2  # recordings before and after a change: one alone may be an outlier
WEIGHED: Final = 2  # iterations of the outliers' weights
MOST_ODDS: Final = 50.0  # nats: certain, and the exponential is still finite
Segment = tuple[int, int, int]  # kind, first and last observation
Segments = Sequence[Segment]


@dataclass(frozen=True)
class Trend:
    """A robot's level without its shared part, at each of its recordings, shape (n,), SI."""

    segments: Segments
    level: Array
    sigma: Array

    @property
    def first(self) -> int:
        """End of the first segment of more than one recording: the robot's initial level."""
        return next((e for _, s, e in self.segments if e - s + 1 >= LEAST_SEEN), len(self.level) - 1)


@dataclass(frozen=True)
class Series:
    """A constant in the n recordings of one robot without its shared part; `day`, `value`, `variance`: shape (n,), SI.

    `mean`, `spread`: prior of its first level; `walk`: variance added per day. `inflation`: factor on the levels'
    sigmas.
    """

    robot: str
    name: str
    constant: Constant
    recordings: Sequence[str]
    day: Array
    value: Array
    variance: Array
    mean: float
    spread: float
    walk: float
    inflation: float

    def smoothed(self, segments: Segments) -> Trend:
        """Level in these segments; 0 with sigma 0 outside them. (104)"""
        level, sigma = np.zeros((2, len(self.day)))
        c = self.constant
        for kind, s, e in segments:
            at = slice(s, e + 1)
            t, y, own = self.day[at] - self.day[s], self.value[at] - self.mean, self.variance[at]
            K = self.spread**2 + (c.jump**2 if s else 0.0) + self.walk * np.minimum(t[:, None], t)
            if kind == CREEP:
                K = K + np.outer(t, t) * c.slope**2
            noise = own
            for _ in range(WEIGHED):
                found = K @ np.linalg.solve(K + np.diag(noise), y)
                noise = own / _inliers(y - found, own, c.jump)
            G = np.linalg.solve(K + np.diag(noise), K)
            level[at] = self.mean + G.T @ y
            sigma[at] = self.inflation * np.sqrt(np.maximum(np.diag(K) - np.einsum("ij,ij->j", K, G), 0.0))
        return Trend(segments, level, sigma)


def series_of(log: Log, p: Population) -> list[Series]:
    """Series of each robot, in the log's order."""
    value, variance, expected = log.value - p.shared(log), p.variance(log), p.expected(log)
    return [
        Series(robot, log.name, log.constant, log.recordings[rows], log.day[rows], value[rows], variance[rows],
               float(expected[i]), p.spread, p.walk, p.inflation)
        for i, robot in enumerate(log.robots)
        for rows in [log.rows(i)]
    ]  # fmt: skip


def _inliers(off: Array, variance: Array, jump: float) -> Array:
    """Weights equivalent to the mixture of (104)."""
    far = variance + jump**2
    odds = np.log(OUTLIERS / (1.0 - OUTLIERS)) + 0.5 * (np.log(variance / far) + off**2 * (1.0 / variance - 1.0 / far))
    outlier = 1.0 / (1.0 + np.exp(-np.clip(odds, -MOST_ODDS, MOST_ODDS)))
    return np.asarray((1.0 - outlier) + outlier * variance / far)
