"""Variance law of noise much larger than stated: the covariate that it depends on, and when it is largest.

The logarithm of the mean square residual of each block is regressed on bins of each covariate (Harvey 1976); the
covariate is chosen by the Schwarz criterion, and an interval of time by its likelihood ratio. (78)
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from drd.arrays import Array, cumulative
from drd.config.robot import Robot, datasheet
from drd.units import DEG_PER_RAD
from drd_tools.diagnose.regression.noise_fit import not_inflated, ratios
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.results import Level, Scatter, Window
from drd_tools.diagnose.series import Spread

MOST_NOISE: Final = 2.0  # times the stated noise: datasheets are right within a factor of 1.5
BLOCK_S: Final = 2.0  # real slip is correlated for about so long
BLOCK_ROWS: Final = 4  # fewer do not determine a size
MOST_BLOCKS: Final = 600  # all intervals are tried: limits time and memory
FEWEST_BLOCKS: Final = 24  # six for each bin
BINS: Final = 4
CELLS: Final = 3  # of places, along and across
FEWEST_IN_CELL: Final = 5
LEAST_NATS: Final = 3.0  # odds of 20 to 1
LONGEST_SHARE: Final = 0.6  # of a drive: longer is not an interval but the rule
MOST_COLOUR: Final = 0.95  # correlation of neighbouring blocks: more is indistinguishable from a trend
LEAST_SQUARE: Final = 1e-9  # of blocks without noise
SLOWEST_M_S: Final = 0.05  # slower has no curvature
SHOWN_SHARE: Final = 1e-3  # of the largest edge of a bin: smaller edges are shown as 0
ROBOT: Final = ("slip", "gyro")  # whose noise may be physics, unlike the reference's
WHO: Final = {
    "slip": "the wheel noise",
    "gyro": "the gyro noise",
    "position": "the reference position noise",
    "heading": "the reference heading noise",
}
STATED_BY: Final = {
    "slip": "slip_noise_m_per_sqrt_m",
    "gyro": "gyro_angle_random_walk_deg_per_sqrt_h",
    "position": "reference_position_sigma_m",
    "heading": "reference_heading_sigma_deg",
}
STATED: Final = "the stated value"
UNSTATED: Final = "the usual value (robot.yaml states none)"
WHERE: Final = {
    "speed": ("at speeds of", "m/s"),
    "turn_rate": ("at yaw rates of", "deg/s"),
    "curvature": ("at curvatures of", "1/m"),
    "acceleration": ("at accelerations of", "m/s^2"),
    "place": ("around", "m"),
}


class _Rows(NamedTuple):
    """Residuals of a channel in fitted sigmas, one per row (k,)."""

    channel: str
    time_s: Array
    left: Array


@dataclass(frozen=True)
class _Blocks:
    """Blocks of a channel: numbers, edges, and logarithms of the mean square, (n,) each."""

    number: npt.NDArray[np.intp]
    begin_s: Array
    end_s: Array
    level: Array


@dataclass(frozen=True)
class _Law:
    """Levels by bins of a covariate: the bin of each block (n,), the bins' names and middles, and the gain, nats."""

    covariate: str
    bins: npt.NDArray[np.intp]
    names: Sequence[str]
    middles: Array
    gain: float


def scatter_of(problem: Problem, left: Array, nominal: Robot) -> tuple[list[Scatter], list[Spread]]:
    """Locate each noise above MOST_NOISE times its datasheet, and give its course. `left` (r,): the fit's residual."""
    sheet = datasheet(nominal)
    told, courses = [], []
    sizes = ratios(problem)
    for rows in _channels(problem, left):
        ratio = sizes.get(rows.channel) or 0.0
        if ratio <= MOST_NOISE:
            continue
        blocks = _blocks(rows)
        law = _best_law(problem, rows.channel, blocks)
        is_stated = getattr(sheet, STATED_BY[rows.channel]) is not None
        at_rest = " at rest" if rows.channel == "gyro" and problem.evidence.has_wheels else ""
        who = WHO[rows.channel] + at_rest
        one = _scatter(rows.channel, ratio, blocks, law, who, STATED if is_stated else UNSTATED)
        told.append(_with_jitter(one, problem.noise.jitter_s) if rows.channel == "slip" else one)
        size = ratio * np.exp(0.5 * (blocks.level - blocks.level.mean())) if len(blocks.level) else blocks.level
        courses.append(Spread(rows.channel, 0.5 * (blocks.begin_s + blocks.end_s), size))
    return told, courses


def is_loud(problem: Problem) -> bool:
    """Whether the robot's own noise is so much larger than stated that it may hide physics."""
    sizes = ratios(problem)
    return any((sizes.get(name) or 0.0) > MOST_NOISE for name in ROBOT)


