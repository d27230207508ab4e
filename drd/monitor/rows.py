"""Samples become rows: the gyro's turn and the wheels' distances over the same time, in blocks of some seconds."""

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array, cumulative
from drd.samples import GyroSample, WheelSample
from drd.units import NS_PER_S, S_PER_NS

BLOCK_S: Final = 2.0
ROW_S: Final = 0.1  # a wheel turns by less than two radians in it at 1.5 m/s, so that its ripple is seen
LEAD_ROWS: Final = 12  # before a block, for delays and lags
PENDING: Final = 1 << 16  # samples of a sensor: more than arrive at 2000 Hz while waiting for the other one
# A gyro sample this many intervals after the one before is not the next one.
GAP: Final = 1.5
WAIT_S: Final = 20.0  # for a sensor, while the other one continues
STALE_S: Final = 0.5  # between two wheel samples: longer gaps are not interpolated
STANDS_M: Final = 1e-6


@dataclass(frozen=True)
class Rows:
    """Rows of a block, shape (n,), with `lead` earlier rows before it and one later row at its end.

    `end_s` counts from the first sample. `is_good`: both sensors saw all of the row. `left_m`, `right_m`: the wheels'
    distances in it. `left_total_m`, `right_total_m`: their totals at its end. `readings_rad_s`: the gyro's readings in
    the block.
    """

    end_s: Array
    interval_s: Array
    gyro_rad: Array
    temperature_c: Array
    left_m: Array
    right_m: Array
    left_total_m: Array
    right_total_m: Array
    is_good: npt.NDArray[np.bool_]
    lead: int
    end_ns: int
    readings_rad_s: Array

    @property
    def inner(self) -> slice:
        """The block's own rows."""
        return slice(self.lead, len(self.end_s) - 1)


class RowMaker:
    """Makes rows from both sensors' samples, each in order of time; `take` gives a block once both have passed it."""

    def __init__(self) -> None:
        self.zero_ns: int | None = None
        self._gyro: deque[tuple[float, float, float, float]] = deque(maxlen=PENDING)  # end, interval, rate, temperature
        self._wheels: deque[tuple[float, float, float, float, bool]] = deque(maxlen=PENDING)
        self._total_m = (0.0, 0.0)
        self._heard_s = -np.inf, -np.inf
        self._next_s = 0.0
        self._kept: Array = np.zeros((0, 9))
        self._late_s = 0.0  # delay of the wheels, by which their stamps are corrected

    def gyro(self, sample: GyroSample) -> None:
        """A sample of the gyro."""
        end_s = self._since(sample.t_ns)
        self._gyro.append((end_s, sample.interval_s, sample.rate_rad_s, sample.temperature_c))
        self._heard_s = end_s, self._heard_s[1]

    def wheels(self, sample: WheelSample) -> None:
        """A sample of the wheels."""
        end_s = self._since(sample.t_ns) - self._late_s
        left, right = self._total_m
        is_new = not self._wheels or sample.lost_s > 0.0
        if is_new:
            self._wheels.append((end_s - sample.interval_s, left, right, np.nan, True))
        self._total_m = left + sample.left_m, right + sample.right_m
        self._wheels.append((end_s, *self._total_m, np.nan, False))
        self._heard_s = self._heard_s[0], end_s

    def put_right(self, late_s: float) -> None:
        """Shift the wheels' stamps from now on, whose samples are older by `late_s`; drop pending ones."""
        self._late_s += late_s
        self._wheels.clear()

    def take(self) -> Rows | None:
        """The next block, once both sensors have passed it and one more row. None: not yet."""
        end_s = self._next_s + BLOCK_S
        # A silent sensor leaves a gap, but does not end the rows.
        if min(self._heard_s) < end_s + 2.0 * ROW_S and max(self._heard_s) < end_s + WAIT_S:
            return None
        self._next_s = end_s
        fresh = self._table(end_s + 2.0 * ROW_S)
        ends = fresh[:, 0] if len(fresh) else np.zeros(0)
        count = int(np.searchsorted(ends, end_s + 1e-6))  # rows of the block; the others are made again
        lead = len(self._kept)
        rows = np.vstack([self._kept, fresh[: count + 1]])
        self._kept = rows[: lead + count][-LEAD_ROWS:]
        readings = self._forget(float(ends[count - 1]) if count else end_s)
        if count < 2 or len(rows) < lead + count + 1:
            return None
        columns = rows.T
        assert self.zero_ns is not None
        end_ns = self.zero_ns + round(end_s * NS_PER_S)
        end_s_, length, turn, warm, left, right, left_total, right_total, good = columns
        return Rows(
            end_s_, length, turn, warm, left, right, left_total, right_total, good > 0.5, lead, end_ns, readings
        )

    def _since(self, t_ns: int) -> float:
        if self.zero_ns is None:
            self.zero_ns = t_ns
        return (t_ns - self.zero_ns) * S_PER_NS

    def _forget(self, before_s: float) -> Array:
        """Forget samples that no later row needs; returns the gyro's readings among them."""
        readings = []
        while self._gyro and self._gyro[0][0] <= before_s + 1e-9:
            readings.append(self._gyro.popleft()[2])
        while len(self._wheels) > 2 and self._wheels[1][0] < before_s - 1.0:
            self._wheels.popleft()
        return np.array(readings)

    def _table(self, until_s: float) -> Array:
        """Rows of pending samples that end by a time, shape (n, 9): the columns of Rows, without the last two."""
        chosen = [g for g in self._gyro if g[0] <= until_s]
        if not chosen or len(self._wheels) < 2:
            return np.zeros((0, 9))
        end_s, interval_s, rate, temperature_c = np.array(chosen).T
        number = np.floor((end_s - 1e-3) / ROW_S)
        first = np.flatnonzero(np.diff(number, prepend=-np.inf))
        length_s = np.add.reduceat(interval_s, first)
        last = np.append(first[1:], len(end_s)) - 1
        ends = end_s[last]
        before = np.concatenate([[self._kept[-1, 0] if len(self._kept) else -np.inf], end_s[:-1]])
        joined = np.abs(end_s - interval_s - before) < (GAP - 1.0) * interval_s + 2e-3
        good = np.logical_and.reduceat(joined, first)
        knots = np.array(self._wheels)
        at_s, left, right, is_new = knots[:, 0], knots[:, 1], knots[:, 2], knots[:, 4] > 0.5
        begins = ends - length_s
        totals = [np.interp(ends, at_s, total) for total in (left, right)]
        rolled = [now - np.interp(begins, at_s, total) for now, total in zip(totals, (left, right), strict=True)]
        hole = np.diff(at_s) > STALE_S
        hole |= is_new[1:]
        holes = cumulative(hole)
        k0, k1 = np.searchsorted(at_s, begins - 1e-9, "right"), np.searchsorted(at_s, ends - 1e-9)
        size = len(at_s)
        good &= (k0 > 0) & (k1 < size)
        good &= holes[np.minimum(k1, size - 1)] - holes[np.maximum(k0 - 1, 0)] < 0.5
        turn = np.add.reduceat(rate * interval_s, first)
        return np.column_stack([ends, length_s, turn, temperature_c[last], *rolled, *totals, good])
