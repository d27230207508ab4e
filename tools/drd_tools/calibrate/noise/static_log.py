"""A gyro's log at standstill: read from CSV, checked, made evenly spaced, and refused if the gyro moved."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.stats import median_abs_deviation

from drd.arrays import Array, cumulative
from drd.batch.logs import RATE, RATE_AND_TEMPERATURE
from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD, RAD_PER_DEG
from drd_tools import robust
from drd_tools.recordings.folder import file_hash, read_table

FILE_NAME: Final = "fog.csv"
SHORTEST_S: Final = 100.0
# Number of samples over which the period is averaged, since samples may arrive in bursts.
SPACING: Final = 100
# Number of samples on each side of a long step that show whether it was a loss or only a delay.
NEIGHBOURS: Final = 20
# Gaps up to this long are bridged, if few; the log is cut at longer ones.
BRIDGED_S: Final = 1.0
BRIDGED_PART: Final = 0.01
# No gyro for dead reckoning has a larger offset: it turns, or its rate has another unit.
LARGEST_OFFSET_DEG_S: Final = 1.0
MOTION_BLOCK_S: Final = 1.0
MOTION_SIGMAS: Final = 8.0
# Smaller steps of the rate, lasting a second, do not count as motion.
SMALLEST_MOTION_DEG_S: Final = 0.02
# Scatter of blocks over that expected from sample-to-sample noise; flicker and random walk stay far below in 1 s.
EXCESS: Final = 5.0
DRIFT_BLOCKS: Final = 61
ROUNDS: Final = 50  # fixed-point iterations, enough for full precision


@dataclass(frozen=True)
class StaticLog:
    """Evenly spaced means of the rate, shape (n,), rad/s, counter-clockwise positive; the first is at time 0.

    `temperature_c` is shape (n,) or None. `begins_s` is the first sample's time in the file; `notes` are sentences on
    changes made to the log.
    """

    file: str
    sha256: str
    interval_s: float
    rate_rad_s: Array
    temperature_c: Array | None
    begins_s: float
    notes: tuple[str, ...] = ()

    @property
    def time_s(self) -> Array:
        """Time of each sample since the first, s."""
        return np.asarray(np.arange(len(self.rate_rad_s)) * self.interval_s)

    @property
    def duration_s(self) -> float:
        """Length of the log, s."""
        return len(self.rate_rad_s) * self.interval_s

    def after(self, seconds: float) -> "StaticLog":
        """The log without its first seconds."""
        first = math.ceil(seconds / self.interval_s - 1e-9)
        temperature_c = None if self.temperature_c is None else self.temperature_c[first:]
        begins_s = self.begins_s + first * self.interval_s
        return replace(self, rate_rad_s=self.rate_rad_s[first:], temperature_c=temperature_c, begins_s=begins_s)


def read_static_log(path: Path) -> StaticLog:
    """Read a CSV file, or fog.csv in a recording's folder. Raises ConfigError, also if the gyro moved."""
    file = path / FILE_NAME if path.is_dir() else path
    # A gyro that sends its temperature only occasionally leaves empty cells.
    cells = {"temperature_c": lambda cell: float(cell.strip() or "nan")}
    table = read_table(file, (RATE_AND_TEMPERATURE, RATE), 2, among=True, cells=cells, rising=False)
    time_s, rate_deg_s, *rest = table.values.T
    log = even(str(file), file_hash(file), time_s, rate_deg_s, rest[0] if rest else None)
    check_standstill(log)
    return log


def even(file: str, sha256: str, time_s: Array, rate_deg_s: Array, temperature_c: Array | None) -> StaticLog:
    """Extract the longest interval without a gap, as evenly spaced samples. Raises ConfigError if it is too short.

    Jitter of the time stamps is ignored: the gyro itself samples evenly, and Allan's differences need only that.
    A few short gaps are interpolated linearly; the log is cut at longer ones, or at all of them if there are many.
    """
    period_s = _period_s(time_s)
    if period_s <= 0.0:
        raise ConfigError(file, "time_s", "rising times", f"{time_s[0]:.12g} in most rows")
    step_s, lost = np.diff(time_s), _lost(time_s, period_s)
    holes = lost > 0.0
    short = holes & (step_s <= BRIDGED_S)
    cuts = holes & ~short if lost[short].sum() <= BRIDGED_PART * len(time_s) else holes
    first, last = _longest(cuts)
    notes = []
    if cuts.any():
        notes.append(
            f"{int(cuts.sum())} holes in the log: only the longest interval without, from {time_s[first]:.12g} s to "
            f"{time_s[last]:.12g} s, is used."
        )
    place = cumulative(1.0 + lost[first:last])
    grid = np.arange(place[-1] + 1.0)
    if len(grid) > len(place):
        bridged = len(grid) - len(place)
        notes.append(f"{bridged} lost samples ({bridged / len(grid):.2%}) were bridged with straight lines.")
    rate_rad_s = np.interp(grid, place, rate_deg_s[first : last + 1]) * RAD_PER_DEG
    interval_s = float((time_s[last] - time_s[first]) / max(len(grid) - 1, 1))
    if len(grid) * interval_s < SHORTEST_S:
        got = f"{len(grid) * interval_s:.4g} s" + (f" ({notes[0]})" if cuts.any() else "")
        raise ConfigError(file, "", f"a standstill of at least {SHORTEST_S:g} s, better an hour", got)
    temperature = None
    if temperature_c is not None and (known := np.isfinite(temperature_c[first : last + 1])).any():
        temperature = np.interp(grid, place[known], temperature_c[first : last + 1][known])
    return StaticLog(file, sha256, interval_s, rate_rad_s, temperature, float(time_s[first]), tuple(notes))


