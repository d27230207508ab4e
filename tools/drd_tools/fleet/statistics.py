"""Statistics of a fleet's constants: populations, trends, changes with their causes, and robots that stand out.

`analyse` takes a plain table and the maintenance log; `Statistics` has a `Fitted` for each constant.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.special import ndtr, stdtr  # importing scipy.stats takes 0.4 s
from threadpoolctl import threadpool_limits

from drd.arrays import Array
from drd_tools.fleet.calibration import inflation
from drd_tools.fleet.changes import CREEP, ROOM, Changes, Prior, evidence, log_evidence, most_likely, posterior
from drd_tools.fleet.discoveries import benjamini_hochberg, by_probability
from drd_tools.fleet.events import Event, events, with_maintenance
from drd_tools.fleet.groups import MOST_STEPS, ROBOT_DAYS, causes, pruned, stays_without_any, steps
from drd_tools.fleet.levels import LEAST_SEEN, Segments, Series, Trend, series_of
from drd_tools.fleet.population import LEAST_ROBOTS, Population, first_guess, fit
from drd_tools.fleet.series import Integers, Log, Maintained, logs, maintained

# Random walks, all equally likely a priori: per square root of a day, in fractions of a jump.
WALKS: Final = (0.0007, 0.001, 0.0014, 0.002, 0.0028, 0.004, 0.01, 0.03)
MEANT, PERHAPS = 0.3, 0.05  # probability that work changes a constant: one it refers to; any, if it refers to none
ROUNDS: Final = 2  # alternations of populations and segments
FALSE: Final = 0.01  # expected share of false ones among the reported changes
LEAST: Final = 0.95  # least probability of a reported change
SAME_DAYS: Final = 7.0  # changes this near in time may have one cause
OUTSTANDING: Final = 0.05  # false discovery rate of robots, places and batches that stand out


@dataclass(frozen=True)
class Offset:
    """Offset of a robot, place or batch from the others since the beginning; SI. `is_shared`: not due to one robot."""

    kind: str
    who: str
    name: str
    size: float
    sigma: float
    p: float
    is_shared: bool = True


@dataclass(frozen=True)
class Fitted:
    """One constant of the fleet. `trends`: by robot, in the log's order; `offsets`: all, significant or not."""

    log: Log
    population: Population
    trends: list[Trend]
    events: list[Event]
    offsets: list[Offset]


@dataclass(frozen=True)
class Statistics:
    """All constants by name, and the maintenance log."""

    fitted: dict[str, Fitted]
    maintenance: list[Maintained]

    @property
    def found(self) -> list[Event]:
        """The changes to report, the surest first."""
        every = [e for f in self.fitted.values() for e in f.events if e.is_found]
        return sorted(every, key=lambda e: (-e.probability, e.robot, e.day))

    @property
    def standing_out(self) -> list[Offset]:
        """Significant offsets, at a false discovery rate of OUTSTANDING."""
        found = []
        for kind in ("place", "batch", "robot"):
            every = [o for f in self.fitted.values() for o in f.offsets if o.kind == kind and o.is_shared]
            mask = benjamini_hochberg(np.array([o.p for o in every]), OUTSTANDING)
            found += [o for o, is_found in zip(every, mask, strict=True) if is_found]
        return found


def analyse(table: Mapping[str, Sequence[Any]], maintenance: Sequence[Mapping[str, Any]] = ()) -> Statistics:
    """Statistics of a table with the columns recording, robot, place, batch, start_utc, name, value, sigma.

    `maintenance`: rows with date, robot and what.
    """
    return analyse_logs(logs(table), maintained(maintenance))


def analyse_logs(
    every: Mapping[str, Log], done: Sequence[Maintained], known: Mapping[str, Population] | None = None
) -> Statistics:
    """Statistics of logs. `known`: earlier populations, which are not estimated again."""
    done = list(done)
    with threadpool_limits(limits=1):  # products this small gain nothing from two threads
        fitted = {name: _fitted(log, done, (known or {}).get(name)) for name, log in every.items() if len(log.value)}
    flat = [e for f in fitted.values() for e in f.events if e.seen >= LEAST_SEEN]
    mask = by_probability(np.array([e.probability for e in flat]), FALSE, LEAST)
    found = {id(e) for e, is_found in zip(flat, mask, strict=True) if is_found}
    judged = {
        name: replace(f, events=[replace(e, is_found=id(e) in found) for e in f.events]) for name, f in fitted.items()
    }
    return Statistics(judged, done)


def _fitted(log: Log, done: list[Maintained], known: Population | None) -> Fitted:
    whole: list[Segments] = [
        [(0, 0, int(n) - 1)] if n else [] for n in np.bincount(log.robot, minlength=len(log.robots))
    ]
    change = _chances(log, done)
    p = known or _with_steps(log, whole)
    if known is None:
        for turn in range(ROUNDS):
            if turn:  # now that the jumps are removed from the shared part
                p = _walking(log, p, change)
            p = fit(log, pruned(p, log.constant.jump), *_numbered(log, _creeping(log, p, _cut(log, p, change)[0])))
        p = pruned(p, log.constant.jump)
    segments, changes = _cut(log, p, change)
    if known is None:
        p = replace(p, inflation=inflation(*_smoothed(log, p, segments)))
    series, trends = _smoothed(log, p, segments)
    found = [
        with_maintenance(event, done)
        for one, posterior, trend in zip(series, changes, trends, strict=True)
        for event in events(one, posterior, trend)
    ]
    return Fitted(log, p, trends, _with_causes(log, p, trends, found), offsets(log, p, trends))


