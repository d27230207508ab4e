"""The running daemon and its hardware, for tests that need the real thing."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh
from links import free_endpoint

from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.schema import Loaded
from drd.output.session import isolated_config
from drd_tools.emulate.hardware import Emulator
from drd_tools.simulate.missions import demo_drive

CONFIG = """\
robot: {{name: test, wheel_radius_m: 0.11, tread_m: 0.6}}
fog: {{protocol: ecore, port: {folder}/fog}}
encoders: {{layout: cia406, interface: slcan, channel: {folder}/can,
  counts_per_revolution: 20000, modulus_counts: 65536}}
estimation: {{static_bias: {{duration_s: {bias_s}, minimum_s: 0.5}}}}
output: {{commands: true, listen: [{endpoint}]}}
realtime: {{freeze_gc: false}}
monitor: {{enabled: false}}
"""
SPEED_M_S = 2.0  # the emulated robot drives 1.5 m/s at most
LATE_S = 0.15  # delay of a frame on a busy machine, on a line without time stamps


def farthest_m(before: dict[str, Any], pose: dict[str, Any]) -> float:
    """How far a pose may be from the one received before it without being a jump."""
    dt_s: float = (pose["monotonic_ns"] - before["monotonic_ns"]) * 1e-9
    # After a silence each pose contains the travel of its own 50 ms, however soon it follows the last one; a full queue
    # may have dropped some of a burst.
    travelled_s = max(dt_s, 0.05 * int(pose["sequence"] - before["sequence"]))
    return SPEED_M_S * (travelled_s + LATE_S) + 0.03


class Robot:
    """An emulated robot's files and a subscriber to what its daemon publishes.

    Plug the emulator in and start the daemon, then `drive`: the emulated robot stands for `stand_s` once the daemon is
    heard, so that the bias is measured however long a busy machine takes to start it.
    """

    def __init__(self, folder: Path, bias_s: float = 1.0, seconds: float = 120.0, stand_s: float = 2.0):
        self.endpoint = free_endpoint()
        self.file = folder / "robot.yaml"
        self.file.write_text(CONFIG.format(folder=folder, bias_s=bias_s, endpoint=self.endpoint))
        self.loaded: Loaded[Config] = load_config(self.file)
        self.emulator = Emulator(self.loaded.value, folder, demo_drive(seconds, stand_s=stand_s), seed=1)
        self.poses: list[dict[str, Any]] = []
        self.health: dict[str, Any] = {}
        self._session: Any = None

    def listen(self) -> None:
        """Connect to the daemon, which may take a moment, and keep all poses and the last health."""
        deadline = time.monotonic() + 15.0
        while self._session is None:
            try:
                self._session = zenoh.open(isolated_config("client", (), (self.endpoint,)))
            except zenoh.ZError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)
        self._session.declare_subscriber("drd/pose", lambda s: self.poses.append(json.loads(s.payload.to_bytes())))
        self._session.declare_subscriber("drd/health", self._on_health)

    def drive(self) -> None:
        """Listen, and start the emulator unless it is already running."""
        self.listen()
        if not self.emulator.is_running:
            self.emulator.start()

    def _on_health(self, sample: Any) -> None:
        self.health = json.loads(sample.payload.to_bytes())

    def get(self, name: str, request: dict[str, Any] | None = None) -> dict[str, Any]:
        """Query the daemon; a refusal comes as {"error": text}."""
        payload = None if request is None else json.dumps(request).encode()
        reply = next(iter(self._session.get(f"drd/{name}", payload=payload, timeout=5.0)))
        answer: dict[str, Any] = json.loads((reply.ok or reply.err).payload.to_bytes())
        return answer

    def wait(self, what: str, condition: Callable[[dict[str, Any]], bool], timeout_s: float = 8.0) -> dict[str, Any]:
        """Wait for the first new pose that fulfils the condition."""
        seen, deadline = len(self.poses), time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            while seen < len(self.poses):
                seen += 1
                if condition(self.poses[seen - 1]):
                    return self.poses[seen - 1]
            time.sleep(0.01)
        last = self.poses[-1] if self.poses else None
        raise AssertionError(f"{what}: not seen within {timeout_s} s; last pose {last}")

    def close(self) -> None:
        if self._session is not None:
            self._session.close()
        self.emulator.stop()
