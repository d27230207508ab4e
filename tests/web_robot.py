"""A simulated daemon on Zenoh that drives a circle, and a `drd web` in this process that listens to it."""

import contextlib
import json
import math
import threading
import time
from collections.abc import AsyncIterator, Iterator
from typing import Any

import aiohttp
from links import HANDLERS, event_loop

from drd.config.keys import Output
from drd.output.messages import Refused, encode, pose_dict
from drd.output.session import isolated_config
from drd.output.zenoh_link import ZenohLink
from drd.samples import Pose, Reason, Validity
from drd_tools.web.daemon import DaemonLink
from drd_tools.web.guard import HEADER, Guard
from drd_tools.web.server import Server, serving

RADIUS_M = 5.0
HEALTH: dict[str, Any] = {
    "robot": "carousel",
    "version": "1.2.3",
    "uptime_s": 61.0,
    "fog_rate_hz": 10.0,
    "wheel_rate_hz": 20.0,
    "pose_rate_hz": 20.0,
    "latency_mean_ms": 0.5,
    "latency_max_ms": 2.0,
    "fog_temperature_c": 24.5,
    "drive": "differential",
    "learned": {
        "tread_m": {"value": 0.61, "sigma": 0.002, "verdict": "learned"},
        "gyro_scale": {"value": 1.2, "sigma": 0.01, "verdict": "outside its prior"},
        "wheel_jitter_s": {"value": 0.01, "sigma": None, "verdict": "not observable yet"},
    },
    "counters": {"fog": {"samples": 77, "bad_checksum": 0}, "encoders.port": {"opens": 1}},
}


def pose_at(sequence: int, t_ns: int, validity: Validity = Validity.VALID, reasons: tuple[Reason, ...] = ()) -> Pose:
    """Pose number `sequence` on the circle, at 20 per second and 1 m/s."""
    angle = sequence * 0.05 / RADIUS_M
    x_m, y_m = RADIUS_M * math.sin(angle), RADIUS_M * (1.0 - math.cos(angle))
    covariance = (0.04, 0.01, 0.0, 0.09, 0.0, 1e-4)
    return Pose(t_ns, sequence, x_m, y_m, angle, 1.0, 0.2, 0.01, 1e-3, covariance, 0.9, validity, reasons)


def pose_payload(sequence: int = 1, wall_ns: int = 1_000_000_000, **changes: Any) -> bytes:
    """The same as published, with changed fields."""
    return encode(pose_dict(pose_at(sequence, 10**9 + sequence * 50_000_000), wall_ns) | changes)


class Robot:
    """Publishes 20 poses a second, each with a health; values assigned to it apply from the next on."""

    def __init__(self, endpoint: str, commands: bool):
        self.endpoint, self.commands = endpoint, commands
        self.validity = Validity.VALID
        self.reasons: tuple[tuple[str, str], ...] = ()  # sources and texts
        self.is_silent = False
        self.requests: list[tuple[str, dict[str, Any]]] = []

    def handlers(self) -> dict[str, Any]:
        """Its query handlers."""

        def command(name: str, payload: dict[str, Any]) -> dict[str, Any]:
            if name == "calibrate_bias":
                raise Refused("the robot moves")
            self.requests.append((name, payload))
            return payload

        commands = {name: lambda p, name=name: command(name, p) for name in ("set_pose", "reset", "calibrate_bias")}
        return HANDLERS | commands | {"config": lambda _: {"config": {"output": {"commands": self.commands}}}}


@contextlib.contextmanager
def a_robot(endpoint: str, commands: bool = True) -> Iterator[Robot]:
    """A robot that publishes until the end of the block."""
    robot, stop = Robot(endpoint, commands), threading.Event()
    with event_loop() as loop:
        link = ZenohLink(Output(listen=(endpoint,), commands=commands), robot.handlers(), loop)

        def publish() -> None:
            sequence = 0
            while not stop.wait(0.05):
                if robot.is_silent:
                    continue
                sequence += 1
                now_ns = time.monotonic_ns()
                reasons = tuple(Reason(source, text, now_ns - 10**9) for source, text in robot.reasons)
                link.publish_pose(pose_at(sequence, now_ns, robot.validity, reasons), time.time_ns())
                link.publish_health(HEALTH | {"monotonic_ns": now_ns})

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            yield robot
        finally:
            stop.set()
            thread.join()
            assert link.close(10.0)


@contextlib.asynccontextmanager
async def a_web(endpoint: str, token: str | None = None, port: int = 0) -> AsyncIterator[str]:
    """`drd web` without its command line; yields its address."""
    link = DaemonLink(isolated_config("client", (), (endpoint,)), "drd")
    async with serving(Server(link, Guard(token, (), port)), "127.0.0.1", port) as chosen:
        yield f"http://127.0.0.1:{chosen}"


async def next_message(socket: aiohttp.ClientWebSocketResponse, kind: str) -> dict[str, Any]:
    """The next message of this type."""
    while True:
        message: dict[str, Any] = json.loads(await socket.receive_str(timeout=20.0))
        if message["type"] == kind:
            return message


COMMAND = {HEADER: "1"}
