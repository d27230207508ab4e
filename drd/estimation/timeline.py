"""Two streams of samples merged in time order, so that the filter's steps never depend on arrival order."""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from drd.units import NS_PER_S

# More than arrive at 2 kHz during the longest wait for the other sensor, 15 s; the oldest are dropped first.
KEPT = 32768
# Wheel samples are this far apart, so that a look ahead in steps as long is as exact.
JOINED_NS = NS_PER_S // 20


class Segment(NamedTuple):
    """An interval in which a sensor's output is constant.

    Wheels: `a`, `b` are left and right speed, `c` the body's own speed to its left (m/s). Gyro: `a` is the yaw rate,
    `b` its sigma from calibration and model (rad/s).
    """

    start_ns: int
    end_ns: int
    a: float
    b: float
    c: float = 0.0


# An interval over which neither sensor changes: start and end in ns, wheels and gyro. None: that sensor did not see it.
Piece = tuple[int, int, Segment | None, Segment | None]


class Stream:
    """One sensor's segments that the filter has not used up yet, in order of time, without overlaps."""

    def __init__(self) -> None:
        self.segments: deque[Segment] = deque(maxlen=KEPT)
        self.end_ns = 0

    def add(self, end_ns: int, interval_s: float, a: float, b: float, used_until_ns: int, c: float = 0.0) -> bool:
        """Append the segment of `interval_s` seconds that ends at `end_ns`. False: too late, nothing of it is left.

        Stamps are filtered and intervals are tracked, so that neighbours may miss each other by some jitter: a
        start within half an interval of the last end is moved onto it. What lies before `used_until_ns` is cut off.
        """
        interval_ns = round(interval_s * NS_PER_S)
        start_ns = end_ns - interval_ns
        if self.end_ns and start_ns - self.end_ns < interval_ns // 2:
            start_ns = self.end_ns
        start_ns = max(start_ns, used_until_ns)
        if start_ns >= end_ns:
            return False
        self.segments.append(Segment(start_ns, end_ns, a, b, c))
        self.end_ns = end_ns
        return True

    def integral(self, start_ns: int, end_ns: int) -> float:
        """Integral of the first output over that time; outside the segments it is held at its value at their ends."""
        total, t_ns, rate = 0.0, start_ns, 0.0
        for segment in self.segments:
            if segment.end_ns <= t_ns:
                rate = segment.a
                continue
            if segment.start_ns >= end_ns:
                break
            until_ns = min(segment.end_ns, end_ns)
            rate = segment.a
            total += rate * (until_ns - t_ns)
            t_ns = until_ns
        return (total + rate * (end_ns - t_ns)) / NS_PER_S

    def joined(self, from_ns: int) -> "Stream":
        """The stream with those adjacent segments joined that begin at `from_ns` or later, up to JOINED_NS: of a gyro
        without wheels only the turn matters, and a fast one has hundreds of them.
        """
        made, last = Stream(), None
        for segment in self.segments:
            start_ns, end_ns, a, b, c = segment
            if last and last.end_ns == start_ns and last.start_ns >= from_ns and end_ns - last.start_ns <= JOINED_NS:
                share = (end_ns - start_ns) / (end_ns - last.start_ns)
                mean = (was + (now - was) * share for was, now in zip(last[2:], (a, b, c), strict=True))
                last = made.segments[-1] = Segment(last.start_ns, end_ns, *mean)
            else:
                last = segment
                made.segments.append(segment)
        made.end_ns = self.end_ns
        return made

    def drop_until(self, t_ns: int) -> None:
        """Forget the segments that the filter has used."""
        while self.segments and self.segments[0].end_ns <= t_ns:
            self.segments.popleft()


def pieces(
    wheels: Stream, gyro: Stream, start_ns: int, end_ns: int, lag_ns: int = 0, used_ns: int = 0
) -> Iterator[Piece]:
    """Cut [start, end] at every segment's start and end, and say for each piece which segments cover it.

    The gyro's segments are shifted later by `lag_ns`, the wheels' lag. Where that has grown since the gyro's time
    `used_ns`, the first of them begins earlier: the robot's turn was seen without a gap.
    """
    t_ns, seen_ns = start_ns, used_ns + lag_ns
    w, g = iter(wheels.segments), iter(gyro.segments)
    wheel, rate = next(w, None), next(g, None)
    while t_ns < end_ns:
        while wheel is not None and wheel.end_ns <= t_ns:
            wheel = next(w, None)
        while rate is not None and rate.end_ns + lag_ns <= t_ns:
            rate = next(g, None)
        covering, turning, until_ns = wheel, rate, end_ns
        # No min and no max: this runs for each step of the filter, and a call costs more than the comparison.
        if wheel is not None:
            edge_ns = wheel.end_ns
            if wheel.start_ns > t_ns:
                covering, edge_ns = None, wheel.start_ns
            until_ns = edge_ns if edge_ns < until_ns else until_ns
        if rate is not None:
            edge_ns, begin_ns = rate.end_ns + lag_ns, rate.start_ns + lag_ns
            if begin_ns > t_ns and begin_ns > seen_ns:
                turning, edge_ns = None, begin_ns
            until_ns = edge_ns if edge_ns < until_ns else until_ns
        yield t_ns, until_ns, covering, turning
        t_ns = until_ns
