"""Combine left and right readings, each with its own time, into samples of both wheels' travel over one interval."""

from dataclasses import dataclass
from math import isfinite, nan

from drd.samples import Side, WheelSample
from drd.units import NS_PER_S, S_PER_NS


@dataclass(slots=True)
class _Point:
    """One side's accumulated travel at a time, and whether a pair has used it."""

    t_ns: int
    travel_m: float
    used: bool = False


class _Track:
    """The last two points of one side. `older` is None where the travel between them is unknown."""

    __slots__ = ("newer", "older")

    def __init__(self) -> None:
        self.older: _Point | None = None
        self.newer: _Point | None = None

    def push(self, point: _Point, *, moved: bool) -> int:
        """Take the newest point; return how many points are discarded unused."""
        gone = (self.older,) if moved else (self.older, self.newer)
        self.older, self.newer = self.newer if moved else None, point
        return sum(point is not None and not point.used for point in gone)

    def at(self, t_ns: int, window_ns: int) -> float | None:
        """Travel at `t_ns` between the two points; None outside them or beyond the window around both."""
        older, newer = self.older, self.newer
        if newer is None:
            return None
        if newer.t_ns == t_ns:
            return newer.travel_m
        if older is None or not older.t_ns <= t_ns < newer.t_ns:
            return None
        if min(t_ns - older.t_ns, newer.t_ns - t_ns) > window_ns:
            return None
        part = (t_ns - older.t_ns) / (newer.t_ns - older.t_ns)
        return older.travel_m + (newer.travel_m - older.travel_m) * part

    def use(self) -> None:
        """Mark both points as used by a pair."""
        for point in (self.older, self.newer):
            if point is not None:
                point.used = True


class Pairing:
    """Pairs both sides' travel at common times: the older of the two newest readings, the other interpolated.

    Thus the skew between two nodes does not appear as a turn. Samples tile time: each begins where the last one ended,
    or `lost_s` after it. Two nodes give at most one sample per half nominal period, so that one pair of readings is
    one sample; readings of the same time always give one. `end`: time and both travels where the last one ended.
    """

    def __init__(self, window_s: float, gap_s: float, period_s: float):
        self.counters = {"unpaired": 0, "new_starts": 0}
        self._window_ns = round(window_s * NS_PER_S)
        self._gap_ns = round(gap_s * NS_PER_S)
        self._least_ns = round(0.5 * period_s * NS_PER_S)
        self._tracks = {side: _Track() for side in Side}
        self.end: tuple[int, float, float] | None = None
        self._broken = False  # a side's travel since then is not known
        self._untold = False  # nor can it be had from the counters
        self._lost_ns, self._lost_m = 0, 0.0

    def add(self, side: Side, t_ns: int, travel_m: float, *, moved: bool, told: bool = False) -> WheelSample | None:
        """Take one side's accumulated travel; times increase per side.

        `moved` is False where the travel since that side's last reading is not known or, with `told`, is known only
        over a gap. Returns the sample that this reading completes.
        """
        self.counters["unpaired"] += self._tracks[side].push(_Point(t_ns, travel_m), moved=moved)
        self._broken |= not moved
        self._untold |= not (moved or told)
        pair = self._newest_pair()
        if pair is None:
            return None
        for track in self._tracks.values():
            track.use()
        return self._sample_to(*pair)

    def _newest_pair(self) -> tuple[int, float, float] | None:
        """Newest time at which both sides' travel is known, and both travels; None if that gives no new sample."""
        left, right = self._tracks[Side.LEFT], self._tracks[Side.RIGHT]
        if left.newer is None or right.newer is None:
            return None
        t_ns = min(left.newer.t_ns, right.newer.t_ns)
        if self.end is not None:
            elapsed_ns = t_ns - self.end[0]
            if elapsed_ns <= 0 or (elapsed_ns < self._least_ns and left.newer.t_ns != right.newer.t_ns):
                return None
        left_m, right_m = left.at(t_ns, self._window_ns), right.at(t_ns, self._window_ns)
        return None if left_m is None or right_m is None else (t_ns, left_m, right_m)

    def _sample_to(self, t_ns: int, left_m: float, right_m: float) -> WheelSample | None:
        """End an interval here; None if it is only a new start."""
        end, self.end = self.end, (t_ns, left_m, right_m)
        broken, self._broken = self._broken, False
        untold, self._untold = self._untold, False
        if end is None:
            return None
        interval_ns = t_ns - end[0]
        if broken or interval_ns > self._gap_ns:
            self.counters["new_starts"] += 1
            self._lost_ns += interval_ns
            self._lost_m += nan if untold else 0.5 * (left_m - end[1] + right_m - end[2])
            return None
        lost_s, lost_m = self._lost_ns * S_PER_NS, self._lost_m if isfinite(self._lost_m) else 0.0
        self._lost_ns, self._lost_m = 0, 0.0
        return WheelSample(t_ns, interval_ns * S_PER_NS, left_m - end[1], right_m - end[2], lost_s, lost_m)
