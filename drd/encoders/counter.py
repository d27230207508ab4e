"""One side's travel from its readings: a wrapping counter, or a speed that is integrated."""

from abc import ABC, abstractmethod
from enum import Enum

from drd.units import NS_PER_S, S_PER_NS

# Counts allowed beyond the configured top speed: interpolation, vibration and dither at the counter's edges.
MARGIN_COUNTS = 3
# Longest gap over which a counter is trusted: after more, the robot or its counters may have lost power.
LONGEST_TOLD_S = 10.0


class Outcome(Enum):
    """Information that a reading gives about the travel since the previous one."""

    MOVED = "moved"
    """The travel since then is known, zero included."""
    GAP = "gap"
    """It is known, but after too long a silence to say how it was driven, or whether the counter kept running."""
    NEW_START = "new start"
    """It is not known: first reading, gap, restart or jump."""
    IGNORED = "ignored"
    """The reading is not used."""


class Travel(ABC):
    """Accumulates one side's travel; `total` is in counts, or in metres where speeds are integrated.

    `total` keeps its value over a new start: only its changes on readings that MOVED, or over a GAP, are motion.
    `told_s`: the longest gap over which readings determine the travel; 0: none.
    """

    def __init__(self, gap_s: float, told_s: float = 0.0):
        self.total: float = 0.0
        self.counters = {"wraps": 0, "jumps": 0, "gaps": 0, "restarts": 0, "out_of_range": 0, "not_newer": 0}
        self._gap_ns, self._told_ns = round(gap_s * NS_PER_S), round(told_s * NS_PER_S)
        self._t_ns: int | None = None
        self._value: float | None = None

    def restart(self) -> None:
        """Treat the next reading as a new start: the device has restarted."""
        self.counters["restarts"] += 1
        self._value = None

    def add(self, t_ns: int, value: float) -> Outcome:
        """Take the reading of time `t_ns`."""
        if not self._possible(value):
            self.counters["out_of_range"] += 1
            return Outcome.IGNORED
        before_ns, before = self._t_ns, self._value
        if before_ns is not None and t_ns <= before_ns:
            self.counters["not_newer"] += 1
            return Outcome.IGNORED
        self._t_ns, self._value = t_ns, value
        if before_ns is None or before is None:
            return Outcome.NEW_START
        if is_gap := t_ns - before_ns > self._gap_ns:
            self.counters["gaps"] += 1
            if t_ns - before_ns > self._told_ns:
                return Outcome.NEW_START
        step = self._step(before, value, (t_ns - before_ns) * S_PER_NS)
        if step is None:
            self.counters["jumps"] += 1
            return Outcome.NEW_START
        self.total += step
        return Outcome.GAP if is_gap else Outcome.MOVED

    @abstractmethod
    def _possible(self, value: float) -> bool:
        """Whether the device can report this value."""

    @abstractmethod
    def _step(self, before: float, value: float, elapsed_s: float) -> float | None:
        """Travel between two readings; None if it cannot be motion."""


class Counter(Travel):
    """Unwraps a counter. A step faster than the robot can drive is a jump (preset, reset), not motion.

    `modulus_counts` None: the counter never wraps and may be fractional. `max_counts_s`: counts per second at the
    robot's top speed. `period_s`: nominal time between readings; a reading may contain the travel of that time however
    soon it follows the previous one, since adapters deliver frames in bunches. A time in which the counter could
    have turned by half its modulus is a gap, too, even if shorter than `gap_s`.
    """

    def __init__(self, modulus_counts: int | None, max_counts_s: float, period_s: float, gap_s: float):
        told_s = LONGEST_TOLD_S
        if modulus_counts is not None:
            unambiguous_counts = max(0, modulus_counts // 2 - MARGIN_COUNTS)
            told_s = min(told_s, unambiguous_counts / max_counts_s)
        self.longest_gap_s = min(gap_s, told_s)
        super().__init__(self.longest_gap_s, told_s)
        self._modulus_counts = modulus_counts
        self._max_counts_s = max_counts_s
        self._period_s = period_s

    def _possible(self, value: float) -> bool:
        # Signed or unsigned: differences modulo M are the same.
        modulus = self._modulus_counts
        return modulus is None or -modulus // 2 <= value < modulus

    def _step(self, before: float, value: float, elapsed_s: float) -> float | None:
        step, margin = value - before, 0
        if self._modulus_counts is not None:
            half, margin = self._modulus_counts // 2, MARGIN_COUNTS
            step = (step + half) % self._modulus_counts - half
        if abs(step) > self._max_counts_s * max(elapsed_s, self._period_s) + margin:
            return None
        if step != value - before:
            self.counters["wraps"] += 1
        return step


class SpeedIntegral(Travel):
    """Integrates a speed in m/s by the trapezoidal rule. A speed beyond the robot's is not used."""

    def __init__(self, max_speed_m_s: float, gap_s: float):
        super().__init__(gap_s)
        self._max_speed_m_s = max_speed_m_s

    def _possible(self, value: float) -> bool:
        return abs(value) <= self._max_speed_m_s

    def _step(self, before: float, value: float, elapsed_s: float) -> float:
        return 0.5 * (before + value) * elapsed_s
