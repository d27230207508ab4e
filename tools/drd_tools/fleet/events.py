"""What happened to the robots: changes of a series as events, with date, size, probability and cause."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from drd.arrays import Array
from drd_tools.fleet.changes import CREEP, OUTLIERS, Changes
from drd_tools.fleet.population import Population
from drd_tools.fleet.series import Log, Maintained

LEAST_SEEN: Final = 2  # recordings before a change and since: one alone may be an outlier
DATE_TAIL: Final = 0.05  # of the date's posterior, left out at each end: an interval of 90 %
NOT_SEEN: Final = 1e-3  # posterior of a date that is no part of an event
Segments = list[tuple[int, int, int]]  # kind, first and last observation


@dataclass(frozen=True)
class Event:
    """A change of one robot's constant.

    `first`: number of the robot's first recording after it, `day` that one's; the date is from `low` to `high` with
    90 %. `size`, `sigma`: of the change, SI; what creeps: so far. `probability`: that there is a change; `causes`:
    whose it is; `seen`: recordings on its shorter side. `level`, `level_sigma`: since then, less the robot's first
    level. `until`: the day of its next change; `others`: robots that did not change so then.
    """

    robot: str
    name: str
    form: str
    first: int
    day: float
    low: float
    high: float
    recording: str
    size: float
    sigma: float
    probability: float
    level: float
    level_sigma: float
    causes: dict[str, float]
    seen: int
    maintenance: Maintained | None = None
    until: float = np.inf
    others: int = 0
    is_found: bool = False

    @property
    def cause(self) -> str:
        """The likeliest."""
        return max(self.causes, key=lambda name: self.causes[name])


@dataclass(frozen=True)
class Trend:
    """A robot's level, less what it shares: at each of its recordings, shape (n,), SI."""

    segments: Segments
    level: Array
    sigma: Array

    @property
    def first(self) -> int:
        """End of the first segment that is no single recording: where the robot set out from."""
        return next((e for _, s, e in self.segments if e - s + 1 >= LEAST_SEEN), len(self.level) - 1)


def smoothed(log: Log, p: Population, robot: int, segments: Segments, mean: float, value: Array) -> Trend:
    """The levels of a robot's segments, by Gaussian regression with outliers weighed down. (104)

    `value`: of all recordings, less what they share; `mean`: the robot's level beforehand.
    """
    rows = log.rows(robot)
    day, y, variance = log.day[rows], value[rows] - mean, p.variance(log)[rows]
    level, sigma = np.zeros(len(y)), np.zeros(len(y))
    c = log.constant
    for kind, s, e in segments:
        t = day[s : e + 1] - day[s]
        K = p.spread**2 + (c.jump**2 if s else 0.0) + p.walk * np.minimum(t[:, None], t)
        K = K + (np.outer(t, t) * c.slope**2 if kind == CREEP else 0.0)
        own = variance[s : e + 1]
        noise = own
        for _ in range(2):
            G = np.linalg.solve(K + np.diag(noise), K)
            found = G.T @ y[s : e + 1]
            noise = own / _inliers(y[s : e + 1] - found, own, c.jump)
        G = np.linalg.solve(K + np.diag(noise), K)
        level[s : e + 1] = mean + G.T @ y[s : e + 1]
        sigma[s : e + 1] = np.sqrt(np.maximum(np.diag(K) - np.einsum("ij,ij->j", K, G), 0.0))
    return Trend(segments, level, sigma)


def _inliers(off: Array, variance: Array, jump: float) -> Array:
    """Weights that stand for the mixture of (104)."""
    far = variance + jump**2
    odds = np.log(OUTLIERS / (1.0 - OUTLIERS)) + 0.5 * (np.log(variance / far) + off**2 * (1.0 / variance - 1.0 / far))
    outlier = 1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0)))
    return np.asarray((1.0 - outlier) + outlier * variance / far)


