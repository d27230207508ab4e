"""The whole command `drd fleet update`: with nothing new, and (`python -m bench.fleet`) with simulated recordings."""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from fleet_stub import rows
from tqdm import tqdm

from bench.report import Figure, Refused, Report, table
from drd_tools.fleet.discover import discover
from drd_tools.fleet.histories import Drive, draw
from drd_tools.fleet.simulate_command import folder_of, record
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
        done = min((_updated([runs], store, 1) for _ in range(3)), key=lambda one: one.wall_s)
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


def _updated(runs: Sequence[Path], store: Path, jobs: int) -> Ran:
    argv = [sys.executable, "-m", "drd", "fleet", "update", *map(str, runs), "--store", str(store), "--jobs", str(jobs)]
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
    made, began_s = 0, time.perf_counter()
    for k, drive in enumerate(tqdm(_drives(count), desc="simulating", unit="recording", disable=None)):
        done = folder / f"{k}.done"  # what was interrupted is made again
        if not done.exists():
            record(drive, k, 0, seconds, folder / "runs")
            done.touch()
            made += 1
    return (time.perf_counter() - began_s) / max(made, 1)


def _drives(count: int) -> list[Drive]:
    return draw(40, -(-count // 30), 0).drives[:count]


def throughput(count: int, alone: int, minutes: float, jobs: int, folder: Path) -> Report:
    """Update a new store with one process, of `alone` recordings, and with `jobs`, of all.

    Leaves the recordings in `folder` for the next time.
    """
    folder.mkdir(parents=True, exist_ok=True)
    each_s = simulated(count, 60.0 * minutes, folder)
    size = sum(f.stat().st_size for f in (folder / "runs").rglob("*") if f.is_file())
    runs = [folder / "runs" / folder_of(drive) for drive in _drives(count)]
    ran: list[Ran] = []
    for n, chosen in ((1, runs[:alone]), (jobs, runs)):
        shutil.rmtree(folder / f"store-{n}", ignore_errors=True)
        ran.append(_updated(chosen, folder / f"store-{n}", n))
        print(ran[-1].text, flush=True)
    one, many = ran
    (one_s, one_cpu_s), (many_s, many_cpu_s) = ((r.wall_s / n, r.cpu_s / n) for r, n in ((one, alone), (many, count)))
    return Report(
        f"fleet: {minutes:g} minutes each, {alone} recordings with one process and {count} with {jobs}",
        f"simulated in {each_s:.1f} s each, {size / count / MIB:.1f} MiB each; efficiency: speed-up over processes",
        (
            Figure("1 process", one_s, "s each"),
            Figure(f"{jobs} processes", many_s, "s each", many_s / one_s),
            Figure("efficiency", one_s / (jobs * many_s), ""),
            Figure("of processors, 1 process", one_cpu_s, "s each"),
            Figure(f"of processors, {jobs} processes", many_cpu_s, "s each", many_cpu_s / one_cpu_s),
            Figure("recordings", S_PER_H / many_s, "per hour"),
            Figure("memory of the largest process", max(one.peak_bytes, many.peak_bytes) / MIB, "MiB"),
            Figure(f"{MANY} would take", MANY * many_s / S_PER_H, "h"),
        ),
    )


def main() -> None:
    """Measure the throughput and print it."""
    parser = argparse.ArgumentParser(prog="python -m bench.fleet", description=throughput.__doc__)
    parser.add_argument("--recordings", type=int, default=500, metavar="N")
    parser.add_argument("--alone", type=int, metavar="N", help="with one process, the first N only (default: all)")
    parser.add_argument("--minutes", type=float, default=10.0, metavar="M", help="of each")
    parser.add_argument("--jobs", type=int, default=2, metavar="N")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="for recordings and stores")
    chosen = parser.parse_args()
    alone = min(chosen.alone or chosen.recordings, chosen.recordings)
    print(table(throughput(chosen.recordings, alone, chosen.minutes, chosen.jobs, chosen.output)))


if __name__ == "__main__":
    main()
