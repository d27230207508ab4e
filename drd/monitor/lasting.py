"""A monitor with a memory: it begins with the robot's known constants, and also reports findings over days."""

from typing import Final

from drd.config.keys import Config
from drd.monitor.findings import Finding
from drd.monitor.memory import COLUMNS, Day, Memory, known, remember
from drd.monitor.monitor import Monitor
from drd.monitor.wear import wear
from drd.samples import GyroSample, WheelSample
from drd.units import NS_PER_S

PERIOD_S: Final = 60.0  # of data, after which the drive's constants are evaluated again
LARGEST: Final = 10.0


class LastingMonitor:
    """Is fed as a Monitor. `wall_zero_ns`: wall clock at 0 of the samples' clock; `now_ns`: on the latter."""

    def __init__(self, config: Config, memory: Memory | None, wall_zero_ns: int, now_ns: int):
        self._memory, self._wall_zero_ns = memory, wall_zero_ns
        self.known = None if memory is None else known(memory, wall_zero_ns + now_ns)
        self.monitor = Monitor(config, self.known)
        self.day: Day | None = None
        self._due_s = PERIOD_S
        self._wear = [] if memory is None else wear(memory, wall_zero_ns, now_ns)

    def gyro(self, sample: GyroSample) -> None:
        """A calibrated sample of the gyro."""
        self.monitor.gyro(sample)

    def wheels(self, sample: WheelSample) -> None:
        """A sample of the wheels."""
        self.monitor.wheels(sample)

    def fix(self, t_ns: int, x_m: float, y_m: float, sigma_m: float) -> None:
        """See Monitor."""
        self.monitor.fix(t_ns, x_m, y_m, sigma_m)

    def clock(self, wall_zero_ns: int) -> None:
        """Note that the wall clock was set: the drive is on another day than it seemed."""
        self._wall_zero_ns, self._due_s = wall_zero_ns, self.monitor.now_s

    def findings(self) -> list[Finding]:
        """All findings so far, of this drive and of earlier ones."""
        if self._memory is not None and self.monitor.now_s >= self._due_s:
            self._due_s = self.monitor.now_s + PERIOD_S
            self._look(self._memory)
        return [*self.monitor.findings(), *self._wear]

    def _look(self, memory: Memory) -> None:
        found, zero_ns = self.monitor.constants(), self.monitor.zero_ns
        if found is None or zero_ns is None:
            return
        now_ns = zero_ns + round(self.monitor.now_s * NS_PER_S)
        means, sigmas = (tuple(x[c] for c in COLUMNS) for x in (found.means, found.sigmas))
        if max(map(abs, (*means, *sigmas))) > LARGEST:
            return
        self.day = Day(self._wall_zero_ns + now_ns, self.monitor.distance_m, means, sigmas)  # type: ignore[arg-type]
        self._wear = wear(remember(memory, self.day), self._wall_zero_ns, now_ns)
