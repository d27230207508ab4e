"""A robot's memory of earlier drives: its constants by day, their trends, and when they jumped. (100)

`remember` adds a drive, `latest` looks for change points, `known` gives the constants that a drive begins with.
After Jackson et al., An algorithm for optimal partitioning of data on an interval (2005).
"""

import math
from collections.abc import Sequence
from typing import Annotated, Final, NamedTuple

import numpy as np
from msgspec import Meta, Struct, field, structs

from drd.arrays import Array, cumulative
from drd.monitor.constants import KNOWN_SIGMAS, Constants
from drd.monitor.evidence import INFORMATION
from drd.monitor.library import CHANGE, TRAVEL, TURN
from drd.units import NS_PER_S

DAY_NS: Final = 86_400 * NS_PER_S
DAYS: Final = 180  # half a year; the oldest day is forgotten
EARLIEST_NS: Final = 1_704_067_200 * NS_PER_S  # 2024: a clock that shows an earlier time was not set
COLUMNS: Final = (TURN, TRAVEL, CHANGE)
# Evidence required of a jump or slope: odds of 20 to 1, a prior of one a year, and the cost of a size, (97).
NAMED_ODDS: Final = 20.0
CHANGE_NATS: Final = math.log(NAMED_ODDS * 365.0) + 0.5 * math.log1p(INFORMATION)
# Fewest days that show a slope: with fewer, a warm drive after cold ones would pass for a leak.
FEWEST_DAYS: Final = 5
FEWEST_AFTER: Final = 2  # days at another level: one alone may be a load on one side
SCATTER_DAYS: Final = 8.0  # weight of the usual scatter, in days
MEDIAN_SQUARE: Final = 0.455  # of chi-squared with one degree of freedom
LONGEST_AHEAD: Final = 1.0  # times its own length, for which a trend is extrapolated

Number = Annotated[float, Meta(ge=-10.0, le=10.0)]
Deviation = Annotated[float, Meta(gt=0.0, le=10.0)]


class Day(Struct, frozen=True):
    """Constants of a day's drives, by COLUMNS, with their deviations. `wall_ns`: of the newest drive, `distance_m`: of
    all.
    """

    wall_ns: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    distance_m: Annotated[float, Meta(ge=0.0)] = field(name="way_m")  # as the files have it
    values: tuple[Number, Number, Number]
    sigmas: tuple[Deviation, Deviation, Deviation]


class Memory(Struct, frozen=True):
    """Days in order of time. `basis`: the sizes that the constants are relative to."""

    basis: str
    days: Annotated[list[Day], Meta(max_length=DAYS)] = []


class Latest(NamedTuple):
    """A constant's recent course: `level` on the last day, with `slope` per day, and their (2, 2) `covariance`.

    `begin`: the day of its onset, known to `begin_std_days`. `jump` and its deviation: the change on that day, 0: none.
    `nats`: evidence for it, less its cost; `other_nats`: that for the other one of jump and slope. `flat_misfit`: half
    the sum of squared residuals of a constant level.
    """

    begin: int
    begin_std_days: float
    level: float
    slope: float
    covariance: Array
    jump: float
    jump_std: float
    nats: float
    other_nats: float
    flat_misfit: float


