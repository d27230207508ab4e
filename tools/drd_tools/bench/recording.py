"""What recording costs: two daemons side by side, one of which records, with the same inputs in turn."""

import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

import can

from drd.config_file import load_config
from drd.units import S_PER_NS
from drd_tools.bench.cpu import usage
from drd_tools.bench.latency import latencies_us
from drd_tools.bench.listener import listening
from drd_tools.bench.report import Figure, Refused, Report
from drd_tools.bench.robot import Circle, config_text, free_endpoint
from drd_tools.bench.timing import percentile
from drd_tools.emulate.endpoints import PtyLink, can_endpoint
from drd_tools.recordings.mcap_file import open_mcap

ALONE, RECORDED = "alone", "recorded"
QUARTER_S: Final = 0.025
READY_TIMEOUT_S: Final = 30.0


def run(quick: bool) -> Report:
    """Run both for a while. Raises Refused where one of them does not run well."""
    rounds = 40 if quick else 600
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        robots = [stack.enter_context(_robot(Path(name) / which, which)) for which in (ALONE, RECORDED)]
        keys = [f"{robot.name}/pose" for robot in robots]
        with listening([robot.endpoint for robot in robots], keys) as listener:
            before = [usage(robot.process.pid) for robot in robots]
            began_s = time.monotonic()
            for _ in range(rounds):
                _round(robots)
            seconds = time.monotonic() - began_s
            after = [usage(robot.process.pid) for robot in robots]
            heard_ns = listener.arrivals_ns()
        for robot in robots:
            robot.end()
        written_kb_s = _written_kb_s(Path(name) / RECORDED / "recordings")
    latencies = [latencies_us(robot.written_ns, heard_ns[key]) for robot, key in zip(robots, keys, strict=True)]
    figures = []
    for percent in (50, 99):
        alone, recorded = (percentile(values, percent) for values in latencies)
        figures.append(Figure(f"packet to subscriber, p{percent}: not recording", alone, "us"))
        figures.append(Figure(f"packet to subscriber, p{percent}: recording", recorded, "us", recorded / alone))
    alone, recorded = (100.0 * (b.cpu_s - a.cpu_s) / seconds for a, b in zip(before, after, strict=True))
    figures += [
        Figure("CPU, not recording", alone, "% of core"),
        Figure("CPU, recording", recorded, "% of core", recorded / alone),
        Figure("written", written_kb_s, "kB/s"),
    ]
    return Report(
        f"recording: two `drd run`, one of which records; gyro at 10 Hz, encoders at 20 Hz over SLCAN, {seconds:.0f} s",
        "how many times longer a pose takes, and how many times more of a core the daemon, when it records",
        tuple(figures),
    )


class _Robot:
    """One daemon with its devices, which this process is."""

    def __init__(self, folder: Path, name: str, process: "subprocess.Popen[bytes]", endpoint: str):
        self.name, self.process, self.endpoint, self._folder = name, process, endpoint, folder
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

    def wait_until_ready(self) -> None:
        """Raises Refused where the daemon does not get ready."""
        deadline_s = time.monotonic() + READY_TIMEOUT_S
        while "ready robot=" not in (text := (self._folder / "log").read_text(encoding="utf-8")):
            if self.process.poll() is not None or time.monotonic() > deadline_s:
                raise Refused(f"recording: the daemon did not become ready: {text[-500:]}")
            self.bus.received()
            time.sleep(0.02)

    def end(self) -> None:
        """Stop the daemon in good order. Raises Refused."""
        self.process.send_signal(signal.SIGTERM)
        if self.process.wait(15) != 0:
            raise Refused(f"recording: the daemon ended with code {self.process.returncode}")


@contextmanager
def _robot(folder: Path, name: str) -> Iterator[_Robot]:
    folder.mkdir()
    endpoint = free_endpoint()
    text = config_text(folder, endpoint, publish_on="gyro").replace("prefix: bench", f"prefix: {name}")
    if name == RECORDED:
        text += f"recording: {{enabled: true, folder: {folder / 'recordings'}}}\n"
    file = folder / "drd.yaml"
    file.write_text(text, encoding="utf-8")
    with ExitStack() as stack:
        log = stack.enter_context((folder / "log").open("w", encoding="utf-8"))
        process = stack.enter_context(subprocess.Popen([sys.executable, "-m", "drd", "run", str(file)], stderr=log))
        stack.callback(process.kill)
        robot = _Robot(folder, name, process, endpoint)
        for device in (robot.fog, robot.bus):
            device.open()
            stack.callback(device.close)
        robot.wait_until_ready()
        yield robot


def _round(robots: list[_Robot]) -> None:
    """0.1 s: both robots' wheels twice, and each one's gyro once, in turn."""
    for robot in robots:
        for each in robots:
            each.turn_wheels()
        time.sleep(QUARTER_S)
        robot.send_packet()
        time.sleep(QUARTER_S)


def _written_kb_s(folder: Path) -> float:
    """Of a run that was recorded whole, in one file. Raises Refused."""
    files = list(folder.glob("*.mcap"))
    found = open_mcap(files[0]) if len(files) == 1 else None
    if found is None or found.end is None or found.end["lost"] != "0":
        raise Refused("recording: the recording is not complete")
    return found.path.stat().st_size / found.seconds / 1e3
