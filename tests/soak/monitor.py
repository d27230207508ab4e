"""The monitor's real process beside the soak: gets the samples over its channel, as fast as it takes them."""

import select
from dataclasses import dataclass, field
from typing import Any, Final

from drd.config.keys import Config
from drd.pipeline import Observer
from drd.samples import GyroSample, WheelSample
from drd.service.monitor_channel import FIX, GYRO, WHEELS, Report, Setup
from drd.service.monitor_child import Child
from drd.units import S_PER_NS
from soak.world import EPOCH_NS

HOUR_S: Final = 3600.0
BATCH_S: Final = 0.1  # as the daemon hands samples over
PATIENCE_S: Final = 300.0  # one that takes nothing for so long hangs


@dataclass
class Cost:
    """At the end of each simulated hour: MB resident, seconds of a core so far. `judging`: of so many `reports`."""

    resident_mb: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)
    reports: int = 0
    judging: int = 0
    gaps: int = 0


class Monitored(Observer):
    """Has a monitor's process look at the samples. Raises Ended where the process ends; close it."""

    def __init__(self, config: Config):
        self.cost = Cost()
        self._child = Child(Setup(config, None))
        self._next_s, self._batch_s = HOUR_S, 0.0
        self._last = Report()

    def close(self) -> None:
        """End the process."""
        self._child.end()

    def event(self, name: str, now_ns: int, **values: Any) -> None:
        """A pose that was set."""
        if name == "set_pose":
            self._child.put(FIX, (now_ns, values["x_m"], values["y_m"], values["sigma_m"]))

    def gyro(self, sample: GyroSample) -> None:
        """A decoded gyro sample."""
        self._put(GYRO, sample, 0.0)

    def wheels(self, sample: WheelSample) -> None:
        """A decoded wheel sample."""
        self._put(WHEELS, sample, sample.lost_s)

    def _put(self, kind: int, sample: GyroSample | WheelSample, last: float) -> None:
        self._child.put(kind, sample, last)
        now_s = (sample.t_ns - EPOCH_NS) * S_PER_NS
        if now_s - self._batch_s >= BATCH_S:
            self._batch_s = now_s
            self._hand_over()
        if now_s >= self._next_s:
            self._next_s += HOUR_S
            self.cost.resident_mb.append(self._last.memory_mb)
            self.cost.cpu_s.append(self._last.cpu_s)

    def _hand_over(self) -> None:
        """Once there is room: Child would drop a batch that finds none, for a robot does not wait."""
        channel, cost, is_free = self._child.channel, self.cost, False
        while not is_free:
            readable, writable, _ = select.select([channel], [channel], [], PATIENCE_S)
            if not (readable or writable):
                raise TimeoutError(f"the monitor has taken nothing for {PATIENCE_S:g} s")
            is_free = bool(writable)
            while (report := self._child.report()) is not None:
                self._last, cost.gaps = report, report.gaps
                cost.reports += 1
                cost.judging += report.is_judging
        self._child.flush()
