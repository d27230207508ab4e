"""What the real daemon costs: its share of a core and its memory, with a robot emulated by another process."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from bench.listener import listening
from bench.report import Figure, Refused, Report
from bench.robot import config_text, free_endpoint
from drd.config.file import load_config
from drd_tools.emulate.hardware import Emulator
from drd_tools.simulate.missions import demo_drive

POSE_KEY: Final = "bench/pose"
READY_TIMEOUT_S: Final = 30.0
SETTLING_S: Final = 1.0
BYTES_PER_MIB: Final = 1 << 20
Daemon = subprocess.Popen[bytes]


class Usage(NamedTuple):
    """Since the process's start: CPU seconds of all its threads, and resident memory now."""

    cpu_s: float
    resident_bytes: int


def run(quick: bool) -> Report:
    """Run the daemon for a while. Raises Refused where it does not run well."""
    measured_s = 1.0 if quick else 20.0
    with emulated_daemon(SETTLING_S + measured_s) as (pid, endpoint), listening((endpoint,), (POSE_KEY,)) as listener:
        time.sleep(SETTLING_S)
        start_ns, before = time.monotonic_ns(), usage(pid)
        time.sleep(measured_s)
        end_ns, after = time.monotonic_ns(), usage(pid)
        heard_ns = listener.arrivals_ns()[POSE_KEY]
    elapsed_s = (end_ns - start_ns) / 1e9
    poses = sum(start_ns <= t_ns < end_ns for t_ns in heard_ns)
    if poses < 0.8 * 20.0 * elapsed_s:
        raise Refused(f"cpu: only {poses} poses in {elapsed_s:.1f} s")
    used_s = after.cpu_s - before.cpu_s
    return Report(
        f"cpu: `drd run` with gyro at 10 Hz, encoders at 20 Hz over SLCAN and one subscriber, {measured_s:g} s",
        "per cent of one core, of all threads of the daemon; the emulated robot is not in it",
        (
            Figure("CPU", 100.0 * used_s / elapsed_s, "% of core"),
            Figure("CPU per pose", 1e3 * used_s / poses, "ms"),
            Figure("poses", poses / elapsed_s, "1/s"),
            Figure("resident memory", after.resident_bytes / BYTES_PER_MIB, "MiB"),
        ),
    )


def usage(pid: int) -> Usage:
    """CPU to the nanosecond, by the clock that clock_getcpuclockid(3) names; memory from /proc/PID/stat (rss)."""
    text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    fields = text.rpartition(")")[2].split()  # the name, in parentheses, may hold blanks; field 3 of proc(5) is next
    return Usage(time.clock_gettime(~pid << 3 | 2), int(fields[24 - 3]) * os.sysconf("SC_PAGE_SIZE"))


@contextmanager
def emulated_daemon(seconds: float) -> Iterator[tuple[int, str]]:
    """`drd run` as a process, its robot emulated by this one: its number and its end point. Raises Refused."""
    with tempfile.TemporaryDirectory() as name:
        folder, endpoint = Path(name), free_endpoint()
        file = folder / "drd.yaml"
        file.write_text(config_text(folder, endpoint), encoding="utf-8")
        with (
            Emulator(load_config(file).value, folder, demo_drive(READY_TIMEOUT_S + seconds, stand_s=0.0)),
            (folder / "log").open("w+", encoding="utf-8") as log,
            subprocess.Popen([sys.executable, "-m", "drd", "run", str(file)], stderr=log) as daemon,
        ):
            try:
                wait_until_ready(daemon, folder / "log")
                yield daemon.pid, endpoint
                end(daemon)
            finally:
                daemon.kill()


def wait_until_ready(daemon: Daemon, log: Path, meanwhile: Callable[[], object] = lambda: None) -> None:
    """Until the daemon's log says so. Raises Refused."""
    deadline_s = time.monotonic() + READY_TIMEOUT_S
    while "ready robot=" not in (text := log.read_text(encoding="utf-8")):
        if daemon.poll() is not None or time.monotonic() > deadline_s:
            raise Refused(f"the daemon did not become ready: {text[-500:]}")
        meanwhile()
        time.sleep(0.02)


def end(daemon: Daemon) -> None:
    """Stop it in good order. Raises Refused."""
    daemon.send_signal(signal.SIGTERM)
    if daemon.wait(15) != 0:
        raise Refused(f"the daemon ended with code {daemon.returncode}")
