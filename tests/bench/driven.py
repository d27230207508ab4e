"""`drd run` as a process of its own, with its devices, which this process is: packets are written when it says so."""

import subprocess
import sys
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

import can

from bench.cpu import end, wait_until_ready
from bench.listener import ENVIRONMENT
from bench.report import Refused
from bench.robot import Circle, config_text, free_endpoint
from drd.config.file import load_config
from drd.units import S_PER_NS
from drd_tools.emulate.endpoints import PtyLink, can_endpoint

QUARTER_S: Final = 0.025


class Driven:
    """One daemon with its devices. `written_ns`: when each packet of the gyro was written."""

    def __init__(self, folder: Path, name: str, process: "subprocess.Popen[bytes]", endpoint: str):
        self.name, self.process, self.endpoint = name, process, endpoint
        config = load_config(folder / "drd.yaml").value
        self.fog, self.bus = PtyLink(config.fog.port, "fog.port"), can_endpoint(config.encoders)
        self.written_ns: list[int] = []
        self._circle = Circle(config)
        self._start_ns = time.monotonic_ns()

    def turn_wheels(self) -> None:
        """Send both counters."""
        self.bus.received()  # the adapter's commands
        now_ns = time.monotonic_ns()
        for frame in self._circle.wheel_frames((now_ns - self._start_ns) * S_PER_NS, now_ns):
            self.bus.send(can.Message(arbitration_id=frame.can_id, is_extended_id=frame.extended, data=frame.data))

    def send_packet(self) -> None:
        """Send a packet of the gyro."""
        packet = self._circle.fog_packet()
        self.written_ns.append(time.monotonic_ns())
        self.fog.write(packet)

    def round(self) -> None:
        """0.1 s: the wheels twice, the gyro once."""
        self.turn_wheels()
        time.sleep(QUARTER_S)
        self.send_packet()
        time.sleep(QUARTER_S)
        self.turn_wheels()
        time.sleep(2 * QUARTER_S)

    def end(self) -> None:
        """Stop the daemon in good order. Raises Refused."""
        end(self.process)


@contextmanager
def driven(
    folder: Path,
    name: str,
    keys: str = "",
    start_with: Sequence[str] = (),
    output: str = "",
    changed: Callable[[str], str] = str,
) -> Iterator[Driven]:
    """A running daemon that publishes `name`/pose with each packet of the gyro. Raises Refused.

    `keys`: further lines of its configuration. `start_with`: a command that starts the one behind it. `output`: further
    keys of that section. `changed`: what the whole text is to be instead.
    """
    folder.mkdir()
    endpoint = free_endpoint()
    section = ", ".join(filter(None, (f"prefix: {name}", output)))
    text = changed(config_text(folder, endpoint, publish_on="gyro").replace("prefix: bench", section) + keys)
    file = folder / "drd.yaml"
    file.write_text(text, encoding="utf-8")
    with ExitStack() as stack:
        log = stack.enter_context((folder / "log").open("w", encoding="utf-8"))
        command = [*start_with, sys.executable, "-m", "drd", "run", str(file)]
        process = stack.enter_context(subprocess.Popen(command, stderr=log, env=ENVIRONMENT))
        stack.callback(process.kill)
        robot = Driven(folder, name, process, endpoint)
        for device in (robot.fog, robot.bus):
            device.open()
            stack.callback(device.close)
        wait_until_ready(process, folder / "log", robot.bus.received)
        yield robot


def delays_ms(written_ns: Sequence[int], heard_ns: Sequence[int]) -> list[float]:
    """From each packet to its pose, however late; a pose answers one packet. Raises Refused if one in ten has none."""
    found: list[float] = []
    used = 0
    for sent_ns in written_ns:
        i = max(used, bisect_left(heard_ns, sent_ns))
        if i < len(heard_ns):
            found.append((heard_ns[i] - sent_ns) / 1e6)
            used = i + 1
    if len(found) < 0.9 * len(written_ns) or not found:
        raise Refused(f"{len(found)} of {len(written_ns)} packets were answered")
    return found
