"""The daemon's wiring: ports, pipeline, publishers and systemd around one event loop."""

import asyncio
import dataclasses
import logging
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drd import __version__
from drd.config.keys import Config
from drd.config.schema import ConfigError, Loaded
from drd.estimation.applied import Constant
from drd.output.messages import Refused, pose_dict
from drd.output.queries import Handler
from drd.output.zenoh_link import ZenohLink
from drd.pipeline import Pipeline
from drd.ports.clock import TICK_S, read_both
from drd.samples import Pose
from drd.service import realtime
from drd.service.commands import Commands
from drd.service.inputs import Inputs
from drd.service.losses import Losses
from drd.service.monitoring import Monitoring
from drd.service.reload import Prepared, prepare
from drd.service.systemd import Notifier
from drd.service.taking import Taking
from drd.service.tasks import Tasks
from drd.service.traffic import Traffic
from drd.state.keeper import StateKeeper
from drd.state.memory_file import MemoryKeeper
from drd.units import S_PER_NS

if TYPE_CHECKING:
    from drd.recording.recorder import Recorder

log = logging.getLogger("drd")

CLOSE_DEADLINE_S = 3.0
RECORDER_DEADLINE_S = 2.0
STATE_DEADLINE_S = 1.0


class Daemon:
    """One robot's dead reckoning. Raises ConfigError from the constructor or `run` before anything is published."""

    def __init__(self, loaded: Loaded[Config], base: Path):
        self._loaded, self._config = loaded, loaded.value
        self._recorder = make_recorder(loaded, base)
        self._memory = MemoryKeeper(self._config)
        self._monitoring = Monitoring(self._on_findings, self._memory, self._on_constants)
        observers = [observer for observer in (self._recorder, self._monitoring) if observer is not None]
        self.pipeline = Pipeline(self._config, base, self._on_pose, observers)
        self._taking = Taking(self.pipeline)
        self._put_monitor_in_force()
        self._state = StateKeeper(self._config, self.pipeline)
        self._notifier = Notifier()
        self._link: ZenohLink
        self._pose: Pose | None = None
        self._pose_wall_ns = 0
        self._started_ns = time.monotonic_ns()
        self._traffic, self._losses = Traffic(), Losses()
        self._inputs: Inputs
        self._unreported: set[str] = set()
        self._ready = False
        self._base = base
        self._reload_due = asyncio.Event()
        self._reloads: dict[str, Any] = {"done": 0, "refused": 0, "error": None, "waiting": []}
        self._tasks: Tasks
        self._input_tasks: list[asyncio.Task[None]] = []

    async def run(self, stop: asyncio.Event) -> bool:
        """Run until `stop` is set. False: Zenoh did not close in time, and an orderly exit could hang."""
        loop = asyncio.get_running_loop()
        self._link = ZenohLink(self._config.output.beside(self._base), self._handlers(), loop)
        if self._recorder is not None:
            self._recorder.start()
        self._state.begin(time.monotonic_ns())
        self._memory.begin()
        self._tasks = Tasks()
        self._open_inputs()
        for work in (self._keep_time(), self._reload_when_asked(), self._monitoring.run()):
            self._tasks.start(work)
        try:
            for message in realtime.apply(self._config.realtime):
                log.warning("refused %s", message)
            stopping = asyncio.create_task(stop.wait())
            ended = self._tasks.ended
            first: set[asyncio.Future[Any]] = {stopping, ended}
            await asyncio.wait(first, return_when=asyncio.FIRST_COMPLETED)
            stopping.cancel()
            if ended.done():
                ended.result()  # only a bug of ours ends a task: raise it, and let systemd restart
        finally:
            self._notifier.stopping()
            await self._tasks.cancel()
            if self._recorder is not None and not self._recorder.close(RECORDER_DEADLINE_S):
                log.error("recording: its end was not written to disk within %g s", RECORDER_DEADLINE_S)
            if not self._memory.close(STATE_DEADLINE_S):
                log.error("monitor: its memory was not written to disk within %g s", STATE_DEADLINE_S)
            if not self._state.close(STATE_DEADLINE_S):
                log.error("state: not written to disk within %g s", STATE_DEADLINE_S)
            closed = self._link.close(CLOSE_DEADLINE_S)
        return closed

    def _open_inputs(self) -> None:
        self._inputs = Inputs(self._config, self.pipeline, self._on_port_state)
        self._unreported = set(self._inputs.ports)
        self._input_tasks = [self._tasks.start(work) for work in self._inputs.work()]

    def _on_port_state(self, source: str, text: str | None) -> None:
        log.log(logging.INFO if text is None else logging.WARNING, "%s=%s", source, text or "open")
        self._unreported.discard(source)

    async def _keep_time(self) -> None:
        """At each tick detect silence and save the state; feed the watchdog and publish the health when due."""
        watchdog_s = self._notifier.watchdog_period_s or math.inf
        next_watchdog_s = next_health_s = 0.0
        while True:
            now_ns = time.monotonic_ns()
            self.pipeline.tick(now_ns)
            self._state.tick(now_ns)
            now_s = now_ns * S_PER_NS
            if not self._ready and not self._unreported:
                self._ready = True
                self._notifier.ready(self._status())
                log.info("ready robot=%s prefix=%s", self._config.robot.name, self._config.output.prefix)
            if now_s >= next_watchdog_s:
                self._notifier.watchdog()
                next_watchdog_s = now_s + min(watchdog_s, 1.0)
            if now_s >= next_health_s:
                next_health_s = now_s + self._config.output.health_period_s
                self._publish_health()
            await asyncio.sleep(TICK_S)

    # ---- reload ------------------------------------------------------------------------------------------------

    def ask_for_reload(self) -> None:
        """Request a reload of the configuration; call from the event loop."""
        self._reload_due.set()

    async def _reload_when_asked(self) -> None:
        while True:
            await self._reload_due.wait()
            self._reload_due.clear()
            if self._ready:
                self._notifier.reloading()
            try:
                # In a thread, so that poses continue.
                prepared = await asyncio.to_thread(prepare, self._loaded, self._base)
            except Exception as error:
                # Not even a bug of ours may stop the pose.
                text = str(error) if isinstance(error, ConfigError) else f"internal error: {error!r}"
                self._reloads["refused"] += 1
                self._reloads["error"] = text
                log.error("reload=refused, nothing has changed: %s", text)
            else:
                await self._put_in_force(prepared)
            if self._ready:
                self._notifier.ready(self._status())

    async def _put_in_force(self, prepared: Prepared) -> None:
        """Continue with the new configuration from the same pose; reopen ports whose sections changed."""
        old, new = self._config, prepared.loaded.value
        reopen = (new.fog, new.encoders) != (old.fog, old.encoders)
        reopen |= prepared.pipeline.encoders.can_ids != self.pipeline.encoders.can_ids  # a DBC file that was edited
        if reopen:
            await self._tasks.cancel(self._input_tasks)
        anew = self.pipeline.reload(time.monotonic_ns(), prepared.pipeline, prepared.files)
        self._loaded, self._config = prepared.loaded, new
        self._state.put_in_force(new)
        self._put_monitor_in_force()
        if reopen:
            self._open_inputs()
        self._reloads["done"] += 1
        self._reloads |= {"error": None, "waiting": prepared.waiting}
        log.info("reload=done ports=%s", "reopened" if reopen else "kept")
        for text in anew:
            log.info("reload: %s", text)
        if prepared.waiting:
            log.warning("reload: takes effect only at the next start: %s", ", ".join(prepared.waiting))

    def _put_monitor_in_force(self) -> None:
        self._monitoring.put_in_force(self._config, self.pipeline.calibration, self.pipeline.basis)
        self._taking.put_in_force(self._config.monitor.enabled and self._config.monitor.apply)

    # ---- outputs -----------------------------------------------------------------------------------------------

    def _on_pose(self, pose: Pose, input_ns: int) -> None:
        now_ns, wall_ns, _ = read_both(time.monotonic_ns, time.time_ns)
        self._pose, self._pose_wall_ns = pose, wall_ns - (now_ns - pose.t_ns)
        self._link.publish_pose(pose, self._pose_wall_ns)
        if self._link.wants_turns and (turns := self.pipeline.encoders.turns()) is not None:
            self._link.publish_turns(turns, self._pose_wall_ns + turns.t_ns - pose.t_ns)
        if self._recorder is not None:
            self._recorder.pose(pose, self._pose_wall_ns)
        self._traffic.add(time.monotonic_ns() - input_ns)

    def _publish_health(self) -> None:
        self._traffic.close_period(time.monotonic_ns(), self.pipeline.encoders.counters["samples"])
        health = self._health()
        self._losses.look(health)
        self._link.publish_health(health)
        if self._recorder is not None:
            self._recorder.health_report(health)
        if self._ready:
            self._notifier.status(self._status())

    def _on_findings(self) -> None:
        findings = self._findings()
        self._link.publish_findings(findings)
        if self._recorder is not None:
            self._recorder.findings_report(findings)

    def _on_constants(self, wanted: Mapping[str, Constant | None]) -> None:
        self._taking.want(wanted)

    def _findings(self) -> dict[str, Any]:
        return {"monotonic_ns": time.monotonic_ns(), "wall_ns": time.time_ns()} | self._monitoring.findings()

    def _health(self) -> dict[str, Any]:
        now_ns = time.monotonic_ns()
        health = self.pipeline.health(now_ns)
        health["version"] = __version__
        health["monotonic_ns"], health["wall_ns"] = now_ns, time.time_ns()
        health["uptime_s"] = (now_ns - self._started_ns) * S_PER_NS
        health |= self._traffic.last
        health["counters"] |= {**self._inputs.counters(), "zenoh": dict(self._link.counters)}
        health["counters"]["systemd"] = dict(self._notifier.counters)
        health["neighbours"] = self._link.neighbours()
        # Separate from the pose: a full disk is no reason to trust the pose less.
        health["recording"] = self._recorder.health() if self._recorder is not None else None
        health["state"] = self._state.health()
        health["reload"] = dict(self._reloads)
        health["monitor"], health["findings"] = self._monitoring.health(), self._monitoring.summary()
        if health["monitor"] is not None:
            health["monitor"]["applied"] = self._taking.health()
        return health

    def _status(self) -> str:
        reasons = self.pipeline.reasons
        texts = [f"{r.source}: {r.text}" for r in reasons.active()]
        status = f"{reasons.validity.value}{': ' if texts else ''}{'; '.join(texts)}"
        recording = self._recorder.trouble if self._recorder is not None else None
        status += f"; recording degraded: {recording}" if recording else ""
        if self._reloads["error"]:
            status += f"; reload refused: {self._reloads['error']}"
        if self._reloads["waiting"]:
            status += f"; restart for {', '.join(self._reloads['waiting'])}"
        status += f"; {self._monitoring.status}" if self._monitoring.status else ""
        status += f"; state not kept: {self._state.trouble}" if self._state.trouble else ""
        return f"{status}; {self._state.start_text}" if self._state.is_told else status

    # ---- queries -----------------------------------------------------------------------------------------------

    def _handlers(self) -> dict[str, Handler]:
        return {
            "pose": self._answer_pose,
            "health": lambda _: self._health(),
            "findings": self._answer_findings,
            "config": self._answer_config,
            **Commands(self.pipeline).handlers,
        }

    def _answer_pose(self, _: dict[str, Any]) -> dict[str, Any]:
        if self._pose is None:
            raise Refused("no pose yet")
        return pose_dict(self._pose, self._pose_wall_ns)

    def _answer_findings(self, _: dict[str, Any]) -> dict[str, Any]:
        if not self._monitoring.is_enabled:
            raise Refused("there is no monitor: monitor.enabled is false")
        return self._findings()

    def _answer_config(self, _: dict[str, Any]) -> dict[str, Any]:
        calibration = self.pipeline.calibration
        return {
            "config": dataclasses.asdict(self._config),
            "origins": self._loaded.origins,
            "calibration": dataclasses.asdict(calibration) if calibration else None,
            "version": __version__,
        }


def make_recorder(loaded: Loaded[Config], base: Path) -> "Recorder | None":
    """The recorder, not yet started; None if the configuration disables it. Raises ConfigError."""
    if not loaded.value.recording.enabled:
        return None
    from drd.recording.recorder import Recorder  # noqa: PLC0415  # MCAP is loaded only where it is used

    return Recorder(loaded, base)