def events(log: Log, changes: Changes, series: int, robot: int, trend: Trend) -> Iterator[Event]:
    """The changes between a robot's segments; not yet judged."""
    segments, rows = trend.segments, log.rows(robot)
    day = log.day[rows]
    kind, _, end = segments[0]
    if kind == CREEP and end:
        yield _creeping(log, changes, series, robot, trend, end)
    for (before, s0, e0), (kind, s, e) in pairwise(segments):
        at = np.arange(s0 + 1, e + 1)
        mass = changes.change[series, at]
        # Its own date: neighbours that no change at all lies between.
        near = _around(mass, s - s0 - 1)
        at, mass = at[near], mass[near]
        total = np.cumsum(mass) / mass.sum()
        low = at[int(np.searchsorted(total, DATE_TAIL))]
        high = at[min(int(np.searchsorted(total, 1.0 - DATE_TAIL)), len(at) - 1)]
        last = e if kind == CREEP else s
        # What crept before goes on until the change, which is at any time between the two recordings.
        crept = (trend.level[e0] - trend.level[s0]) / (day[e0] - day[s0]) if before == CREEP and e0 > s0 else 0.0
        further = crept * (day[s] - day[e0])
        yield Event(
            robot=log.robots[robot],
            name=log.name,
            form="creep" if kind == CREEP else "step",
            first=s,
            day=float(day[s]),
            low=float(day[low - 1]),
            high=float(day[high]),
            recording=log.recordings[rows.start + s],
            size=float(trend.level[last] - trend.level[e0] - 0.5 * further),
            sigma=float(np.sqrt(trend.sigma[last] ** 2 + trend.sigma[e0] ** 2 + further**2 / 12.0)),
            probability=changes.any_change(series, int(at[0]), int(at[-1])),
            level=float(trend.level[last] - trend.level[trend.first]),
            level_sigma=float(np.hypot(trend.sigma[last], trend.sigma[trend.first])),
            causes={"robot": 1.0},
            seen=min(e0 - s0 + 1, _beyond_half(trend, s, e) if kind == CREEP else e - s + 1),
            until=float(day[e + 1]) if e + 1 < len(day) else np.inf,
        )


def _around(mass: Array, peak: int) -> slice:
    """The neighbourhood of a date that has posterior mass."""
    low = high = peak
    while low > 0 and mass[low - 1] > NOT_SEEN:
        low -= 1
    while high < len(mass) - 1 and mass[high + 1] > NOT_SEEN:
        high += 1
    return slice(low, high + 1)


def _creeping(log: Log, changes: Changes, series: int, robot: int, trend: Trend, end: int) -> Event:
    """What crept from the first recording on."""
    rows = log.rows(robot)
    p = float(changes.segments[series, CREEP, 0, end:].sum())
    size = float(trend.level[end] - trend.level[0])
    sigma = float(np.hypot(trend.sigma[end], trend.sigma[0]))
    day = log.day[rows]
    until = float(day[end + 1]) if end + 1 < len(day) else np.inf
    return Event(log.robots[robot], log.name, "creep", 0, float(day[0]), float(day[0]), float(day[0]),
                 log.recordings[rows.start], size, sigma, p, size, sigma, {"robot": 1.0},
                 _beyond_half(trend, 0, end), until=until)  # fmt: skip


def _beyond_half(trend: Trend, first: int, last: int) -> int:
    """How many recordings show more than half of what crept: with one alone, it may as well be an outlier."""
    crept = (trend.level[first : last + 1] - trend.level[first]) / (trend.level[last] - trend.level[first])
    return int((crept > 0.5).sum())


def with_maintenance(event: Event, done: Sequence[Maintained]) -> Event:
    """The event with what was done to the robot between its dates, if it can be the cause."""
    for one in done:
        if one.robot == event.robot and event.low <= one.day <= event.high and one.means(event.name) is not False:
            return replace(event, maintenance=one)
    return event
