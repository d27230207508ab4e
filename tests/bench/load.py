"""From the gyro's packet to a subscriber while all cores are busy, with and without real-time scheduling."""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

from bench.driven import Driven, delays_ms, driven
from bench.listener import listening
from bench.report import Figure, Report
from bench.timing import percentile

# The priority of systemd/realtime.conf, and one above it for the measuring side, which must not be what is late.
DAEMON_PRIORITY: Final = 10
MEASURING_PRIORITY: Final = 20
SETTLING_S: Final = 1.0
PARTS: Final = (50, 99, 100)
# Policy and priority, then the command that they are for.
START: Final = "import os, sys; n = int(sys.argv[1]); os.sched_setscheduler(0, os.SCHED_FIFO if n else os.SCHED_OTHER, "
START_WITH: Final = (sys.executable, "-c", f"{START}os.sched_param(n)); os.execvp(sys.argv[2], sys.argv[2:])")


def run(quick: bool) -> Report:
    """Measure quiet and loaded, with normal scheduling and, where the machine permits it, with SCHED_FIFO."""
    rounds = 15 if quick else 200
    refusal = _refusal()
    kinds = {"normal": 0} if refusal else {"normal": 0, "real-time": DAEMON_PRIORITY}
    figures: list[Figure] = []
    normal: list[float] = []
    for kind, priority in kinds.items():
        quiet, loaded = _measured(priority, rounds, measure_first=not refusal)
        for name, values, yardstick in (("quiet", quiet, None), ("loaded", loaded, quiet)):
            for percent in PARTS:
                value = percentile(values, percent)
                ratio = None if yardstick is None else value / percentile(yardstick, percent)
                figures.append(Figure(f"{kind}, {name}: {_part(percent)}", value, "ms", ratio))
        if normal:
            for percent in PARTS:
                value = percentile(loaded, percent)
                ratio = value / percentile(normal, percent)
                figures.append(Figure(f"loaded, real-time against normal: {_part(percent)}", value, "ms", ratio))
        normal = normal or loaded
    note = f"; SCHED_FIFO is refused here ({refusal}), so that only normal scheduling is measured" if refusal else ""
    return Report(
        f"load: packet written to pose at a subscriber, {rounds} each; loaded: {os.cpu_count()} busy processes{note}",
        "times what it is with nothing else to do; last, real-time scheduling against normal, both loaded",
        tuple(figures),
    )


def _part(percent: int) -> str:
    return "longest" if percent == 100 else f"p{percent}"


def _refusal() -> str:
    """Why this process may not have SCHED_FIFO; empty: it may."""
    done = subprocess.run([*START_WITH, str(MEASURING_PRIORITY), "true"], capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else done.stderr.strip().rpartition("\n")[2]


def _measured(priority: int, rounds: int, measure_first: bool) -> tuple[list[float], list[float]]:
    """Delays in ms, quiet and loaded, of one daemon."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        robot = stack.enter_context(driven(Path(name) / "load", "load", start_with=(*START_WITH, str(priority))))
        if measure_first:
            stack.enter_context(_first())
        with listening((robot.endpoint,), ("load/pose",)) as listener:
            _rounds(robot, round(SETTLING_S / 0.1))
            robot.written_ns.clear()
            _rounds(robot, rounds)
            quiet_ns, robot.written_ns = robot.written_ns, []
            with _busy(os.cpu_count() or 1):
                time.sleep(SETTLING_S)
                _rounds(robot, rounds)
            heard_ns = listener.arrivals_ns()["load/pose"]
        robot.end()
        end_ns = robot.written_ns[0]
        return (
            delays_ms(quiet_ns, [t_ns for t_ns in heard_ns if t_ns < end_ns]),
            delays_ms(robot.written_ns, [t_ns for t_ns in heard_ns if t_ns >= end_ns]),
        )


def _rounds(robot: Driven, count: int) -> None:
    for _ in range(count):
        robot.round()


@contextmanager
def _first() -> Iterator[None]:
    """This process, and those that it starts, before all others."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(MEASURING_PRIORITY))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@contextmanager
def _busy(count: int) -> Iterator[None]:
    """So many processes that only take processor time, at normal priority."""
    work: Sequence[Sequence[str]] = [[sys.executable, "-c", "while True: pass"]] * count
    if shutil.which("stress-ng"):
        work = [["stress-ng", "--quiet", "--cpu", str(count)]]
    processes = [subprocess.Popen([*START_WITH, "0", *command]) for command in work]
    try:
        yield
    finally:
        for process in processes:
            with suppress(OSError):
                process.terminate()
        for process in processes:
            process.wait(10)
