"""What a fleet's constants say: populations, trends, changes with their causes, and robots that stand out.

`analyse` of a plain table and the log of maintenance; `Statistics` has a `Fitted` for each constant.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from drd.arrays import Array
from drd_tools.fleet.changes import CREEP, ROOM, Changes, Prior, evidence, most_likely, posterior
from drd_tools.fleet.discoveries import benjamini_hochberg, by_probability
from drd_tools.fleet.events import LEAST_SEEN, Event, Segments, Trend, events, smoothed, with_maintenance
from drd_tools.fleet.groups import MOST_STEPS, ROBOT_DAYS, causes, pruned, steps, with_step
from drd_tools.fleet.population import LEAST_ROBOTS, Population, first_guess, fit
from drd_tools.fleet.series import Integers, Log, Maintained, logs, maintained

# Walks that are tried: per square root of a day, in parts of a jump.
WALKS: Final = (0.001, 0.002, 0.004, 0.01, 0.03)
MEANT, PERHAPS = 0.3, 0.05  # chance that work on a robot changes what it was done to; that says nothing
ROUNDS: Final = 2  # populations and segments in turns
FALSE: Final = 0.01  # expected share of false ones among the changes that are reported
LEAST: Final = 0.95  # probability of each
SAME_DAYS: Final = 7.0  # changes so near in time may have one cause
OUTSTANDING: Final = 0.05  # false discovery rate of robots, places and batches that stand out


@dataclass(frozen=True)
class Offset:
    """A robot, place or batch that is off the others ever since; SI."""

    kind: str
    who: str
    name: str
    size: float
    sigma: float
    p: float


@dataclass(frozen=True)
class Fitted:
    """One constant of the fleet. `trends`: by robot, in the log's order; `offsets`: all, found or not."""

    log: Log
    population: Population
    trends: list[Trend]
    events: list[Event]
    offsets: list[Offset]

    def deviation(self) -> Array:
        """Of each robot's newest level from the others', in sigmas of these; NaN: never seen."""
        expected, p = self.population.expected(self.log), self.population
        last = np.array([t.level[-1] if len(t.level) else np.nan for t in self.trends])
        return np.asarray((last - expected) / p.spread)


@dataclass(frozen=True)
class Statistics:
    """All constants by name, and the log of maintenance."""

    fitted: dict[str, Fitted]
    maintenance: list[Maintained]

    @property
    def found(self) -> list[Event]:
        """The changes to report, the surest first."""
        every = [e for f in self.fitted.values() for e in f.events if e.is_found]
        return sorted(every, key=lambda e: (-e.probability, e.robot, e.day))

    @property
    def standing_out(self) -> list[Offset]:
        """Offsets of which OUTSTANDING are false on average."""
        found = []
        for kind in ("place", "batch", "robot"):
            every = [o for f in self.fitted.values() for o in f.offsets if o.kind == kind]
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
    """The same of logs. `known`: populations of before, which are not estimated anew."""
    done = list(done)
    with threadpool_limits(limits=1):  # so small products are no sooner done by two threads
        fitted = {name: _fitted(log, done, (known or {}).get(name)) for name, log in every.items() if len(log.value)}
    flat = [e for f in fitted.values() for e in f.events if e.seen >= LEAST_SEEN]
    mask = by_probability(np.array([e.probability for e in flat]), FALSE, LEAST)
    found = {id(e) for e, is_found in zip(flat, mask, strict=True) if is_found}
    judged = {
        name: replace(f, events=[replace(e, is_found=id(e) in found) for e in f.events]) for name, f in fitted.items()
    }
    return Statistics(judged, done)


def _fitted(log: Log, done: list[Maintained], known: Population | None) -> Fitted:
    whole = [[(0, 0, int(n) - 1)] if n else [] for n in np.bincount(log.robot, minlength=len(log.robots))]
    change = _chances(log, done)
    p = known or _with_steps(log, whole)
    if known is None:
        for turn in range(ROUNDS):
            if turn:  # with the jumps taken out of what is common
                p = max((replace(p, walk=(part * log.constant.jump) ** 2) for part in WALKS),
                        key=lambda q: float(_cut(log, q, change)[1].sum()))  # fmt: skip
            trends = _trends(log, p, _cut(log, p, change)[0])
            p = fit(log, pruned(p, log.constant.jump), *_numbered(log, trends))
        p = pruned(p, log.constant.jump)
    segments, _, changes = _cut(log, p, change)
    trends = _trends(log, p, segments)
    found = [
        with_maintenance(event, done)
        for i, trend in enumerate(trends)
        if trend.segments
        for event in events(log, changes[i], 0, i, trend)
    ]
    return Fitted(log, p, trends, _with_causes(log, p, trends, found), offsets(log, p, trends))


def _with_steps(log: Log, whole: list[Segments]) -> Population:
    """The population without changes of single robots, with those of places and batches."""
    p = first_guess(log)
    numbered = _numbered(log, [Trend(s, np.zeros(0), np.zeros(0)) for s in whole])
    p = fit(log, p, *numbered)
    for _ in range(MOST_STEPS):
        left = log.value - p.shared(log) - p.expected(log)[log.robot]
        step = steps(log, p, numbered[0], numbered[2], left)
        if step is None:
            break
        p = fit(log, with_step(p, step), *numbered)
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


