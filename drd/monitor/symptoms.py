"""Faults that the readings show by logic, before any regression: clipped and muted rates, stopped counters. (99)"""

import itertools
from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.effects.effect import SIDES, Symptom
from drd.monitor.rows import STANDS_M, Rows

Flags = npt.NDArray[np.bool_]

SAME, SAME_SHARE = 1e-6, 0.6  # readings in a steady turn scatter below the largest one, those at a limit do not
ALIKE: Final = 3e-4  # relative: two readings at a limit, of a gyro that rounds
FEWEST_CLIPPED: Final = 10  # readings: fewer at one value are chance
FEWEST_HERE: Final = 4  # of them in one block
FASTER_SHARE: Final = 0.05  # of the limit, by which the wheels must turn faster: no tread is known better
BELOW: Final = 0.5  # of the largest rate: turns above this, but below the limit, show the tread on this ground
KEEPS: Final = 0.7  # memory factor per block: ground changes within some blocks
SIGMAS: Final = 8.0  # nearly certain: no regression checks it again
MISSED_SHARE: Final = 0.5  # of the other wheel's travel, that a stopped wheel must have missed
MISSED_M: Final = 0.15
STOPPED_S: Final = 0.5
ZERO_RAD_S: Final = 1e-6  # no gyro has so small a digit
FEWEST_ZEROS: Final = 30
FEWEST_SILENT: Final = 10  # zeros: a gyro that reads its noise has not as many without other small readings
MUTED_SIGMAS: Final = 6.0  # of the gyro's noise, below which rates are missing
BLOCKS: Final = 30  # in which muted rates are counted: a minute
SAME_SIGMAS: Final = 3.0  # of its noise, within which two readings may be of one rate
SURE_SIGMAS: Final = 3.0
LEAST_READINGS: Final = 8  # that show where a dead band ends: further ones lie too far beyond for an even density


@dataclass
class Seen:
    """A symptom of a side (or none), with begin and end (s) and size (SI). `sure`: it was seen often enough."""

    symptom: Symptom
    side: str
    begin_s: float
    end_s: float
    size: float = 0.0
    std: float = 0.0
    count: float = 0.0
    sure: bool = False
    is_told: bool = False
    named_s: float = 0.0


class _Small(NamedTuple):
    """A block's begin, its rows of zero rate and others, the least of these, and the least nonzero readings."""

    begin_s: float
    zeros: int
    others: int
    least_rad_s: float
    readings_rad_s: Array


