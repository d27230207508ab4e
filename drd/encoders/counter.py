"""One side's travel from its readings: a wrapping counter, or a speed that is integrated."""

from abc import ABC, abstractmethod
from enum import Enum

from drd.units import NS_PER_S, S_PER_NS

# What a counter may do beyond the configured top speed: interpolation, vibration and dither at its edges.
MARGIN_COUNTS = 3
# The largest gap_s: after a longer silence nobody knows what the robot, or its counters' supply, went through.
LONGEST_TOLD_S = 10.0


class Outcome(Enum):
    """Information of a reading on the travel since the previous one."""

    MOVED = "moved"
    """The travel since then is known, zero included."""
    GAP = "gap"
    """It is known, but for too long nothing was heard to tell how it was made, or whether the counter went on."""
    NEW_START = "new start"
    """It is not known: first reading, gap, restart or jump."""
    IGNORED = "ignored"
    """The reading is not used."""


class Travel(ABC):
    """Accumulates one side's travel; `total` is in counts, or in metres where speeds are integrated.

    `total` keeps its value over a new start: only its differences between readings that MOVED, or over a GAP, are
    motion. `told_s`: the longest gap over which readings tell the travel; 0: none.
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
    robot's top speed. `period_s`: nominal time between readings; a reading may carry that much travel however
    shortly it follows the one before, since adapters deliver frames in bunches. A gap in which the counter could
    have turned by half its modulus is a gap too, even when shorter than `gap_s`.
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
        # Signed and unsigned counters alike: differences modulo M do not care which of the two is read.
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
    """Integrates a speed in m/s by trapezoids. A speed beyond the robot's is not used."""

    def __init__(self, max_speed_m_s: float, gap_s: float):
        super().__init__(gap_s)
        self._max_speed_m_s = max_speed_m_s

    def _possible(self, value: float) -> bool:
        return abs(value) <= self._max_speed_m_s

    def _step(self, before: float, value: float, elapsed_s: float) -> float:
        return 0.5 * (before + value) * elapsed_s
