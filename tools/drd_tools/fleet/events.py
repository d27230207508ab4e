"""Events of robots: changes of a series, with date, size, probability and cause."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from drd.arrays import Array
from drd_tools.fleet.changes import CREEP, Changes
from drd_tools.fleet.levels import Segment, Series, Trend
from drd_tools.fleet.series import Maintained

DATE_TAIL: Final = 0.05  # posterior of the date omitted at each end: an interval of 90 %
NOT_SEEN: Final = 1e-3  # posterior below which a date is not part of an event


@dataclass(frozen=True)
class Event:
    """A change of one robot's constant.

    `first`: number of the robot's first recording after it, on `day`; the 90 % interval of the date is `low` to `high`.
    `size`, `sigma`: those of the change, SI; of a creep, so far. `probability`: that there is a change; `causes`: whose
    it is; `seen`: recordings on its shorter side. `level`, `level_sigma`: level since then minus the robot's first.
    `until`: the day of the next change; `others`: number of robots that did not change alike.
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
        """The likeliest cause."""
        return max(self.causes, key=lambda name: self.causes[name])


def events(series: Series, changes: Changes, trend: Trend) -> Iterator[Event]:
    """Yield the changes between a robot's segments, not yet judged. `changes`: those of this series alone."""
    segments = trend.segments
    if segments and segments[0][0] == CREEP and segments[0][2]:
        yield _creeping(series, changes, trend, segments[0][2])
    for before, after in pairwise(segments):
        yield _between(series, changes, trend, before, after)


def _between(series: Series, changes: Changes, trend: Trend, before: Segment, after: Segment) -> Event:
    (_, s0, e0), (kind, s, e) = before, after
    at = np.arange(s0 + 1, e + 1)
    mass = changes.change[0, at]
    # Only its own date: the mass connected to the peak.
    near = _around(mass, s - s0 - 1)
    at, mass = at[near], mass[near]
    total = np.cumsum(mass) / mass.sum()
    low = at[int(np.searchsorted(total, DATE_TAIL))]
    high = at[min(int(np.searchsorted(total, 1.0 - DATE_TAIL)), len(at) - 1)]
    size, sigma = change(series, trend, before, after)
    last, day = e if kind == CREEP else s, series.day
    return Event(
        robot=series.robot,
        name=series.name,
        form="creep" if kind == CREEP else "step",
        first=s,
        day=float(day[s]),
        low=float(day[low - 1]),
        high=float(day[high]),
        recording=series.recordings[s],
        size=size,
        sigma=sigma,
        probability=changes.any_change(0, int(at[0]), int(at[-1])),
        level=float(trend.level[last] - trend.level[trend.first]),
        level_sigma=float(np.hypot(trend.sigma[last], trend.sigma[trend.first])),
        causes={"robot": 1.0},
        seen=min(e0 - s0 + 1, _beyond_half(trend, s, e) if kind == CREEP else e - s + 1),
        until=float(day[e + 1]) if e + 1 < len(day) else np.inf,
    )


def change(series: Series, trend: Trend, before: Segment, after: Segment) -> tuple[float, float]:
    """Size and sigma of the change between two segments."""
    (kind0, s0, e0), (kind, s, e) = before, after
    last, day = e if kind == CREEP else s, series.day
    # An earlier creep goes on until the change, whose time is uniform between the two recordings.
    crept = (trend.level[e0] - trend.level[s0]) / (day[e0] - day[s0]) if kind0 == CREEP and e0 > s0 else 0.0
    gap = day[s] - day[e0]
    further = crept * gap
    size = trend.level[last] - trend.level[e0] - 0.5 * further
    variance = trend.sigma[last] ** 2 + trend.sigma[e0] ** 2 + further**2 / 12.0 + series.walk * gap
    return float(size), float(np.sqrt(variance))


def _around(mass: Array, peak: int) -> slice:
    """Neighbourhood of a date that has posterior mass."""
    low = high = peak
    while low > 0 and mass[low - 1] > NOT_SEEN:
        low -= 1
    while high < len(mass) - 1 and mass[high + 1] > NOT_SEEN:
        high += 1
    return slice(low, high + 1)


def _creeping(series: Series, changes: Changes, trend: Trend, end: int) -> Event:
    """Event of a level that crept from the first recording on."""
    p, day = float(changes.segments[0, CREEP, 0, end:].sum()), series.day
    size = float(trend.level[end] - trend.level[0])
    sigma = float(np.hypot(trend.sigma[end], trend.sigma[0]))
    until = float(day[end + 1]) if end + 1 < len(day) else np.inf
    return Event(series.robot, series.name, "creep", 0, float(day[0]), float(day[0]), float(day[0]),
                 series.recordings[0], size, sigma, p, size, sigma, {"robot": 1.0}, _beyond_half(trend, 0, end),
                 until=until)  # fmt: skip


def _beyond_half(trend: Trend, first: int, last: int) -> int:
    """Count recordings that show more than half of the creep: a single one may be an outlier."""
    crept = (trend.level[first : last + 1] - trend.level[first]) / (trend.level[last] - trend.level[first])
    return int((crept > 0.5).sum())


def with_maintenance(event: Event, done: Sequence[Maintained]) -> Event:
    """Add to an event the maintenance of the robot between its dates, if that can be the cause."""
    for one in done:
        is_then = one.robot == event.robot and event.low <= one.until and one.day <= event.high
        if is_then and one.means(event.name) is not False:
            return replace(event, maintenance=one)
    return event
