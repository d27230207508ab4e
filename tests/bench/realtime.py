"""Minutes of the real daemon in real time: how its latency is distributed, and whether its memory stays."""

import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from tqdm import tqdm

from bench.cpu import BYTES_PER_MIB, usage
from bench.driven import delays_ms, driven
from bench.listener import listening
from bench.report import Figure, Report
from bench.timing import percentile

SETTLING_ROUNDS: Final = 20
ROUNDS_PER_S: Final = 10
QUICK_MINUTES: Final = 0.1
# Ends of the histogram's classes; what is longer has one of its own.
CLASSES_MS: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


def run(quick: bool, minutes: float = 1.0) -> Report:
    """Run the daemon, write packets, listen to the poses."""
    minutes = min(minutes, QUICK_MINUTES) if quick else minutes
    resident_mib: list[float] = []
    with tempfile.TemporaryDirectory() as name, driven(Path(name) / "realtime", "realtime") as robot:
        with listening((robot.endpoint,), ("realtime/pose",)) as listener:
            for _ in range(SETTLING_ROUNDS):
                robot.round()
            robot.written_ns.clear()
            began_s, before = time.monotonic(), usage(robot.process.pid)
            rounds = round(60.0 * minutes * ROUNDS_PER_S)
            for number in tqdm(range(rounds), desc="realtime", disable=None, leave=False):
                robot.round()
                if number % ROUNDS_PER_S == ROUNDS_PER_S - 1:
                    resident_mib.append(usage(robot.process.pid).resident_bytes / BYTES_PER_MIB)
            seconds, after = time.monotonic() - began_s, usage(robot.process.pid)
            heard_ns = listener.arrivals_ns()["realtime/pose"]
        robot.end()
    delays = delays_ms(robot.written_ns, [t_ns for t_ns in heard_ns if t_ns >= robot.written_ns[0]])
    early = resident_mib[max(0, len(resident_mib) // 10 - 1)]
    return Report(
        f"realtime: `drd run` for {seconds / 60.0:.1f} min, gyro at 10 Hz, encoders at 20 Hz, one subscriber",
        "packet written to pose at the subscriber, and resident memory read every second; the ratio is end over tenth",
        (
            Figure("packets", len(robot.written_ns), ""),
            Figure("poses", len(delays), ""),
            *(Figure(f"latency, p{percent:g}", percentile(delays, percent), "ms") for percent in (50, 90, 99, 99.9)),
            Figure("latency, longest", max(delays), "ms"),
            *histogram(delays),
            Figure("CPU", 100.0 * (after.cpu_s - before.cpu_s) / seconds, "% of core"),
            Figure("resident memory, after a tenth", early, "MiB"),
            Figure("resident memory, largest", max(resident_mib), "MiB"),
            Figure("resident memory, end", resident_mib[-1], "MiB", resident_mib[-1] / early),
        ),
    )


def histogram(delays: Sequence[float]) -> Iterator[Figure]:
    """How many are in each class."""
    low = 0.0
    for high in CLASSES_MS:
        yield Figure(f"from {low:g} to {high:g} ms", sum(low <= d < high for d in delays), "poses")
        low = high
    yield Figure(f"{low:g} ms and longer", sum(d >= low for d in delays), "poses")
