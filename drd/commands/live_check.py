"""`drd check --live CONFIG`: is the robot wired as its configuration says?"""

import asyncio
import contextlib
import shutil
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from drd.config.keys import Config
from drd.pipeline import Pipeline
from drd.samples import Side
from drd.service.inputs import Inputs
from drd.units import DEG_PER_RAD
from drd.wiring.findings import Finding, Statement, faults
from drd.wiring.samples import Samples
from drd.wiring.table import table

BEAT_S: Final = 0.05
SHOWN_EVERY: Final = 4
WHAT_TO_DO: Final = """\
Watching for {seconds:g} s; Ctrl-C ends early and evaluates what has been seen. Please
  1. let the robot stand for a few seconds,
  2. push or drive it straight ahead for two metres or more (--drove forward, --distance METRES),
  3. turn it left by half a turn or more, on the spot or in a curve (--turned left),
  4. drive in curves to both sides for ten seconds or more.
Any order will do; whatever you leave out stays undetermined. The options in brackets state what you do and resolve
what the sensors alone cannot. They apply to the whole drive, net: with --distance, turn on the spot only; with
--turned, turn to that side only; and leave step 4 to a check without them."""


def live_check(config: Config, base: Path, seconds: float, said: Statement) -> int:
    """Open the ports, watch, print the findings. Returns 1 where there is a fault. Raises ConfigError."""
    kept = Samples()
    pipeline = Pipeline(config, base, lambda *_: None, [kept])
    print(WHAT_TO_DO.format(seconds=seconds), flush=True)
    watch = _Watch(config, pipeline, kept)
    asyncio.run(watch.run(seconds))
    findings = [watch.explained(finding) for finding in kept.judge(pipeline, config.robot, said)]
    print()
    print(table(findings, shutil.get_terminal_size((120, 0)).columns))
    return 1 if faults(findings) else 0


class _Watch:
    """The open ports, the line that shows what moves, and the reasons for silent sensors."""

    def __init__(self, config: Config, pipeline: Pipeline, kept: Samples):
        self._config, self._pipeline, self._kept = config, pipeline, kept
        self._troubles: dict[str, str] = {}
        self._shown = [0, 0]
        self._left_m = self._right_m = self._gyro_rad = 0.0

    async def run(self, seconds: float) -> None:
        """Watch until the time is over or a signal comes."""
        stop, loop = asyncio.Event(), asyncio.get_running_loop()
        numbers = (signal.SIGINT, signal.SIGTERM)
        for number in numbers:
            loop.add_signal_handler(number, stop.set)
        tasks = [asyncio.create_task(work) for work in Inputs(self._config, self._pipeline, self._on_state).work()]
        end_s, beat = time.monotonic() + seconds, 0
        try:
            while not stop.is_set() and (left_s := end_s - time.monotonic()) > 0.0:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(stop.wait(), min(BEAT_S, left_s))
                self._pipeline.tick(time.monotonic_ns())
                beat += 1
                if sys.stderr.isatty() and beat % SHOWN_EVERY == 0:
                    self._show(seconds - left_s, seconds)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            for number in numbers:
                loop.remove_signal_handler(number)
            if sys.stderr.isatty():
                print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def _on_state(self, source: str, text: str | None) -> None:
        if text is None:
            self._troubles.pop(source, None)
        else:
            self._troubles[source] = text + (": stop the daemon first" if "in use" in text else "")
        print(f"{source}: {self._troubles.get(source, 'open')}", file=sys.stderr, flush=True)

    def _show(self, now_s: float, seconds: float) -> None:
        gyro, wheels = self._kept.gyro_samples[self._shown[0] :], self._kept.wheel_samples[self._shown[1] :]
        self._shown = [len(self._kept.gyro_samples), len(self._kept.wheel_samples)]
        self._gyro_rad += sum(s.rate_rad_s * s.interval_s for s in gyro)
        self._left_m += sum(s.left_m for s in wheels)
        self._right_m += sum(s.right_m for s in wheels)
        turn_deg = (self._right_m - self._left_m) / self._config.robot.tread_m * DEG_PER_RAD
        line = f"{now_s:.0f} of {seconds:g} s: left {self._left_m:+.2f} m, right {self._right_m:+.2f} m, "
        line += f"wheels {turn_deg:+.0f} deg, gyro {self._gyro_rad * DEG_PER_RAD:+.0f} deg"
        print(f"\r\x1b[K{line[: shutil.get_terminal_size((120, 0)).columns - 1]}", end="", file=sys.stderr, flush=True)

    def explained(self, finding: Finding) -> Finding:
        """The finding; where a sensor gave no samples, with the reason, judged from the data received."""
        if finding.check == "gyro" and not self._kept.gyro_samples:
            return replace(finding, text=f"no sample: {self._gyro_silence()}")
        if finding.check == "encoders" and not self._kept.wheel_samples:
            return replace(finding, text=f"no sample of both wheels: {self._encoder_silence()}")
        return finding

    def _gyro_silence(self) -> str:
        fog, pipeline = self._config.fog, self._pipeline
        if trouble := self._troubles.get("fog.port"):
            return trouble
        if not self._kept.byte_count:
            return f"no byte came on {fog.port}"
        counters = pipeline.fog.counters if pipeline.fog is not None else {}
        if not counters.get("frames", 0):
            return f"{self._kept.byte_count} bytes came on {fog.port}, but no packet of protocol {fog.protocol}"
        return f"packets came, but none that can be used: {_listed(counters)}"

    def _encoder_silence(self) -> str:
        encoders = self._pipeline.encoders
        if trouble := self._troubles.get("encoders.port"):
            return trouble
        silent = [side.name.lower() for side in Side if encoders.last_ns[side] is None]
        wanted = ", ".join(f"0x{can_id:X}" for can_id, _ in encoders.can_ids)
        if len(silent) == 2:
            return (
                f"no reading from {self._config.encoders.channel}; identifiers {wanted}: {_listed(encoders.counters)}"
            )
        if silent:
            return f"the {silent[0]} side never reported; identifiers {wanted}"
        return f"readings of both sides that do not go together in time: {_listed(encoders.counters)}"


def _listed(counters: dict[str, int]) -> str:
    return ", ".join(f"{name}={count}" for name, count in counters.items() if count) or "nothing came"


def statement_of(arguments: Any) -> Statement:
    """The user's statement of the motion, from the options."""
    return Statement(
        {"forward": 1, "backward": -1}.get(arguments.drove, 0),
        {"left": 1, "right": -1}.get(arguments.turned, 0),
        arguments.distance,
    )