def _cut(log: Log, p: Population, change: Array) -> tuple[list[Segments], Array, list[Changes]]:
    """The likeliest segments of each robot, its log evidence, and the posterior."""
    counts = np.bincount(log.robot, minlength=len(log.robots))
    value, variance, expected = log.value - p.shared(log), p.variance(log), p.expected(log)
    segments: list[Segments] = [[] for _ in log.robots]
    total = np.zeros(len(log.robots))
    found: list[Changes] = [Changes(*np.zeros((4, 0)))] * len(log.robots)
    for members in _batches(counts):
        n = int(counts[members].max())
        day, y, r = (np.full((len(members), n), np.nan) for _ in range(3))
        h = np.zeros((len(members), n))
        for i, robot in enumerate(members):
            rows, k = log.rows(robot), counts[robot]
            day[i, :k], y[i, :k], r[i, :k] = log.day[rows], value[rows], variance[rows]
            h[i, :k] = change[rows]
        c = log.constant
        given = evidence(day, y, r, Prior(expected[members], p.spread, c.jump, c.slope, p.walk, h))
        every, best = posterior(given.log, h), most_likely(given.log, h)
        for i, robot in enumerate(members):
            last = int(counts[robot]) - 1
            segments[robot] = [(kind, s, min(e, last)) for kind, s, e in best[i] if s <= last]
            total[robot] = every.log_evidence[i]
            found[robot] = Changes(*(part[i : i + 1] for part in every))
    return segments, total, found


def _batches(counts: Integers) -> list[Integers]:
    """Robots of like numbers of recordings together, as many as there is room for."""
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


def _trends(log: Log, p: Population, segments: list[Segments]) -> list[Trend]:
    value, expected = log.value - p.shared(log), p.expected(log)
    return [smoothed(log, p, i, one, float(expected[i]), value) for i, one in enumerate(segments)]


def _numbered(log: Log, trends: Sequence[Trend]) -> tuple[Integers, Array, Integers]:
    """Each recording's segment, what creeps in it, and which segments are their robots' first."""
    segment, drift, first = np.zeros(len(log.value), np.int64), np.zeros(len(log.value)), list[int]()
    for robot, trend in enumerate(trends):
        start = log.rows(robot).start
        for kind, s, e in trend.segments:
            segment[start + s : start + e + 1] = len(first)
            if kind == CREEP and len(trend.level):
                # Counted from its begin, where the level is what robots of its kind have.
                drift[start + s : start + e + 1] = trend.level[s : e + 1] - trend.level[s]
            first.append(int(s == 0))
    return segment, drift, np.array(first, np.int64)


def _with_causes(log: Log, p: Population, trends: list[Trend], found: list[Event]) -> list[Event]:
    """Whose change it is, and in how many others it is not."""
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
    """Whether two robots change alike, at about one time: one cause may explain both."""
    near = abs(one.day - other.day) <= SAME_DAYS and one.form == other.form and one.robot != other.robot
    return near and 0.5 < one.size / other.size < 2.0 and min(one.probability, other.probability) > 0.5


def _undone(log: Log, trend: Trend, robot: int, event: Event, of: Integers, own: Array) -> Array:
    """Join the event's segment to the one before, in `of` and `own` (n,); the course of the event, shape (n,)."""
    start = log.rows(robot).start
    k = next(i for i, (_, s, _) in enumerate(trend.segments) if s == event.first)
    kind, s, e = trend.segments[k]
    mine = slice(start + s, start + e + 1)
    if k:
        _, s0, e0 = trend.segments[k - 1]
        before = slice(start + s0, start + e0 + 1)
        # What crept before ends where this begins.
        own[before] -= own[before][-1]
        of[mine] = of[before][0]
    inside = (log.day >= event.day) & (log.day < event.until)
    if kind != CREEP:
        return inside.astype(float)
    own[mine] = 0.0
    return np.asarray(inside * (log.day - event.day) / max(log.day[mine][-1] - event.day, 1.0))


def offsets(log: Log, p: Population, trends: list[Trend]) -> list[Offset]:
    """Robots against their batch, batches and places against the others: sizes and p-values. (107)"""
    found = []
    last = {i: t.segments[0][2] for i, t in enumerate(trends) if t.segments}
    size = np.array([trends[i].level[k] - p.expected(log)[i] for i, k in last.items()])
    n = len(size)
    for j, (i, k) in enumerate(last.items()):
        if n < LEAST_ROBOTS:
            break
        # Against the others (externally studentised), so that one that is far off does not hide itself.
        others = np.delete(size, j)
        sigma = float(np.sqrt(others.var(ddof=1) * n / (n - 1.0) + trends[i].sigma[k] ** 2))
        off = float(size[j] - others.mean())
        p_value = float(2.0 * stats.t.sf(abs(off) / sigma, n - 2))
        found.append(Offset("robot", log.robots[i], log.name, off, sigma, p_value))
    for kind, names, apart in (("batch", log.batches, p.batch_apart), ("place", log.places, p.place_apart)):
        for name, (off, sigma) in zip(names, apart, strict=False):
            found.append(Offset(kind, name, log.name, off, sigma, float(2.0 * stats.norm.sf(abs(off) / sigma))))
    return found
