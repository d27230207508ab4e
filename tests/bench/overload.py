"""Everything too much: a crowd of clients, a full bus, a very fast gyro, a slow disk; one by one and all at once."""

import json
import sys
import tempfile
import time
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import zenoh
from tqdm import tqdm

from bench.cpu import BYTES_PER_MIB, usage
from bench.crowd import crowd
from bench.driven import Driven, driven
from bench.feed import feeding
from bench.listener import listening
from bench.report import Figure, Refused, Report
from bench.robot import Circle
from bench.timing import percentile
from drd.config.file import load_config
from drd.output.session import isolated_config
from drd.units import NS_PER_MS, NS_PER_S

NAME: Final = "overload"
KINDS: Final = {
    "unloaded": (),
    "clients": ("clients",),
    "bus": ("bus",),
    "gyro": ("gyro",),
    "disk": ("disk",),
    "all": ("clients", "bus", "gyro", "disk"),
}
CLIENTS: Final = 200
PER_PROCESS: Final = 50
# The shortest frames with a byte of data: 500 kbit/s hold no more of them.
FOREIGN_PER_S: Final = 8000
FOREIGN_AT_ONCE: Final = 8
GYRO_HZ: Final = 2000
WHEELS_HZ: Final = 20
SETTLING_S: Final = 3.0
# With the clients' own small buffers, so that a stalled one's connection is full after a second.
SEND_BUFFER_BYTES: Final = 8192


class Phase(NamedTuple):
    """What the daemon did under one load."""

    delays: list[float]  # ms
    turned: int
    cpu_percent: float
    resident_mib: tuple[float, float]
    health: dict[str, Any]
    log_lines: int
    fewest_heard: float  # poses of the least lucky client that reads, of those that were published


def run(quick: bool) -> Report:
    """Run a daemon for each load. Raises Refused where one does not run, or a pose of ten is missing."""
    kinds, seconds, clients = (("unloaded", "all"), 3.0, 8) if quick else (tuple(KINDS), 30.0, CLIENTS)
    found: dict[str, Phase] = {}
    with tempfile.TemporaryDirectory() as folder:
        for kind in tqdm(kinds, desc=NAME, disable=None, leave=False):
            found[kind] = _measured(Path(folder) / kind, KINDS[kind], seconds, clients)
    return Report(
        f"overload: a pose's last input written to the pose at a subscriber, {seconds:g} s each. clients: {clients} sessions, half of "
        f"them stalled; bus: {FOREIGN_PER_S} foreign frames/s over SLCAN; gyro: {GYRO_HZ} Hz; disk: records at 1 MB/s",
        "times what it is unloaded; of the resident memory, end over begin; all counters are to be 0 where nothing is refused",
        tuple(figure for kind in found for figure in figures(kind, found[kind], found["unloaded"])),
    )


def figures(kind: str, phase: Phase, unloaded: Phase) -> Iterator[Figure]:
    """Of one load."""
    for percent in (50, 99):
        value = percentile(phase.delays, percent)
        yield Figure(f"{kind}: latency, p{percent}", value, "ms", value / percentile(unloaded.delays, percent))
    yield Figure(f"{kind}: poses late or lost", phase.turned - len(phase.delays), f"of {phase.turned}")
    yield Figure(f"{kind}: CPU", phase.cpu_percent, "% of core", phase.cpu_percent / unloaded.cpu_percent)
    begin, end = phase.resident_mib
    yield Figure(f"{kind}: resident memory", end, "MiB", end / begin)
    counters, recording = phase.health["counters"], phase.health["recording"]
    for part, name in (("encoders.port", "queue_dropped"), ("zenoh", "full_queues"), ("fog", "samples")):
        yield Figure(f"{kind}: {part}.{name}", counters[part][name], "")
    if recording is not None:
        yield Figure(f"{kind}: recording.lost", recording["lost"], f"of {recording['lost'] + recording['written']}")
        yield Figure(f"{kind}: recording.waiting", recording["waiting"], "entries")
    if "clients" in KINDS[kind]:
        yield Figure(f"{kind}: least of the poses that a client heard", 100.0 * phase.fewest_heard, "%")
    yield Figure(f"{kind}: lines of log", phase.log_lines, "")


