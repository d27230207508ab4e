"""Connect the robot's ports to a pipeline: received data go in, frames sent by the encoders' layout go out."""

import asyncio
import time
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

from drd.config.keys import Config
from drd.pipeline import Pipeline
from drd.ports.can_port import CanPort
from drd.ports.serial_port import SerialPort
from drd.samples import CanFrame


class Inputs:
    """The configured ports, opened when `work()` runs. `ports`: by the source named in reasons.

    `on_state(source, text)` is called after the pipeline has learned of a port's trouble (None: it is open).
    """

    def __init__(self, config: Config, pipeline: Pipeline, on_state: Callable[[str, str | None], None]):
        self._pipeline, self._on_state = pipeline, on_state
        self._bus = CanPort(
            config.encoders, pipeline.encoders.can_ids, self._on_frames, self._state_of("encoders.port")
        )
        self.ports: dict[str, SerialPort | CanPort] = {"encoders.port": self._bus}
        self._line: SerialPort | None = None
        if pipeline.fog is not None:
            self._line = SerialPort(config.fog, pipeline.on_fog_bytes, self._state_of("fog.port"))
            self.ports["fog.port"] = self._line

    def work(self) -> list[Coroutine[Any, Any, None]]:
        """Coroutines that must run as long as the inputs are used."""
        work = [port.run() for port in self.ports.values()]
        if self._pipeline.encoders.cyclic is not None:
            work.append(self._send_cyclic(*self._pipeline.encoders.cyclic))
        return work

    def counters(self) -> dict[str, dict[str, int]]:
        """Counters of each port, by its source."""
        return {name: dict(port.counters) for name, port in self.ports.items()}

    def _on_frames(self, frames: Sequence[CanFrame]) -> None:
        # After a stall of the host both have data waiting, and the filter does not wait for a gyro that is more than
        # estimation.reorder_s behind the wheels' newest sample.
        if self._line is not None:
            self._line.read_waiting()
        self._pipeline.on_frames(frames)
        self._send(self._pipeline.encoders.take_replies())

    def _send(self, frames: Sequence[CanFrame]) -> None:
        for frame in frames:
            self._bus.send(frame.can_id, frame.data, frame.extended)

    async def _send_cyclic(self, frame: CanFrame, period_s: float) -> None:
        while True:
            self._send((frame,))
            await asyncio.sleep(period_s)

    def _state_of(self, source: str) -> Callable[[str | None], None]:
        def on_state(text: str | None) -> None:
            self._pipeline.port_state(source, text, time.monotonic_ns())
            if source == "encoders.port" and text is None:
                self._send(self._pipeline.encoders.start_frames())
            self._on_state(source, text)

        return on_state