def _walking(log: Log, p: Population, change: Array) -> Population:
    """Set the walk's variance to its posterior mean: weeks of data determine it within a factor of four. (103)"""
    walks = np.square(np.array(WALKS) * log.constant.jump)
    nats = np.array([
        sum(float(log_evidence(given, h).sum()) for *_, given, h in _given(log, replace(p, walk=float(walk)), change))
        for walk in walks
    ])  # fmt: skip
    return replace(p, walk=float(np.average(walks, weights=np.exp(nats - nats.max()))))


def _with_steps(log: Log, whole: list[Segments]) -> Population:
    """Fit the population with changes of places and batches, without those of single robots."""
    p = first_guess(log)
    numbered = _numbered(log, [Trend(s, np.zeros(0), np.zeros(0)) for s in whole])
    p = fit(log, p, *numbered)
    for _ in range(MOST_STEPS):
        left = log.value - p.shared(log) - p.expected(log)[log.robot]
        step = steps(log, p, numbered[0], numbered[2], left)
        if step is None:
            break
        p = fit(log, replace(p, steps=(*p.steps, step)), *numbered)
    return p


def _chances(log: Log, done: list[Maintained]) -> Array:
    """Prior probability of a change before each recording, shape (n,). (105)"""
    gap = np.diff(log.day, prepend=log.day[0]).clip(0.0)
    stays = np.exp(-gap / ROBOT_DAYS)
    number = {name: k for k, name in enumerate(log.robots)}
    for one in done:
        rows = log.rows(number[one.robot]) if one.robot in number else slice(0, 0)
        k = int(np.searchsorted(log.day[rows], one.day)) + rows.start
        means = one.means(log.name)
        if rows.start < k < rows.stop and means is not False:
            stays[k] *= 1.0 - (MEANT if means else PERHAPS)
    return np.asarray(1.0 - stays)


def _cut(log: Log, p: Population, change: Array) -> tuple[list[Segments], list[Changes]]:
    """Likeliest segments of each robot, and the posterior."""
    segments: list[Segments] = [[] for _ in log.robots]
    found: list[Changes] = [Changes(*np.zeros((2, 0)))] * len(log.robots)
    for members, counts, given, h in _given(log, p, change):
        every, best = posterior(given, h), most_likely(given, h)
        for i, (robot, count) in enumerate(zip(members, counts, strict=True)):
            last = int(count) - 1
            segments[robot] = [(kind, s, min(e, last)) for kind, s, e in best[i] if s <= last]
            found[robot] = Changes(*(part[i : i + 1] for part in every))
    return segments, found


def _given(log: Log, p: Population, change: Array) -> Iterator[tuple[Integers, Integers, Array, Array]]:
    """Yield some robots at a time: their numbers, counts of recordings, log evidence of segments, and `change`."""
    every = np.bincount(log.robot, minlength=len(log.robots))
    value, variance, expected, c = log.value - p.shared(log), p.variance(log), p.expected(log), log.constant
    for members in _batches(every):
        counts = every[members]
        n = int(counts.max())
        # NaN, and no change, after a robot's last recording.
        is_there = np.arange(n) < counts[:, None]
        rows = np.concatenate([np.arange(log.rows(robot).start, log.rows(robot).stop) for robot in members])
        day, y, r, h = np.full((4, len(members), n), np.nan)
        for padded, values in ((day, log.day), (y, value), (r, variance), (h, change)):
            padded[is_there] = values[rows]
        h = np.where(is_there, h, 0.0)
        prior = Prior(expected[members], p.spread, c.jump, c.slope, p.walk, h)
        yield members, counts, evidence(day, y, r, prior), h


def _batches(counts: Integers) -> list[Integers]:
    """Group robots with similar numbers of recordings, as many as fit into ROOM."""
    order = np.argsort(counts, kind="stable")
    order = order[counts[order] > 0]
    found, at = [], 0
    while at < len(order):
        end = at + 1
        while end < len(order) and (end + 1 - at) * 2 * counts[order[end]] ** 2 <= ROOM:
            end += 1
        found.append(order[at:end])
        at = end
    return found


def _smoothed(log: Log, p: Population, segments: Sequence[Segments]) -> tuple[list[Series], list[Trend]]:
    every = series_of(log, p)
    return every, [one.smoothed(own) for one, own in zip(every, segments, strict=True)]


def _creeping(log: Log, p: Population, segments: list[Segments]) -> list[Trend]:
    """Trends with the levels of creeping segments only, which is all that a population needs."""
    found = []
    for one, own in zip(series_of(log, p), segments, strict=True):
        level = one.smoothed([s for s in own if s[0] == CREEP])
        found.append(replace(level, segments=own))
    return found


