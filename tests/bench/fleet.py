"""The whole command `drd fleet update`: with nothing new, and (`python -m bench.fleet`) with simulated recordings."""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from fleet_stub import rows
from tqdm import tqdm

from bench.report import Figure, Refused, Report, table
from drd_tools.fleet.discover import discover
from drd_tools.fleet.histories import draw
from drd_tools.fleet.simulate_command import record
from drd_tools.fleet.store import Store
from drd_tools.fleet.task import build

KB, MIB, S_PER_H = 1024.0, 2.0**20, 3600.0
FILES = ("encoders.csv", "fog.csv", "reference.csv", "robot.yaml")
MANY = 10_000  # recordings of a fleet, as the goals have it


class Ran(NamedTuple):
    """A command: time on the clock, of processors, the largest of its processes, and what it printed."""

    wall_s: float
    cpu_s: float
    peak_bytes: float
    text: str


def run(quick: bool) -> Report:
    """An update with nothing new: folders of tiny files, and a store that has them all."""
    count = 300 if quick else MANY
    with tempfile.TemporaryDirectory() as folder:
        runs, store = Path(folder) / "runs", Path(folder) / "store"
        for i in range(count):
            one = runs / f"robot_{i % 100:03}" / f"run_{i:05}"
            one.mkdir(parents=True)
            for name in FILES:
                (one / name).write_text(str(i))
        seen = [(s, {"signature": s.signature, "build": build()}) for s in discover([runs])]
        made = Store(store)
        with made.writing():
            made.put_all([rows(s.name, s.uri, 1.0, **about) for s, about in seen])
        done = min((_updated(runs, store, 1) for _ in range(3)), key=lambda one: one.wall_s)
    if f"{count} recordings: 0 analysed" not in done.text:
        raise Refused(f"fleet: not all was there before: {done.text[:200]}")
    return Report(
        f"fleet: an update of {count} recordings of which none is new, the whole command",
        "the best of three; the largest process's memory",
        (
            Figure("on the clock", done.wall_s, "s"),
            Figure("of processors", done.cpu_s, "s"),
            Figure("memory", done.peak_bytes / MIB, "MiB"),
        ),
    )


def _updated(runs: Path, store: Path, jobs: int) -> Ran:
    argv = [sys.executable, "-m", "drd", "fleet", "update", str(runs), "--store", str(store), "--jobs", str(jobs)]
    began_s = time.perf_counter()
    with tempfile.TemporaryFile("w+") as out, subprocess.Popen(argv, stdout=out) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall_s = time.perf_counter() - began_s
        out.seek(0)
        text = out.read()
    if process.returncode:
        raise Refused(f"fleet: the command ended with {process.returncode}")
    return Ran(wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss * KB, text)


def simulated(count: int, seconds: float, folder: Path) -> float:
    """Make recordings of a fleet, those that are not there yet; returns the time of each that was made, s."""
    drives = draw(40, -(-count // 30), 0).drives[:count]
    made, began_s = 0, time.perf_counter()
    for k, drive in enumerate(tqdm(drives, desc="simulating", unit="recording", disable=None)):
        done = folder / f"{k}.done"  # what was interrupted is made again
        if not done.exists():
            record(drive, k, 0, seconds, folder / "runs")
            done.touch()
            made += 1
    return (time.perf_counter() - began_s) / max(made, 1)


def throughput(count: int, minutes: float, jobs: int, folder: Path) -> Report:
    """Update a new store with one process, and with `jobs`. Leaves the recordings in `folder` for the next time."""
    folder.mkdir(parents=True, exist_ok=True)
    each_s = simulated(count, 60.0 * minutes, folder)
    size = sum(f.stat().st_size for f in (folder / "runs").rglob("*") if f.is_file())
    ran: list[Ran] = []
    for n in (1, jobs):
        shutil.rmtree(folder / f"store-{n}", ignore_errors=True)
        ran.append(_updated(folder / "runs", folder / f"store-{n}", n))
        print(ran[-1].text, flush=True)
    one, many = ran
    return Report(
        f"fleet: {count} recordings of {minutes:g} minutes, with one process and with {jobs}",
        f"simulated in {each_s:.1f} s each, {size / count / MIB:.1f} MiB each; efficiency: speed-up over processes",
        (
            Figure("1 process", one.wall_s, "s"),
            Figure(f"{jobs} processes", many.wall_s, "s", many.wall_s / one.wall_s),
            Figure("efficiency", one.wall_s / (jobs * many.wall_s), ""),
            Figure("of processors, 1 process", one.cpu_s / count, "s each"),
            Figure(f"of processors, {jobs} processes", many.cpu_s / count, "s each", many.cpu_s / one.cpu_s),
            Figure("recordings", count / many.wall_s * S_PER_H, "per hour"),
            Figure("memory of the largest process", max(one.peak_bytes, many.peak_bytes) / MIB, "MiB"),
            Figure(f"{MANY} would take", MANY / count * many.wall_s / S_PER_H, "h"),
        ),
    )


def main() -> None:
    """Measure the throughput and print it."""
    parser = argparse.ArgumentParser(prog="python -m bench.fleet", description=throughput.__doc__)
    parser.add_argument("--recordings", type=int, default=500, metavar="N")
    parser.add_argument("--minutes", type=float, default=10.0, metavar="M", help="of each")
    parser.add_argument("--jobs", type=int, default=2, metavar="N")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="for recordings and stores")
    chosen = parser.parse_args()
    print(table(throughput(chosen.recordings, chosen.minutes, chosen.jobs, chosen.output)))


if __name__ == "__main__":
    main()