def _channels(problem: Problem, left: Array) -> Iterator[_Rows]:
    """Rows by channel. Without a gyro the fixes stand for the wheels, and without wheels for the gyro."""
    e = problem.evidence
    wheels, fixes = not_inflated(problem, left)
    if e.has_wheels and len(wheels):
        yield _Rows("slip", e.time_s[~e.still], wheels[~e.still])
        yield _Rows("gyro", e.time_s[e.still], wheels[e.still])
    if not len(fixes):
        return
    time_s, square = e.fix_time_s, fixes**2
    if e.has_wheels and not len(wheels):
        yield _Rows("slip", time_s, np.sqrt(square.mean(axis=1)))
    if e.has_wheels:
        yield _Rows("position", time_s, np.sqrt(square[:, :2].mean(axis=1)))
    else:
        yield _Rows("gyro", time_s, fixes[:, 2])
    yield _Rows("heading", time_s, fixes[:, 2])


def _blocks(rows: _Rows) -> _Blocks:
    """Blocks of equal length with enough rows."""
    t = rows.time_s
    if len(t) < BLOCK_ROWS:
        return _Blocks(np.zeros(0, np.intp), *(np.zeros(0) for _ in range(3)))
    span_s = max(BLOCK_S, BLOCK_ROWS * float(np.median(np.diff(t))), float(t[-1] - t[0]) / MOST_BLOCKS)
    index = np.asarray((t - t[0]) / span_s, np.intp)
    count = np.bincount(index)
    number = np.flatnonzero(count >= BLOCK_ROWS)
    square = np.bincount(index, rows.left**2)[number] / count[number]
    begin_s = t[0] + span_s * number
    end_s = np.minimum(begin_s + span_s, t[-1])
    return _Blocks(number, begin_s, end_s, np.log(np.maximum(square, LEAST_SQUARE)))


def _best_law(problem: Problem, channel: str, blocks: _Blocks) -> _Law | None:
    """The covariate whose bins make the levels most likely; None if none is worth its bins."""
    if channel == "gyro" or len(blocks.level) < FEWEST_BLOCKS:  # at rest no covariate varies
        return None
    laws = list(_laws(problem, blocks))
    best = max(laws, key=lambda law: law.gain, default=None)
    return best if best is not None and best.gain - math.log(len(laws)) > LEAST_NATS else None


def _laws(problem: Problem, blocks: _Blocks) -> Iterator[_Law]:
    m = problem.sensitivities.motion
    middle_s = 0.5 * (blocks.begin_s + blocks.end_s)

    def mean(values: Array, time_s: Array = m.time_s) -> Array:
        """Means over each block."""
        total = cumulative(0.5 * (values[1:] + values[:-1]) * np.diff(time_s))
        ends = [np.interp(at_s, time_s, total) for at_s in (blocks.begin_s, blocks.end_s)]
        return np.asarray((ends[1] - ends[0]) / np.maximum(blocks.end_s - blocks.begin_s, 1e-9), float)

    speed, rate = mean(np.abs(m.speed_m_s)), mean(np.abs(m.rate_rad_s))
    scalars = {
        "speed": speed,
        "turn_rate": DEG_PER_RAD * rate,
        "curvature": rate / np.maximum(speed, SLOWEST_M_S),
        "acceleration": mean(np.abs(m.acceleration_m_s2)),
    }
    for name, x in scalars.items():
        edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))
        bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
        shown = [f"{edge:.2g}" for edge in np.where(edges > SHOWN_SHARE * edges[-1], edges, 0.0)]
        spans = [f"{a} to {b}" for a, b in pairwise(shown)]
        if len(set(bins.tolist())) > 1:
            yield _Law(name, bins, spans, 0.5 * (edges[1:] + edges[:-1]), _gain(blocks.level, bins))
    edges_s = problem.evidence.edges_s
    xy = [np.interp(middle_s, edges_s, problem.path.pose[:, i]) for i in (0, 1)]
    bins, names = _cells(*xy)
    if len(names) > 1:
        yield _Law("place", bins, names, np.arange(len(names), dtype=float), _gain(blocks.level, bins))


def _cells(x: Array, y: Array) -> tuple[npt.NDArray[np.intp], list[str]]:
    """The cell of each place, and the cells' middles in words; cells with few blocks are merged."""
    ends = [np.linspace(v.min(), v.max() + 1e-9, CELLS + 1) for v in (x, y)]
    along, across = (np.searchsorted(e, v, side="right") - 1 for e, v in zip(ends, (x, y), strict=True))
    cell = np.clip(along, 0, CELLS - 1) * CELLS + np.clip(across, 0, CELLS - 1)
    kept = [c for c in range(CELLS**2) if np.sum(cell == c) >= FEWEST_IN_CELL]
    bins = np.array([kept.index(c) if c in kept else len(kept) for c in cell.tolist()], np.intp)
    middles = [0.5 * (e[1:] + e[:-1]) for e in ends]
    names = [f"x = {middles[0][c // CELLS]:.2g}, y = {middles[1][c % CELLS]:.2g}" for c in kept]
    return bins, [*names, "the rest"] if np.any(bins == len(kept)) else names