def _measured(folder: Path, loads: Sequence[str], seconds: float, clients: int) -> Phase:
    recorded = f"recording: {{enabled: true, folder: {folder}/recordings}}\n" if "disk" in loads else ""
    start_with = [sys.executable, "-m", "bench.slow_disk"] if "disk" in loads else ()

    def changed(text: str) -> str:
        text = text.replace("]}", f"#so_sndbuf={SEND_BUFFER_BYTES}]}}")
        return text.replace("protocol: ecore", f"protocol: ecore, rate_hz: {GYRO_HZ if 'gyro' in loads else WHEELS_HZ}")

    with ExitStack() as stack:
        robot = stack.enter_context(driven(folder, NAME, recorded, start_with, changed=changed))
        key = f"{NAME}/pose"
        listener = stack.enter_context(listening((robot.endpoint,), (key,)))
        session = stack.enter_context(zenoh.open(isolated_config("client", (), (robot.endpoint,))))
        crowds = []
        for _ in range(-(-clients // PER_PROCESS) if "clients" in loads else 0):
            each = min(PER_PROCESS, clients // 2)
            crowds.append(stack.enter_context(crowd(robot.endpoint, key, each)))
        for stalled in crowds[: len(crowds) // 2]:
            stalled.stall()
        if "bus" in loads:
            stack.enter_context(feeding(robot.bus._pty._master, _foreign(), FOREIGN_PER_S / FOREIGN_AT_ONCE))
        if "gyro" in loads:
            circle = Circle(load_config(folder / "drd.yaml").value)
            packets = [circle.fog_packet() for _ in range(GYRO_HZ)]
            stack.enter_context(feeding(robot.fog._master, packets, GYRO_HZ))
        _drive(robot, SETTLING_S, "gyro" in loads)
        lines, before = _lines(folder), usage(robot.process.pid)
        began_s, turned_ns = time.monotonic(), _drive(robot, seconds, "gyro" in loads)
        after, elapsed_s = usage(robot.process.pid), time.monotonic() - began_s
        health = _asked(session)
        heard = [count for each in crowds[len(crowds) // 2 :] for count in each.heard()]
        times = listener.arrivals_ns()[key]
        lines = _lines(folder) - lines
        robot.end()
    published = health["counters"]["zenoh"]["poses"]
    return Phase(
        _answered_ms(turned_ns, times),
        len(turned_ns),
        100.0 * (after.cpu_s - before.cpu_s) / elapsed_s,
        (before.resident_bytes / BYTES_PER_MIB, after.resident_bytes / BYTES_PER_MIB),
        health,
        lines,
        min(heard, default=0) / published,
    )


def _drive(robot: Driven, seconds: float, gyro_is_fed: bool) -> list[int]:
    """Turn the wheels and, where nobody else feeds it, let the gyro speak; when the last of a pose's inputs was written."""
    start_s, period_s = time.monotonic(), 1.0 / WHEELS_HZ
    robot.written_ns.clear()
    turned_ns = []
    for number in range(round(seconds * WHEELS_HZ)):
        turned_ns.append(time.monotonic_ns())
        robot.turn_wheels()
        time.sleep(max(0.0, start_s + (number + 0.5) * period_s - time.monotonic()))
        if not gyro_is_fed:
            robot.send_packet()
        time.sleep(max(0.0, start_s + (number + 1) * period_s - time.monotonic()))
    return turned_ns if gyro_is_fed else robot.written_ns


def _answered_ms(written_ns: Sequence[int], heard_ns: Sequence[int]) -> list[float]:
    """From each input to its pose, of those that have one before the next input. Raises Refused if one in ten has none."""
    found = []
    for sent_ns, next_ns in pairwise((*written_ns, written_ns[-1] + round(NS_PER_S / WHEELS_HZ))):
        i = bisect_left(heard_ns, sent_ns)
        if i < len(heard_ns) and heard_ns[i] < next_ns:
            found.append((heard_ns[i] - sent_ns) / NS_PER_MS)
    if len(found) < 0.9 * len(written_ns):
        raise Refused(f"overload: {len(found)} of {len(written_ns)} poses came in time")
    return found


def _foreign() -> list[bytes]:
    """Lines of SLCAN with frames that nobody asked for."""
    frames = [f"t{0x200 + number:03X}1{number:02X}\r".encode() for number in range(128)]
    return [b"".join(frames[i : i + FOREIGN_AT_ONCE]) for i in range(0, len(frames), FOREIGN_AT_ONCE)]


def _lines(folder: Path) -> int:
    return len((folder / "log").read_text(encoding="utf-8").splitlines())


def _asked(session: Any) -> dict[str, Any]:
    for reply in session.get(f"{NAME}/health", timeout=10.0):
        if reply.ok is not None:
            found: dict[str, Any] = json.loads(reply.ok.payload.to_bytes())
            return found
    raise Refused("overload: the daemon did not answer")
