"""Population of a constant: the part that robots share, by partial pooling.

    value = mean + batch + robot + place + season(time) + steps + noise

is linear and Gaussian; the scatter of robots, batches, places and noise is estimated with it (empirical Bayes, EM).
A robot has one level for each of its segments (`changes`).
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.arrays import Array
from drd_tools import robust
from drd_tools.fleet.series import Integers, Log

ROUNDS: Final = 12  # of EM; after that the standard deviations move by less than a tenth
KNOT_DAYS: Final = 14.0  # spacing of the season's knots: weather and load change over weeks
LEAST_ROBOTS: Final = 5  # with fewer, a shared change cannot be told from that of one robot
# Prior scatter of groups, in fractions of the jump, with the weight of one group: groups are few.
GROUP_PART: Final = 0.1
FREEDOM: Final = 4.0  # degrees of freedom of Student's t: leaking robots must not pull the shared part
WALK_PART: Final = 0.003  # of a jump, per square root of a day: initial value
LEAST_PAIRS: Final = 10  # pairs of successive recordings needed to estimate the noise
HALVINGS: Final = 30  # bisections: to nine digits
NORMAL_QUARTILE2: Final = 0.4549  # median of chi-square with one degree of freedom


@dataclass(frozen=True)
class Step:
    """A change common to all robots of a group: `kind` is place or batch, `which` its number.

    `robots`: number of those observed both before and after. `size`, `sigma`: SI.
    """

    kind: str
    which: int
    day: float
    size: float
    sigma: float
    probability: float
    robots: int

    def rows(self, log: Log) -> Array:
        """1 for the group's recordings since the change, else 0, shape (n,)."""
        group = log.place if self.kind == "place" else log.batch_of[log.robot]
        return np.asarray((group == self.which) & (log.day >= self.day), float)


# Offset of each group from the others, and its sigma.
Apart = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Population:
    """Parameters of the population. `spread`: sigma of robots about their batch; `walk`: variance per day; `excess`:
    noise of recordings beyond their sigma. `batch`, `place` with `place_sigma`, and the `season` at `knots` (days): SI.
    """

    mean: float
    spread: float
    excess: float
    walk: float
    batch: Array
    place: Array
    place_sigma: Array
    knots: Array
    season: Array
    steps: tuple[Step, ...] = ()
    scatter: tuple[float, float, float] = (0.0, 0.0, 0.0)  # sigmas of batches, places, knots
    batch_apart: Apart = ()
    place_apart: Apart = ()
    inflation: float = 1.0  # factor on the levels' sigmas

    def shared(self, log: Log) -> Array:
        """Sum of place, season and steps for each recording, shape (n,)."""
        found = self.place[log.place] + np.interp(log.day, self.knots, self.season)
        for step in self.steps:
            found = found + step.size * step.rows(log)
        return np.asarray(found)

    def variance(self, log: Log) -> Array:
        """Variance of each recording about its robot's level, shape (n,)."""
        return np.asarray(log.sigma**2 + self.excess**2 + self.place_sigma[log.place] ** 2)

    def expected(self, log: Log) -> Array:
        """Prior mean of each robot's level, shape (robots,)."""
        return np.asarray(self.mean + self.batch[log.batch_of])


def first_guess(log: Log) -> Population:
    """Robust initial values: medians."""
    robots = len(log.robots)
    middle = np.array([np.median(log.value[log.rows(i)]) for i in range(robots) if np.any(log.robot == i)])
    mean = float(np.median(middle))
    jump = log.constant.jump
    spread = robust.deviation(middle) if robots >= LEAST_ROBOTS else log.constant.spread
    low, high = float(log.day.min()), float(log.day.max())
    knots = np.linspace(low, max(high, low + 1.0), max(2, round((high - low) / KNOT_DAYS) + 1))
    none, nowhere = np.zeros(len(log.batches)), np.zeros(len(log.places))
    spread, walk = max(spread, 0.1 * log.constant.spread), (WALK_PART * jump) ** 2
    return Population(
        mean, spread, _excess(log), walk, none, nowhere, nowhere, knots, np.zeros(len(knots)), (),
        (GROUP_PART * jump,) * 3,
    )  # fmt: skip