def _gain(level: Array, bins: npt.NDArray[np.intp]) -> float:
    """Gain in log likelihood of means by bins over one mean, less the cost of the means, nats. (78)"""
    rest = level - _means(level, bins)[bins]
    worth = _worth(rest)
    whole = float(np.sum((level - level.mean()) ** 2))
    count = len(set(bins.tolist()))
    return 0.5 * worth * math.log(whole / max(float(rest @ rest), 1e-12)) - 0.5 * (count - 1) * math.log(worth)


def _means(level: Array, bins: npt.NDArray[np.intp]) -> Array:
    mean: Array = np.bincount(bins, level) / np.maximum(np.bincount(bins), 1)
    return mean


def _worth(rest: Array) -> float:
    """Effective number of independent blocks among these autocorrelated ones (n,)."""
    square = float(rest @ rest)
    colour = float(rest[1:] @ rest[:-1]) / square if square > 0.0 else 0.0
    colour = min(max(colour, 0.0), MOST_COLOUR)
    return max(len(rest) * (1.0 - colour) / (1.0 + colour), 2.0)


def _interval(rest: Array) -> tuple[int, int, float] | None:
    """The noisiest interval [i, j) of blocks (n,), by likelihood ratio, and its nats; None if none is significant."""
    n = len(rest)
    if n < FEWEST_BLOCKS:
        return None
    rest = rest - rest.mean()
    total = cumulative(rest)
    i, j = np.triu_indices(n + 1, k=2)
    inside = j - i
    fitting = inside <= LONGEST_SHARE * n
    i, j, inside = i[fitting], j[fitting], inside[fitting]
    sums = total[j] - total[i]
    explained = np.where(sums > 0.0, sums**2 * (1.0 / inside + 1.0 / (n - inside)), 0.0)
    k = int(np.argmax(explained))
    begin, end = int(i[k]), int(j[k])
    other = rest.copy()
    other[begin:end] -= rest[begin:end].mean()
    square = float(rest @ rest)
    worth = _worth(other - other.mean())
    nats = 0.5 * worth * math.log(square / max(square - float(explained[k]), 1e-12))
    nats -= 0.5 * math.log(worth) + math.log(n * (n - 1) / 2.0)
    return (begin, end, nats) if nats > LEAST_NATS else None


def _scatter(channel: str, ratio: float, blocks: _Blocks, law: _Law | None, who: str, stated: str) -> Scatter:
    level = blocks.level - blocks.level.mean() if len(blocks.level) else blocks.level
    levels: tuple[Level, ...] = ()
    rest = level
    if law is not None:
        means = _means(level, law.bins)
        rest = level - means[law.bins]
        counts = np.bincount(law.bins) * _worth(rest) / len(rest)
        sigma = 0.5 * float(rest.std()) / np.sqrt(np.maximum(counts, 1.0))
        size = ratio * np.exp(0.5 * means)
        rows = zip(law.names, law.middles.tolist(), size.tolist(), (sigma * size).tolist(), strict=True)
        levels = tuple(Level(*row) for row in rows)
    found = _interval(rest)
    window: Window | None = None
    window_ratio = None
    if found is not None:
        begin, end, _ = found
        window = float(blocks.begin_s[begin]), float(blocks.end_s[end - 1])
        window_ratio = ratio * math.exp(0.5 * float(level[begin:end].mean()))
    return Scatter(
        channel=channel,
        ratio=ratio,
        covariate=None if law is None else law.covariate,
        unit="" if law is None else WHERE[law.covariate][1],
        levels=levels,
        nats=None if law is None else law.gain,
        window=window,
        window_ratio=window_ratio,
        window_nats=None if found is None else found[2],
        sentence=f"{who} is {ratio:.2g} times {stated}" + _located(law, levels, window, window_ratio),
    )


def _with_jitter(scatter: Scatter, jitter_s: float) -> Scatter:
    """Add the timing jitter to the wheels' scatter."""
    if not jitter_s:
        return scatter
    text = (
        f"{scatter.sentence}, largest where the speeds change, like a timing jitter of {jitter_s:.2g} s between changes"
        ", as from a motor drive that holds its speeds"
    )
    return msgspec.structs.replace(scatter, jitter_s=jitter_s, sentence=text)


def _located(law: _Law | None, levels: Sequence[Level], window: Window | None, window_ratio: float | None) -> str:
    """Where and when it is largest, in words."""
    text = ""
    if law is not None:
        where, unit = WHERE[law.covariate]
        most, least = (choose(levels, key=lambda row: row.ratio) for choose in (max, min))
        text += f", largest {where} {most.at} {unit} ({most.ratio:.2g} times; {least.ratio:.2g} times at {least.at})"
    if window is not None:
        text += f", {'and ' if law is not None else ''}larger from {window[0]:.0f} to {window[1]:.0f} s"
        text += f" ({window_ratio:.2g} times)"
    return text