def _numbered(log: Log, trends: Sequence[Trend]) -> tuple[Integers, Array, Integers]:
    """Segment of each recording, creep within it, and which segments are the first of their robots."""
    segment, drift, first = np.zeros(len(log.value), np.int64), np.zeros(len(log.value)), list[int]()
    for robot, trend in enumerate(trends):
        start = log.rows(robot).start
        for kind, s, e in trend.segments:
            segment[start + s : start + e + 1] = len(first)
            if kind == CREEP and len(trend.level):
                # Relative to its start, where the level has the population's prior.
                drift[start + s : start + e + 1] = trend.level[s : e + 1] - trend.level[s]
            first.append(int(s == 0))
    return segment, drift, np.array(first, np.int64)


def _with_causes(log: Log, p: Population, trends: list[Trend], found: list[Event]) -> list[Event]:
    """Add to each event its causes, and the number of robots without it."""
    if not found:
        return []
    segment, drift, levels = _numbered(log, trends)
    less = log.value - p.shared(log) - p.expected(log)[log.robot]
    number = {name: k for k, name in enumerate(log.robots)}
    seen = int(np.sum(np.bincount(log.robot, minlength=len(log.robots)) > 0))
    judged = []
    for event in found:
        robot = number[event.robot]
        same = [o for o in found if o is not event and _is_alike(o, event)]
        of, own = segment.copy(), drift.copy()
        shape = _undone(log, trends[robot], robot, event, of, own)
        for other in same:
            _undone(log, trends[number[other.robot]], number[other.robot], other, of, own)
        beside = np.zeros(len(log.robots))
        beside[[robot, *(number[o.robot] for o in same)]] = 1.0
        whose = causes(log, p, of, levels, less - own, robot, shape, beside)
        judged.append(replace(event, causes=whose, others=seen - 1 - len({o.robot for o in same})))
    return judged


def _is_alike(one: Event, other: Event) -> bool:
    """Whether two robots change alike at about the same time: one cause may explain both."""
    near = abs(one.day - other.day) <= SAME_DAYS and one.form == other.form and one.robot != other.robot
    return near and 0.5 < one.size / other.size < 2.0 and min(one.probability, other.probability) > 0.5


def _undone(log: Log, trend: Trend, robot: int, event: Event, of: Integers, own: Array) -> Array:
    """Join the event's segment to the one before, in `of` and `own` (n,); return the event's course, shape (n,)."""
    start = log.rows(robot).start
    k = next(i for i, (_, s, _) in enumerate(trend.segments) if s == event.first)
    kind, s, e = trend.segments[k]
    mine = slice(start + s, start + e + 1)
    if k:
        _, s0, e0 = trend.segments[k - 1]
        before = slice(start + s0, start + e0 + 1)
        # An earlier creep ends where this segment begins.
        own[before] -= own[before][-1]
        of[mine] = of[before][0]
    inside = (log.day >= event.day) & (log.day < event.until)
    if kind != CREEP:
        return inside.astype(float)
    own[mine] = 0.0
    return np.asarray(inside * (log.day - event.day) / max(log.day[mine][-1] - event.day, 1.0))


def offsets(log: Log, p: Population, trends: list[Trend]) -> list[Offset]:
    """Offsets of robots from their batch, and of batches and places from the others, with p-values. (107)"""
    seen = [i for i, t in enumerate(trends) if t.segments]
    last = [trends[i].segments[0][2] for i in seen]
    at_end = np.array([(trends[i].level[k], trends[i].sigma[k]) for i, k in zip(seen, last, strict=True)])
    found, n = [], len(seen)
    if n >= LEAST_ROBOTS:
        size, own = at_end[:, 0] - p.expected(log)[seen], at_end[:, 1]
        # Externally studentised, so that a large offset does not mask itself.
        off = (size - size.mean()) * n / (n - 1.0)
        others = (size.var() * n - off**2 * (n - 1.0) / n) / (n - 2.0)
        sigma = np.sqrt(others * n / (n - 1.0) + own**2)
        p_value = 2.0 * stdtr(n - 2, -np.abs(off) / sigma)
        for i, *figures in zip(seen, off.tolist(), sigma.tolist(), p_value.tolist(), strict=True):
            found.append(Offset("robot", log.robots[i], log.name, *figures))
    segment, drift, levels = _numbered(log, trends)
    left = log.value - p.shared(log) - p.expected(log)[log.robot] - drift
    for kind, names, of, apart in (
        ("batch", log.batches, log.batch_of[log.robot], p.batch_apart),
        ("place", log.places, log.place, p.place_apart),
    ):
        for k, (name, (off, sigma)) in enumerate(zip(names, apart, strict=False)):
            x = (of == k).astype(float)
            is_shared = stays_without_any(log, p, segment, levels, left + off * x, x, off)
            p_value = float(2.0 * ndtr(-abs(off) / sigma))
            found.append(Offset(kind, name, log.name, off, sigma, p_value, is_shared))
    return found
