"""The daemon's side of the monitor: samples go out to its process, findings come back, and nothing blocks."""

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import msgspec

from drd.config.keys import Config
from drd.estimation.applied import Constant
from drd.estimation.basis import Basis
from drd.estimation.calibration import Calibration
from drd.pipeline import Observer
from drd.samples import GyroSample, WheelSample
from drd.service.monitor_channel import CLOCK, FIX, GYRO, WHEELS, Report, Setup
from drd.service.monitor_child import Child, Ended
from drd.state.memory_file import MemoryKeeper, digest_of, first_digest_of
from drd.units import NS_PER_S, S_PER_NS

log = logging.getLogger(__name__)

# How often samples are handed over and reports fetched.
PERIOD_S: Final = 0.1
FIRST_PAUSE_S: Final = 1.0
LONGEST_PAUSE_S: Final = 300.0
# A larger change means that the wall clock was set: a robot without a clock chip gets the time while it drives.
SET_NS: Final = 60 * NS_PER_S
# After a run of this length the pause before a restart is short again.
GOOD_S: Final = 60.0


class Monitoring(Observer):
    """Lets a monitor in a separate process observe the pipeline's samples.

    Whatever happens to that process, the daemon goes on: samples that it does not take are dropped and counted, and it
    is restarted, after pauses that double. `on_change` is called when findings or suspicion change, `on_constants` with
    each report's `wanted`. `is_enabled`: whether the configuration asks for it.
    """

    def __init__(
        self,
        on_change: Callable[[], None],
        keeper: MemoryKeeper,
        on_constants: Callable[[Mapping[str, Constant | None]], None],
    ):
        self._on_change, self._keeper, self._on_constants = on_change, keeper, on_constants
        self._setup: Setup | None = None
        self._process: Child | None = None
        self._changed = asyncio.Event()
        self._report = Report()
        self._pause_s = FIRST_PAUSE_S
        self._state, self._reason = "off", ""
        self._told: set[str] = set()
        self._dropped = self.restarts = self._wall_zero_ns = 0
        self.is_enabled = False

    # ---- the pipeline's observer -------------------------------------------------------------------------------

    def event(self, name: str, now_ns: int, **values: Any) -> None:
        """Pass on a pose that was set: distances count from it, and after a reset from no earlier one."""
        if self._process is not None and name in ("set_pose", "reset"):
            pose = {"x_m": 0.0, "y_m": 0.0, "sigma_m": math.inf} | values
            self._process.put(FIX, (now_ns, pose["x_m"], pose["y_m"], pose["sigma_m"]))

    def gyro(self, sample: GyroSample) -> None:
        """A decoded gyro sample."""
        if self._process is not None:
            self._process.put(GYRO, sample)

    def wheels(self, sample: WheelSample) -> None:
        """A decoded wheel sample."""
        if self._process is not None:
            self._process.put(WHEELS, sample, sample.lost_s)

    # ---- what is wanted ----------------------------------------------------------------------------------------

    def put_in_force(self, config: Config, calibration: Calibration | None, basis: Basis) -> None:
        """Watch a robot of this configuration from now on; begin anew if it differs from the previous one."""
        setup, self._reason = None, ""
        if config.monitor.enabled:
            if config.fog.protocol == "none":
                self._reason = "no gyro: the monitor compares gyro and wheels"
            elif config.model.file is not None:
                self._reason = "model.file is set: the monitor would report the model's effects"
            else:
                # Only the sections that it uses: a new output period must not restart it.
                parts = {name: getattr(config, name) for name in ("robot", "fog", "encoders", "estimation")}
                setup = Setup(Config(**parts), calibration, digest_of(basis))
        self.is_enabled = config.monitor.enabled
        if setup != self._setup:
            self._setup = setup
            self._changed.set()

    # ---- what it says ------------------------------------------------------------------------------------------

    def findings(self) -> dict[str, Any]:
        """The published message: state, findings, suspicion, and effects not observable from gyro and wheels."""
        report = self._report
        return {
            "state": self._state,
            "findings": msgspec.to_builtins(report.findings),
            "suspected": msgspec.to_builtins(report.suspected),
            "began_ns": report.began_ns,
            "known": msgspec.to_builtins(report.known, str_keys=True),
            "not_observable": msgspec.to_builtins(report.not_observable),
        }

    def summary(self) -> list[dict[str, Any]]:
        """A short form of each finding, for the health."""
        names = ("effect", "text", "probability", "since_ns", "until_ns")
        return [{name: getattr(finding, name) for name in names} for finding in self._report.findings]

    def health(self) -> dict[str, Any] | None:
        """State, reason, counts of samples and restarts, and its cost; None where it is not configured."""
        if not self.is_enabled:
            return None
        process, report = self._process, self._report
        return {
            "state": self._state,
            "reason": self._reason or None,
            "suspected": report.suspected.text if report.suspected is not None else None,
            "tread_wanders": report.tread_wanders,
            "samples": report.samples,
            "dropped": self._dropped + (process.dropped if process is not None else 0),
            "gaps": report.gaps,
            "restarts": self.restarts,
            "cpu_s": report.cpu_s,
            "memory_mb": report.memory_mb,
            "memory": self._keeper.health(),
            "pid": process.child.pid if process is not None else None,
        }

    @property
    def status(self) -> str:
        """A phrase for systemd's status; empty where there is nothing to report."""
        texts = [f.text for f in self._report.findings if f.until_ns is None]
        found = f"monitor: {'; '.join(texts)}" if texts else ""
        return found or (f"monitor waiting: {self._reason}" if self._state == "waiting" else "")

    # ---- the process -------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Keep the process running as configured, until cancelled."""
        while True:
            self._changed.clear()
            if self._setup is None:
                self._tell("off", Report())
                await self._changed.wait()
                continue
            self._tell("starting", Report())
            process, text, has_ended = None, "", False
            try:
                process = await asyncio.to_thread(Child, self._with_memory(self._setup))
                await self._serve(process)
            except Ended as ended:
                text, has_ended = str(ended), True
            except Exception as error:
                # A bug of ours here must not stop the pose.
                text = f"internal error: {error!r}"
            finally:
                how = await self._end(process, has_ended) if process is not None else ""
            if not self._changed.is_set():
                await self._pause(text or how)

    def _with_memory(self, setup: Setup) -> Setup:
        memory = self._keeper.memory(setup.basis, first_digest_of(setup.config, setup.calibration))
        self._wall_zero_ns = _wall_zero_ns()
        return msgspec.structs.replace(
            setup, memory=memory, wall_zero_ns=self._wall_zero_ns, began_ns=time.monotonic_ns()
        )

    async def _serve(self, process: Child) -> None:
        """Exchange samples and reports until another set-up is wanted. Raises Ended."""
        self._process = process
        while not self._changed.is_set():  # reports on the old set-up do not hold for the new one
            self._exchange(process)
            await asyncio.sleep(PERIOD_S)

    async def _end(self, process: Child, has_ended: bool) -> str:
        """End the process; return how it had ended on its own."""
        self._process = None
        self._dropped += process.dropped
        if (time.monotonic_ns() - process.began_ns) * S_PER_NS > GOOD_S:
            self._pause_s = FIRST_PAUSE_S
        return await asyncio.to_thread(process.end, has_ended)

    def _exchange(self, process: Child) -> None:
        """Hand samples over, and the wall clock if it was set, and take reports."""
        if abs(_wall_zero_ns() - self._wall_zero_ns) > SET_NS:
            self._wall_zero_ns = _wall_zero_ns()
            process.put(CLOCK, (self._wall_zero_ns, 0.0, 0.0, 0.0))
        process.flush()
        while (report := process.report()) is not None:
            for note in report.notes:
                self._say(logging.INFO, note)
            if report.day is not None and report.day != self._report.day:
                self._keeper.put(report.day)
            self._reason = "; ".join(report.notes)
            self._tell("running" if report.is_judging else "not judging", report)
            self._on_constants(report.wanted)
        process.check()

    async def _pause(self, text: str) -> None:
        """Wait before the next start, after the process has ended on its own."""
        self._reason = text
        self.restarts += 1
        self._say(logging.WARNING, f"{text}; it will be restarted")
        self._tell("waiting", Report())
        pause_s, self._pause_s = self._pause_s, min(2.0 * self._pause_s, LONGEST_PAUSE_S)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._changed.wait(), pause_s)

    def _say(self, level: int, text: str) -> None:
        """Log each text once: a process that ends again and again must not fill the log."""
        if text not in self._told:
            self._told.add(text)
            log.log(level, "monitor: %s", text)

    def _tell(self, state: str, report: Report) -> None:
        before = self._state, self._report.findings, self._report.suspected
        self._state, self._report = state, report
        if (state, report.findings, report.suspected) != before:
            self._on_change()


def _wall_zero_ns() -> int:
    """The wall clock when the samples' clock is 0."""
    return time.time_ns() - time.monotonic_ns()