def remember(memory: Memory, day: Day) -> Memory:
    """Add a drive, combined with the others of its day.

    Later days in the memory are due to a wrong clock and are dropped. A drive whose own clock was not set is ignored.
    """
    if day.wall_ns < EARLIEST_NS:
        return memory
    days = [d for d in memory.days if d.wall_ns // DAY_NS <= day.wall_ns // DAY_NS]
    if days and days[-1].wall_ns // DAY_NS == day.wall_ns // DAY_NS:
        day = _together(days.pop(), day)
    return structs.replace(memory, days=[*days, day][-DAYS:])


def _together(a: Day, b: Day) -> Day:
    weights = [(1.0 / s**2, 1.0 / t**2) for s, t in zip(a.sigmas, b.sigmas, strict=True)]
    values = tuple((w * x + v * y) / (w + v) for (w, v), x, y in zip(weights, a.values, b.values, strict=True))
    sigmas = tuple((w + v) ** -0.5 for w, v in weights)
    return Day(b.wall_ns, a.distance_m + b.distance_m, values, sigmas)  # type: ignore[arg-type]


def latest(days: Sequence[Day], column: int) -> Latest:
    """The newest level or trend, without the days before its change point. `days`: at least one."""
    i = COLUMNS.index(column)
    at = np.array([(d.wall_ns - days[-1].wall_ns) / DAY_NS for d in days])
    y = np.array([d.values[i] for d in days])
    variance = np.array([d.sigmas[i] for d in days]) ** 2
    variance = variance + _scatter(y, variance, KNOWN_SIGMAS[column]) ** 2
    # A leak looks like stairs: one slope since an earlier level may fit better than many jumps.
    points = _change_points(y, variance)
    before = points[1:] or points  # so that the newest level's begin is a change
    found = [(cost, _one_change(at[k:], y[k:], variance[k:], k)) for k, cost in before]
    return min(found, key=lambda pair: pair[0] - pair[1].nats + pair[1].flat_misfit)[1]


def _one_change(at: Array, y: Array, variance: Array, first: int) -> Latest:
    """A level, a jump or a slope: the best fit after its cost. `first`: number of the first day."""
    n = len(y)
    flat = _fitted(np.ones((n, 1)), y, variance)
    alone = np.diag([float(flat.covariance[0, 0]), 0.0])
    best = Latest(first, 0.0, float(flat.sizes[0]), 0.0, alone, 0.0, 0.0, 0.0, -math.inf, flat.misfit)
    nats = np.full((2, n), -math.inf)
    for is_slope in (0, 1):
        for k in range(1 - is_slope, n - (FEWEST_DAYS if is_slope else FEWEST_AFTER) + 1):
            shape = np.maximum(at - at[k], 0.0) - (at[-1] - at[k]) if is_slope else (np.arange(n) < k) * -1.0
            fit = _fitted(np.column_stack([np.ones(n), shape]), y, variance)
            nats[is_slope, k] = now = flat.misfit - fit.misfit - CHANGE_NATS
            if now > best.nats:
                level, size = fit.sizes.tolist()
                alone = np.diag([float(fit.covariance[0, 0]), 0.0])
                slope, covariance = (size, fit.covariance) if is_slope else (0.0, alone)
                jump = (0.0, 0.0) if is_slope else (size, math.sqrt(float(fit.covariance[1, 1])))
                best = Latest(first + k, 0.0, level, slope, covariance, jump[0], jump[1], now, 0.0, flat.misfit)
    kind = 0 if best.jump else 1
    weight = np.exp(nats[kind] - nats[kind].max()) if best.nats > 0.0 else np.ones(n)
    middle = float(weight @ at / weight.sum())
    std = math.sqrt(float(weight @ (at - middle) ** 2 / weight.sum()))
    return best._replace(begin_std_days=std, other_nats=float(nats[1 - kind].max()))


class _Fit(NamedTuple):
    sizes: Array
    covariance: Array
    misfit: float


def _fitted(x: Array, y: Array, variance: Array) -> _Fit:
    w = x / variance[:, None]
    covariance = np.linalg.inv(w.T @ x + 1e-9 * np.eye(x.shape[1]))
    sizes = covariance @ (w.T @ y)
    return _Fit(np.asarray(sizes), np.asarray(covariance), 0.5 * float(((y - x @ sizes) ** 2 / variance).sum()))


def _change_points(y: Array, variance: Array) -> list[tuple[int, float]]:
    """Begins of the likeliest levels, the newest first, and the cost of all before each."""
    n, w = len(y), 1.0 / variance
    s, sy, syy = (cumulative(x) for x in (w, w * y, w * y * y))
    best, back = np.zeros(n + 1), np.zeros(n + 1, int)
    for end in range(1, n + 1):
        k = np.arange(end)
        misfit = 0.5 * (syy[end] - syy[k] - (sy[end] - sy[k]) ** 2 / (s[end] - s[k]))
        costs = best[:end] + misfit + CHANGE_NATS * (k > 0)
        back[end], best[end] = int(costs.argmin()), float(costs.min())
    found, end = [], n
    while end:
        end = int(back[end])
        found.append((end, float(best[end]) + CHANGE_NATS * (end > 0)))
    return found


def _scatter(y: Array, variance: Array, usual: float) -> float:
    """Scatter from day to day beyond the days' own deviations, from each day's difference to its neighbours."""
    if len(y) < 3:
        return usual
    off = (y[1:-1] - 0.5 * (y[:-2] + y[2:])) ** 2
    own = variance[1:-1] + 0.25 * (variance[:-2] + variance[2:])
    # The median, so that a jump does not count as scatter.
    square = max(0.0, float(np.median(off / own)) / MEDIAN_SQUARE - 1.0) * float(np.median(own)) / 1.5
    days = float(len(off))
    return math.sqrt((SCATTER_DAYS * usual**2 + days * square) / (SCATTER_DAYS + days))


def known(memory: Memory, wall_ns: int) -> Constants | None:
    """Constants with which a drive at that time begins; None without a memory."""
    if not memory.days:
        return None
    means, sigmas = {}, {}
    for column in COLUMNS:
        last = latest(memory.days, column)
        span_days = (memory.days[-1].wall_ns - memory.days[last.begin].wall_ns) / DAY_NS
        ahead = min(max(0.0, (wall_ns - memory.days[-1].wall_ns) / DAY_NS), LONGEST_AHEAD * span_days)
        g = np.array([1.0, ahead])
        means[column] = last.level + last.slope * ahead
        sigmas[column] = math.sqrt(float(g @ last.covariance @ g) + KNOWN_SIGMAS[column] ** 2)
    return Constants(means, sigmas)
