"""Processes that diagnose end with the command that began them."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from diagnosis_runs import written


def children(pid: int) -> list[int]:
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.process
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize(
    "arguments",
    [
        ["trial", "--plant", ".", "--output", "out"],
        ["diagnose", "one", "two", "--jobs", "2", "--output", "out"],
        ["diagnose", "one", "--held-out", "two", "--jobs", "2", "--output", "out"],
        ["fleet", "update", ".", "--jobs", "2", "--store", "out"],
    ],
)
def test_the_workers_end_with_the_command(arguments: list[str], number: signal.Signals, tmp_path: Path) -> None:
    for name in ("one", "two"):
        written(tmp_path / name, drive=("square-cw", 60.0))
    command = [sys.executable, "-m", "drd", *arguments]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stderr=subprocess.PIPE, cwd=tmp_path, env=environment) as process:
        deadline_s = time.monotonic() + 180.0
        # Two workers, and what keeps book of their semaphores.
        while len(workers := children(process.pid)) < 3 and time.monotonic() < deadline_s:
            time.sleep(0.05)
        time.sleep(1.0)  # in the midst of their imports, or of a diagnosis
        assert len(workers) == 3
        process.send_signal(number)
        assert process.wait(60.0) == 128 + number
        while any(map(runs, workers)) and time.monotonic() < deadline_s:
            time.sleep(0.05)
    assert not any(map(runs, workers))


BAR = """
import time
from pathlib import Path
from tqdm import tqdm
from drd_tools.processes import pool_of

def work():
    with tqdm.get_lock():
        Path("begun").touch()
    time.sleep(600.0)

if __name__ == "__main__":
    with pool_of(1) as pool:
        pool.submit(work)
        while not Path("begun").exists():
            time.sleep(0.05)
        raise SystemExit(3)
"""


@pytest.mark.process
def test_a_worker_that_is_ended_in_a_progress_bar_leaves_no_warning(tmp_path: Path) -> None:
    (tmp_path / "bar.py").write_text(BAR)
    done = subprocess.run([sys.executable, "bar.py"], cwd=tmp_path, capture_output=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (3, b"")