def fit(log: Log, before: Population, segment: Integers, drift: Array, levels: Integers) -> Population:
    """Estimate all parameters, given the segments. (102), (103)

    `segment`: number of each recording's segment, shape (n,); `drift`: creep within it, shape (n,); `levels`: 1 for the
    first segment of a robot, 0 for others, shape (segments,).
    """
    X, prior = _design(log, before)
    found = before
    robot_of = np.zeros(len(levels), np.int64)
    robot_of[segment] = log.robot
    y = log.value - drift
    trust = np.ones(len(y))
    for _ in range(ROUNDS):
        beta, covariance, level = _solved(log, found, X, prior, y, segment, levels, trust)
        left = y - X @ beta - level.mean[segment]
        trust = (FREEDOM + 1.0) / (FREEDOM + left**2 / (log.sigma**2 + found.excess**2))
        found = _updated(log, found, beta, covariance, level, levels)
        prior = _precisions(log, found)
    return found


@dataclass(frozen=True)
class _Levels:
    """Levels of segments relative to their groups."""

    mean: Array
    variance: Array


def _design(log: Log, p: Population) -> tuple[Array, Array]:
    """Columns of the mean, batches, places, knots and steps, and their prior precision."""
    n, batch = len(log.value), log.batch_of[log.robot]
    knots = np.column_stack([np.interp(log.day, p.knots, unit) for unit in np.eye(len(p.knots))])
    steps = [step.rows(log)[:, None] for step in p.steps]
    one_of = [np.eye(len(names))[which] for names, which in ((log.batches, batch), (log.places, log.place))]
    return np.hstack([np.ones((n, 1)), *one_of, knots, *steps]), _precisions(log, p)


def _precisions(log: Log, p: Population) -> Array:
    """Prior precision of the columns, shape (k, k): a random walk for the season, else independent."""
    jump, (batch, place, season) = log.constant.jump, p.scatter
    few = len(log.robots) < LEAST_ROBOTS
    season = 1e-6 * jump if few else season
    batch = 1e-6 * jump if len(log.batches) < 2 else batch
    place = 1e-6 * jump if len(log.places) < 2 else place
    widths = [100.0 * max(jump, log.constant.spread), *[batch] * len(log.batches), *[place] * len(log.places)]
    k, m = len(widths), len(p.knots)
    Q = np.zeros((k + m + len(p.steps),) * 2)
    Q[range(k), range(k)] = 1.0 / np.square(widths)
    change = np.eye(m)[1:] - np.eye(m)[:-1]
    # The season has zero mean: its mean belongs to the population's.
    Q[k : k + m, k : k + m] = (change.T @ change + np.full((m, m), 1.0 / m)) / season**2
    at = range(k + m, len(Q))
    Q[at, at] = 1.0 / jump**2
    return Q


def _solved(
    log: Log, p: Population, X: Array, Q: Array, y: Array, segment: Integers, levels: Integers,
    trust: Array,
) -> tuple[Array, Array, _Levels]:  # fmt: skip
    """Generalised least squares, the segments' levels marginalised, then the levels; `trust`: weights (n,). (102)"""
    w = trust / (log.sigma**2 + p.excess**2)
    own = p.spread**2 + np.where(levels, 0.0, log.constant.jump**2)
    many = len(levels)
    total = np.bincount(segment, w, many)
    share = 1.0 / (total + 1.0 / own)
    WX = np.zeros((many, X.shape[1]))
    np.add.at(WX, segment, w[:, None] * X)
    Wy = np.bincount(segment, w * y, many)
    H = X.T @ (w[:, None] * X) - WX.T @ (share[:, None] * WX) + Q
    g = X.T @ (w * y) - WX.T @ (share * Wy)
    covariance = np.asarray(np.linalg.inv(H), float)
    beta = covariance @ g
    lever = share[:, None] * WX
    mean = share * (Wy - WX @ beta)
    return beta, covariance, _Levels(mean, share + np.einsum("ij,jk,ik->i", lever, covariance, lever))