def _period_s(time_s: Array) -> float:
    k = min(SPACING, len(time_s) - 1)
    return float(np.median(time_s[k:] - time_s[:-k])) / k


def _lost(time_s: Array, period_s: float) -> Array:
    """Samples missing between each sample and the next, shape (n - 1,).

    A long step counts only if the samples after it stay late: after a burst, or on a busy host, they catch up. If
    samples come in bursts, the step must be longer than those between bursts.
    """
    step_s = np.diff(time_s)
    off_s = np.abs(step_s - period_s)
    is_even = np.median(off_s) < 0.25 * period_s
    long_s = 1.5 * period_s if is_even else 5.0 * period_s + 2.0 * np.quantile(off_s, 0.99)
    late_s = time_s - period_s * np.arange(len(time_s))
    lost = np.zeros(len(time_s) - 1)
    for i in np.flatnonzero(step_s > long_s):
        before, after = late_s[max(i - NEIGHBOURS, 0) : i + 1], late_s[i + 1 : i + 1 + NEIGHBOURS]
        # Compare the least delayed samples: delays are never negative.
        lost[i] = max(0.0, round((after.min() - before.min()) / period_s))
    return lost


def _longest(cuts: npt.NDArray[np.bool_]) -> tuple[int, int]:
    """First and last sample of the longest interval between cuts."""
    ends = np.concatenate([[-1], np.flatnonzero(cuts), [len(cuts)]])
    longest = int(np.argmax(np.diff(ends)))
    return int(ends[longest]) + 1, int(ends[longest + 1])


def check_standstill(log: StaticLog) -> None:
    """Raise ConfigError if the rate is constant, is too large for a standstill, or has steps far above its noise."""
    rate_deg_s = log.rate_rad_s * DEG_PER_RAD
    if np.ptp(rate_deg_s) == 0.0:
        got = f"{rate_deg_s[0]:g} in all rows: the gyro is dead, or its numbers too coarse to show the noise"
        raise ConfigError(log.file, "rate_deg_s", "a rate that varies", got)
    offset_deg_s = float(np.median(rate_deg_s))
    if abs(offset_deg_s) > LARGEST_OFFSET_DEG_S:
        expected = f"a standstill: a mean within {LARGEST_OFFSET_DEG_S:g} deg/s"
        raise ConfigError(log.file, "rate_deg_s", expected, f"{offset_deg_s:.3g} deg/s: it turns, or the unit is wrong")
    moved = motion(log)
    if moved is not None:
        at_s, size_deg_s, limit_deg_s = moved
        got = f"a rate of {size_deg_s:.3g} deg/s at {at_s:.12g} s (limit {limit_deg_s:.2g}); cut the log, or repeat it"
        raise ConfigError(log.file, "rate_deg_s", "a standstill throughout", got)


def motion(log: StaticLog) -> tuple[float, float, float] | None:
    """Time in the file (s), size and limit (deg/s) of the first one-second mean that noise cannot explain, or None.

    Limit: MOTION_SIGMAS times the blocks' robust scatter about a one-minute running median, capped at EXCESS times
    what the sample-to-sample scatter explains: beyond that the gyro moved most of the time.
    """
    rate_deg_s, size = log.rate_rad_s * DEG_PER_RAD, max(1, round(MOTION_BLOCK_S / log.interval_s))
    blocks = len(rate_deg_s) // size
    means = rate_deg_s[: blocks * size].reshape(blocks, size).mean(axis=1)
    half = min(DRIFT_BLOCKS, blocks) // 2
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(means, half, mode="reflect"), 2 * half + 1)
    off = np.abs(means - np.median(windows, axis=1))
    scatter = float(median_abs_deviation(np.diff(rate_deg_s), scale="normal")) / math.sqrt(2.0)
    expected = max(scatter, _resolution(rate_deg_s)) / math.sqrt(size)
    sigma = min(max(robust.deviation(off, 0.0), expected), EXCESS * expected)
    limit = max(MOTION_SIGMAS * sigma, SMALLEST_MOTION_DEG_S)
    late = np.flatnonzero(off > limit)
    if not len(late):
        return None
    return log.begins_s + float(late[0]) * size * log.interval_s, float(off[late[0]]), limit


def rounding_rad_s(log: StaticLog) -> float:
    """Standard deviation of the mean due to rounding of the readings, rad/s.

    Noise of variance v, in squared steps, leaves a fraction exp(-2 pi^2 v) of it (Widrow's theorem) and gives the
    readings a variance of v + 1/12, to within 1/6 of the same fraction: the smallest such v is used.
    """
    step = _resolution(log.rate_rad_s * DEG_PER_RAD) * RAD_PER_DEG
    if step == 0.0:
        return 0.0
    scatter, part = float(np.var(log.rate_rad_s)) / step**2, 1.0
    for _ in range(ROUNDS):
        part = math.exp(-2.0 * math.pi**2 * max(scatter - 1.0 / 12.0 - part / 6.0, 0.0))
    return step / math.sqrt(12.0) * part


def _resolution(rate_deg_s: Array) -> float:
    """Smallest step between readings, deg/s; 0 if there is none."""
    steps = np.diff(np.unique(rate_deg_s))
    steps = steps[steps > 1e-9]
    return float(steps.min()) if len(steps) else 0.0
