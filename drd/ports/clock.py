"""Convert CAN drivers' wall-clock receive stamps to CLOCK_MONOTONIC."""

import time
from collections.abc import Callable
from typing import Final

from drd.units import NS_PER_S

# How often the daemon, and a replay in its place, looks at its clock.
TICK_S: Final = 0.05
# CLOCK_REALTIME and CLOCK_MONOTONIC are disciplined alike (clock_gettime(2)): their difference moves in steps only.
STEP_NS: Final = 1_000_000
# A float of today's seconds is rounded to 2.4e-7 s, so a fresh stamp may lie in the future by half of that.
ROUNDING_NS: Final = 1_000
# The two clocks are read one after the other; being preempted in between would shift the stamp.
READ_TOGETHER_NS: Final = 100_000
READ_ATTEMPTS: Final = 4


def read_both(monotonic_ns: Callable[[], int], time_ns: Callable[[], int]) -> tuple[int, int, int]:
    """CLOCK_MONOTONIC and CLOCK_REALTIME at the same moment, and how long the best reading of both took; ns."""
    readings = []
    for _ in range(READ_ATTEMPTS):
        before_ns, wall_ns, after_ns = monotonic_ns(), time_ns(), monotonic_ns()
        readings.append((after_ns - before_ns, (before_ns + after_ns) // 2, wall_ns))
        if after_ns - before_ns < READ_TOGETHER_NS:
            break
    took_ns, now_ns, wall_ns = min(readings)
    return now_ns, wall_ns, took_ns


class ReceiveClock:
    """Maps CLOCK_REALTIME stamps to CLOCK_MONOTONIC by their age, immune to steps of the wall clock.

    A stamp is used if it is 0 to `limit_s` old and no step of the wall clock lies between it and now; otherwise the
    frame counts as received now (`stepped_stamps`). Results never run backward (`backward_stamps`): drivers deliver
    stamps out of order (linux-can/can-utils issue 233). Steps are seen from frame to frame; two that cancel out in
    between are not. Never raises on a stamp, NaN and infinity included.
    """

    def __init__(
        self,
        limit_s: float = 5.0,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        time_ns: Callable[[], int] = time.time_ns,
    ):
        self.counters: dict[str, int] = {"stepped_stamps": 0, "backward_stamps": 0}
        self._limit_ns = limit_s * NS_PER_S
        self._monotonic_ns, self._time_ns = monotonic_ns, time_ns
        now_ns, wall_ns, self._offset_known_ns = read_both(self._monotonic_ns, self._time_ns)
        self._offset_ns = wall_ns - now_ns
        self._step_seen_ns: int | None = None
        self._last_ns: int | None = None

    def to_monotonic_ns(self, stamp_s: float) -> int:
        """Receive time in CLOCK_MONOTONIC ns of a frame that the driver stamped `stamp_s` (CLOCK_REALTIME, s)."""
        now_ns, wall_ns, took_ns = read_both(self._monotonic_ns, self._time_ns)
        change_ns = abs(wall_ns - now_ns - self._offset_ns)
        # A busy machine stretches the reading; a change within its uncertainty is not a step.
        if change_ns > STEP_NS + took_ns + self._offset_known_ns:
            self._step_seen_ns = now_ns
        if change_ns > took_ns + self._offset_known_ns or took_ns < self._offset_known_ns:
            self._offset_ns, self._offset_known_ns = wall_ns - now_ns, took_ns
        age_ns = now_ns + self._offset_ns - stamp_s * NS_PER_S
        received_ns = now_ns
        # False for NaN as well.
        if -ROUNDING_NS <= age_ns <= self._limit_ns:
            received_ns = now_ns - max(0, int(age_ns))
            if self._step_seen_ns is not None and received_ns < self._step_seen_ns:
                # From before the step, or from between the step and its detection: its age is not known.
                self.counters["stepped_stamps"] += 1
                received_ns = now_ns
        else:
            self.counters["stepped_stamps"] += 1
        if self._last_ns is not None and received_ns < self._last_ns:
            self.counters["backward_stamps"] += 1
            received_ns = self._last_ns
        self._last_ns = received_ns
        return received_ns