def _updated(log: Log, p: Population, beta: Array, covariance: Array, level: _Levels, levels: Integers) -> Population:
    """M step: standard deviations from second moments. (103)"""
    sigma = np.sqrt(np.diag(covariance))
    b, q, m = len(log.batches), len(log.places), len(p.knots)
    parts = np.cumsum([1, b, q, m])
    jump = log.constant.jump
    first = np.flatnonzero(levels)
    # The prior spread of this kind of robot counts as one robot.
    spread2 = (np.sum(level.mean[first] ** 2 + level.variance[first]) + log.constant.spread**2) / (len(first) + 1.0)
    pulled = [_scatter(beta[i:j], sigma[i:j], GROUP_PART * jump) for i, j in ((1, parts[1]), (parts[1], parts[2]))]
    at = slice(parts[2], parts[3])
    C = covariance[at, at]
    change2 = np.diff(beta[at]) ** 2 + np.diag(C)[1:] + np.diag(C)[:-1] - 2.0 * np.diag(C, 1)
    season = np.sqrt((change2.sum() + (GROUP_PART * jump) ** 2) / (len(change2) + 1.0))
    return replace(
        p,
        mean=float(beta[0]),
        spread=float(np.sqrt(spread2)),
        batch=beta[1 : parts[1]],
        place=beta[parts[1] : parts[2]],
        place_sigma=_about_their_mean(covariance[parts[1] : parts[2], parts[1] : parts[2]]),
        season=beta[at],
        steps=tuple(
            replace(s, size=float(beta[parts[3] + i]), sigma=float(sigma[parts[3] + i])) for i, s in enumerate(p.steps)
        ),
        scatter=(pulled[0], pulled[1], float(season)),
        batch_apart=_apart(beta[1 : parts[1]], covariance[1 : parts[1], 1 : parts[1]]),
        place_apart=_apart(beta[parts[1] : parts[2]], covariance[parts[1] : parts[2], parts[1] : parts[2]]),
    )


def _apart(values: Array, covariance: Array) -> Apart:
    """Offset of each group from the median of all, or of two from each other; sigma relative to the others' mean."""
    k = len(values)
    if k < 2:
        return ()
    contrast = (k * np.eye(k) - 1.0) / (k - 1.0)
    sigma = np.sqrt(np.einsum("ij,jk,ik->i", contrast, covariance, contrast))
    size = contrast @ values if k == 2 else values - np.median(values)
    return tuple(zip(size.tolist(), sigma.tolist(), strict=True))


def _about_their_mean(covariance: Array) -> Array:
    """Sigmas of the groups relative to their mean; the rest belongs to the population mean."""
    k = len(covariance)
    centre = np.eye(k) - 1.0 / k
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", centre, covariance, centre), 0.0)))


def _scatter(values: Array, sigmas: Array, prior: float) -> float:
    return float(np.sqrt((np.sum(values**2 + sigmas**2) + prior**2) / (len(values) + 1.0)))


def _excess(log: Log) -> float:
    """Noise beyond the stated sigma, from successive recordings in one place: few have a change between them. (103)"""
    order = np.lexsort((log.day, log.place, log.robot))
    same = (np.diff(log.robot[order]) == 0) & (np.diff(log.place[order]) == 0)
    square = np.diff(log.value[order])[same] ** 2
    variance = (log.sigma[order][1:] ** 2 + log.sigma[order][:-1] ** 2)[same]
    if len(square) < LEAST_PAIRS or np.median(square / variance) <= NORMAL_QUARTILE2:
        return 0.0
    low, high = 0.0, float(np.sqrt(np.median(square) / NORMAL_QUARTILE2))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        is_more = np.median(square / (variance + 2.0 * middle**2)) > NORMAL_QUARTILE2
        low, high = (middle, high) if is_more else (low, middle)
    return high