class Symptoms:
    """Examines each block; `seen`: the symptoms found. `look` returns flags of useless rows, (n,)."""

    def __init__(self, tread_m: float):
        self._tread_m = tread_m
        self.seen: dict[tuple[Symptom, str], Seen] = {}
        self._small: deque[_Small] = deque(maxlen=BLOCKS)
        self._dead = 0  # number of zeros in faster turns, while there is nothing else
        self._shown = self._older = np.zeros(0)  # readings beyond a dead band since it was found, and before
        self._stops: dict[str, tuple[float, float, float]] = {}
        self._below_rad = 0.0, 0.0  # turn of the wheels and of the gyro, at rates below the largest

    def look(
        self, rows: Rows, by_wheels: Array, tread: float, bias_rad_s: float, wheel_var: Array, gyro_s: float
    ) -> Flags:
        """`by_wheels`, `wheel_var`: turn over the nominal tread and its variance, all rows; `tread`: relative to it.

        `gyro_s`: standard deviation of the gyro's turn in a row.
        """
        inner = rows.inner
        wheels = by_wheels[inner] / tread
        useless = self._clipped(rows, wheels, wheel_var[inner], gyro_s)
        useless |= self._muted(rows, wheels, wheel_var[inner], gyro_s)
        for side, mine, its, sign in (
            (SIDES[0], rows.left_m, rows.right_m, -1.0),
            (SIDES[1], rows.right_m, rows.left_m, 1.0),
        ):
            turned = rows.gyro_rad - bias_rad_s * rows.interval_s
            should_m = its + sign * tread * self._tread_m * turned
            useless |= self._stopped(rows, side, mine[inner], its[inner], should_m[inner])
        return useless

    def _clipped(self, rows: Rows, wheels: Array, variance: Array, gyro_s: float) -> Flags:
        inner = rows.inner
        h, turned = rows.interval_s[inner], rows.gyro_rad[inner]
        rate = turned / h
        limit = float(np.abs(rate).max())
        at = (np.abs(rate) > limit * (1.0 - ALIKE)) & rows.is_good[inner]
        none = np.zeros(len(rate), bool)
        known = self.seen.get((Symptom.CLIPPED, ""))
        if known is not None and known.sure:
            none = _beside(np.abs(rate) > known.size * (1.0 - ALIKE))
        if limit <= 0.0:
            return none
        faster = self._faster(np.sign(turned) * wheels, np.abs(turned), np.abs(rate) / limit, rows.is_good[inner])
        same = np.abs(rate) > limit * (1.0 - SAME)
        near = np.abs(rate) > min(limit * (1.0 - ALIKE), limit - MUTED_SIGMAS * gyro_s / float(np.median(h)))
        if at.sum() < FEWEST_HERE or same.sum() < SAME_SHARE * near.sum():
            return none
        excess = (np.sign(turned) * wheels - faster * np.abs(turned))[at]
        if excess.mean() < FASTER_SHARE * limit * float(h[at].mean()):
            return none
        key = (Symptom.CLIPPED, "")
        end_s = rows.end_s[inner]
        found = self.seen.get(key)
        if found is None or abs(found.size - limit) > ALIKE * limit:
            found = self.seen[key] = Seen(Symptom.CLIPPED, "", float((end_s - h)[at][0]), 0.0, limit, ALIKE * limit)
        found.end_s, found.count = float(end_s[at][-1]), found.count + float(at.sum())
        found.sure |= found.count >= FEWEST_CLIPPED and float(excess.sum()) > SIGMAS * float(variance[at].sum()) ** 0.5
        return _beside(at) | none

    def _faster(self, wheels: Array, gyro: Array, share: Array, is_good: Flags) -> float:
        """Ratio of the wheels' turn to the gyro's below the limit, at least one: a wrong tread is no limit."""
        below = (share > BELOW) & (share < 1.0 - ALIKE) & is_good
        by_wheels, by_gyro = self._below_rad
        if below.any():
            by_wheels = KEEPS * by_wheels + float(wheels[below].sum())
            by_gyro = KEEPS * by_gyro + float(gyro[below].sum())
            self._below_rad = by_wheels, by_gyro
        return max(by_wheels / by_gyro, 1.0) if by_gyro > 0.0 else 1.0

    def _muted(self, rows: Rows, wheels: Array, variance: Array, gyro_s: float) -> Flags:
        inner = rows.inner
        good, h = rows.is_good[inner], rows.interval_s[inner]
        rate = np.abs(rows.gyro_rad[inner] / h)[good]
        if not len(rate):
            return ~good
        begin_s = float(rows.end_s[inner][0] - h[0])
        others = rate[rate > ZERO_RAD_S]
        sigma_rad_s = gyro_s / float(np.median(h))
        shown = _apart(np.abs(rows.readings_rad_s), SAME_SIGMAS * sigma_rad_s)
        least = float(others.min()) if len(others) else np.inf
        self._small.append(_Small(begin_s, len(rate) - len(others), len(others), least, shown))
        # From the newest block backwards: no small rate, and zeros.
        muted = list(itertools.takewhile(lambda b: b.least_rad_s >= MUTED_SIGMAS * sigma_rad_s, reversed(self._small)))
        zeros = sum(b.zeros for b in muted)
        key = (Symptom.MUTED, "")
        found = self.seen.get(key)
        if found is None and min(zeros, sum(b.others for b in muted)) >= FEWEST_ZEROS:
            since_s = min(b.begin_s for b in muted if b.zeros)
            found = self.seen[key] = Seen(Symptom.MUTED, "", since_s, begin_s, sure=True)
            self._older = np.concatenate([b.readings_rad_s for b in muted])
        elif found is not None and zeros:
            self._shown = _apart(np.concatenate([self._shown, shown]), SAME_SIGMAS * sigma_rad_s)
            found.end_s = begin_s if muted[0].zeros else found.end_s
        if found is not None:
            found.size, found.std = self._end_of_band(SAME_SIGMAS * sigma_rad_s)
            most_rad_s = found.size + SURE_SIGMAS * found.std
        elif zeros >= FEWEST_SILENT:
            most_rad_s = min((b.least_rad_s for b in muted if b.others), default=0.0)
        else:
            return np.zeros(len(good), bool)
        # A false zero would pass for another bias; a zero in a faster turn is not due to a dead band.
        slow = np.abs(wheels) <= most_rad_s * h + SURE_SIGMAS * np.sqrt(variance)
        is_zero = np.abs(rows.gyro_rad[inner]) <= ZERO_RAD_S * h
        self._dead = 0 if len(others) else self._dead + int((is_zero & ~slow & good).sum())
        if self._dead >= FEWEST_ZEROS:  # nor is there a dead band if only zeros are read
            self.seen.pop(key, None)
            return np.zeros(len(good), bool)
        return np.asarray(is_zero & slow)

    def _end_of_band(self, step_rad_s: float) -> tuple[float, float]:
        """End of a dead band, and its deviation: before the least reading beyond it by the mean spacing of the least
        readings, with a deviation of as much (Robson and Whitlock 1964).
        """
        least = self._shown
        if len(least) < LEAST_READINGS:  # earlier ones may be older than the dead band
            least = _apart(np.concatenate([least, self._older]), step_rad_s)
        first, last = float(least[0]), float(least[-1])
        std = min((last - first) / max(len(least) - 1, 1) or first, 0.5 * first)
        return first - std, std

    def _stopped(self, rows: Rows, side: str, mine: Array, its: Array, should_m: Array) -> Flags:
        inner = rows.inner
        h, end_s = rows.interval_s[inner], rows.end_s[inner]
        missing = (np.abs(mine) < STANDS_M) & (np.abs(should_m) > MISSED_SHARE * np.abs(its)) & (np.abs(its) > STANDS_M)
        missing &= rows.is_good[inner]
        begin, travel, other = self._stops.get(side, (-1.0, 0.0, 0.0))
        for k in range(len(h)):
            if not missing[k]:
                begin, travel, other = -1.0, 0.0, 0.0
                continue
            begin = float(end_s[k] - h[k]) if begin < 0.0 else begin
            travel, other = travel + float(should_m[k]), other + abs(float(its[k]))
            if end_s[k] - begin >= STOPPED_S and abs(travel) > max(MISSED_M, MISSED_SHARE * other):
                key = (Symptom.STOPPED, side)
                found = self.seen.setdefault(key, Seen(Symptom.STOPPED, side, begin, 0.0, sure=True))
                found.end_s = float(end_s[k])
        self._stops[side] = begin, travel, other
        return _beside(missing)


def _apart(readings: Array, step: float) -> Array:
    """The least nonzero readings, in order; a steady rate that is read repeatedly counts once."""
    some = np.sort(readings[readings > ZERO_RAD_S])
    _, at = np.unique(np.floor(some / max(step, ZERO_RAD_S)), return_index=True)
    return np.asarray(some[at][:LEAST_READINGS])


def _beside(flags: Flags) -> Flags:
    """Flags of these rows and their neighbours, within which the fault may begin or end."""
    found = flags.copy()
    found[1:] |= flags[:-1]
    found[:-1] |= flags[1:]
    return found
