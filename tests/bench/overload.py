"""Everything too much: a crowd of clients, a full bus, a very fast gyro, a slow disk; one by one and all at once."""

import json
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from statistics import mean
from typing import Any, Final, NamedTuple, cast

import zenoh
from tqdm import tqdm

from bench.cpu import BYTES_PER_MIB, usage
from bench.crowd import crowd
from bench.driven import Driven, driven
from bench.feed import feeding
from bench.report import Figure, Refused, Report
from bench.robot import Circle
from bench.timing import percentile
from drd.config.file import load_config
from drd.output.session import isolated_config
from drd.units import NS_PER_MS

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
GYRO_LATER_S: Final = 0.001
SETTLING_S: Final = 3.0
# With the clients' own small buffers, so that a stalled one's connection is full after a second.
SEND_BUFFER_BYTES: Final = 8192


class Phase(NamedTuple):
    """Figures of the daemon under one load."""

    ages_ms: list[float]  # of the poses at a subscriber
    lost: int
    mean_ms: float  # from an input's arrival to its pose put, as the daemon measures it
    longest_ms: float
    cpu_percent: float
    resident_mib: tuple[float, float]
    health: dict[str, Any]
    log_lines: int
    fewest_heard: float  # poses of the least lucky client that reads, of those that were published


def run(quick: bool) -> Report:
    """Run a daemon for each load. Raises Refused where one does not run, or publishes too little."""
    kinds, seconds, clients = (("unloaded", "all"), 3.0, 8) if quick else (tuple(KINDS), 30.0, CLIENTS)
    found: dict[str, Phase] = {}
    with tempfile.TemporaryDirectory() as folder:
        for kind in tqdm(kinds, desc=NAME, disable=None, leave=False):
            found[kind] = _measured(Path(folder) / kind, KINDS[kind], seconds, clients)
    return Report(
        f"overload: age of a pose: from its own time to a subscriber; {seconds:g} s each. clients: {clients} sessions, "
        f"half of them stalled; bus: {FOREIGN_PER_S} foreign frames/s over SLCAN; gyro: {GYRO_HZ} Hz; disk: 1 MB/s",
        "times what it is unloaded; of the resident memory, end over begin; what is refused or lost is counted",
        tuple(figure for kind in found for figure in figures(kind, found[kind], found["unloaded"])),
    )


def figures(kind: str, phase: Phase, unloaded: Phase) -> Iterator[Figure]:
    """The table's figures for one load."""
    for percent in (50, 99):
        value = percentile(phase.ages_ms, percent)
        yield Figure(f"{kind}: age of a pose, p{percent}", value, "ms", value / percentile(unloaded.ages_ms, percent))
    for name, value, yardstick in (
        ("mean", phase.mean_ms, unloaded.mean_ms),
        ("longest", phase.longest_ms, unloaded.longest_ms),
    ):
        yield Figure(f"{kind}: input read to pose put, {name}", value, "ms", value / yardstick)
    yield Figure(f"{kind}: poses lost", phase.lost, f"of {phase.lost + len(phase.ages_ms)}")
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
        text = text.replace("publish_on: gyro", "publish_on: wheels")
        text = text.replace("]}", f"#so_sndbuf={SEND_BUFFER_BYTES}]}}")
        return text.replace("protocol: ecore", f"protocol: ecore, rate_hz: {GYRO_HZ if 'gyro' in loads else WHEELS_HZ}")

    with ExitStack() as stack:
        robot = stack.enter_context(driven(folder, NAME, recorded, start_with, changed=changed))
        key = f"{NAME}/pose"
        session = stack.enter_context(zenoh.open(isolated_config("client", (), (robot.endpoint,))))
        heard: list[tuple[int, bytes]] = []

        def note(sample: Any) -> None:
            heard.append((time.monotonic_ns(), sample.payload.to_bytes()))

        session.declare_subscriber(key, zenoh.handlers.Callback(note, indirect=False))
        reports = session.declare_subscriber(f"{NAME}/health", zenoh.handlers.RingChannel(1000))
        crowds = []
        for _ in range(-(-clients // PER_PROCESS) if "clients" in loads else 0):
            each = min(PER_PROCESS, clients // 2)
            crowds.append(stack.enter_context(crowd(robot.endpoint, key, each)))
        published = -_asked(session)["counters"]["zenoh"]["poses"]
        for stalled in crowds[: len(crowds) // 2]:
            stalled.stall()
        fog, adapter = cast(Any, robot.fog), cast(Any, robot.bus)
        masters = fog._master, adapter._pty._master
        if "bus" in loads:
            stack.enter_context(feeding(masters[1], _foreign(), FOREIGN_PER_S / FOREIGN_AT_ONCE))
        if "gyro" in loads:
            circle = Circle(load_config(folder / "drd.yaml").value)
            packets = [circle.fog_packet() for _ in range(GYRO_HZ)]
            stack.enter_context(feeding(masters[0], packets, GYRO_HZ))
        _drive(robot, SETTLING_S, "gyro" in loads)
        lines, before, began_s = _lines(folder), usage(robot.process.pid), time.monotonic()
        heard.clear()
        while reports.try_recv():
            pass
        _drive(robot, seconds, "gyro" in loads)
        after, elapsed_s = usage(robot.process.pid), time.monotonic() - began_s
        health, told = _asked(session), []
        while sample := reports.try_recv():
            told.append(json.loads(sample.payload.to_bytes()))
        poses = [(t_ns, json.loads(payload)) for t_ns, payload in heard]
        counts = [count for each in crowds[len(crowds) // 2 :] for count in each.heard()]
        lines = _lines(folder) - lines
        robot.end()
    if len(poses) < 0.5 * WHEELS_HZ * seconds or not told:
        raise Refused(f"overload: {len(poses)} poses in {seconds:g} s")
    published += health["counters"]["zenoh"]["poses"]
    return Phase(
        [(t_ns - pose["monotonic_ns"]) / NS_PER_MS for t_ns, pose in poses],
        sum(b["sequence"] - a["sequence"] - 1 for (_, a), (_, b) in pairwise(poses)),
        mean(each["latency_mean_ms"] for each in told),
        max(each["latency_max_ms"] for each in told),
        100.0 * (after.cpu_s - before.cpu_s) / elapsed_s,
        (before.resident_bytes / BYTES_PER_MIB, after.resident_bytes / BYTES_PER_MIB),
        health,
        lines,
        min(1.0, min(counts, default=0) / published),
    )


def _drive(robot: Driven, seconds: float, gyro_is_fed: bool) -> None:
    """Turn the wheels and, where nobody else feeds it, let the gyro speak."""
    start_s, period_s = time.monotonic(), 1.0 / WHEELS_HZ
    for number in range(round(seconds * WHEELS_HZ)):
        robot.turn_wheels()
        time.sleep(GYRO_LATER_S)
        if not gyro_is_fed:
            robot.send_packet()
        time.sleep(max(0.0, start_s + (number + 1) * period_s - time.monotonic()))


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
