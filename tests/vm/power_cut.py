"""Cuts the power of a machine that records and keeps state, boots it again, and looks at what is left.

    python tests/vm/power_cut.py --cuts 200 --output out/power-cut        (`make power-cut`)

Root, Debian. A moment is a random time after the daemon's start or after its first pose. At each cut several disks are
made of what was flushed and some of what was not (volatile_disk.py), all are examined here, and the machine boots with
one of them: its kernel mounts it, the daemon goes on from it. It goes on where it was stopped. Writes cuts.jsonl and
cuts.md.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

from tqdm import tqdm
from vm import cut, image, kernel, volatile_disk
from vm.kernel import Kernel
from vm.machine import POLL_S, Machine, console_end, poses_outside
from vm.robot import CUT

from drd.config.schema import ConfigError
from drd.state import saved
from drd.state.sealed import StateError
from drd.units import S_PER_NS
from drd_tools.recordings.mcap_file import open_mcap

# Share of the unflushed writes that a disk keeps.
SHARES: Final = (0.0, 1.0, 0.5, 0.1, 0.9, 0.5)
AFTER_START_S, AFTER_POSE_S = 8.0, 12.0
# A start beside other programs takes 30 s.
LIMIT_S: Final = 90.0
# The promise.
RECORDING_S, STATE_S = 1.0, 5.0
# The robot drives 1.5 m/s; a little for poses on their way.
SPEED_M_S, MARGIN_M = 1.6, 0.5
JOURNAL_REPLAYED: Final = (0, 1)  # e2fsck -p: nothing to do, or only what a mount does, too
NEWEST: Final = 2


class Left(NamedTuple):
    """What one disk holds: wall-clock times (ns) of the last recorded message and of the state; 0: none."""

    trouble: str
    recorded_ns: int
    state_ns: int


def examine(disk: Path, work: Path) -> Left:
    """File system, state and recordings of a disk; a copy is changed."""
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    shutil.copy(disk, work / "disk")
    fsck = ("/usr/sbin/e2fsck", "-f")
    for options, allowed in (("-p", JOURNAL_REPLAYED), ("-n", (0,))):
        done = subprocess.run((*fsck, options, work / "disk"), capture_output=True, text=True, check=False)
        if done.returncode not in allowed:
            return Left(f"file system: {done.stdout[-200:]}", 0, 0)
    image.run("debugfs", "-R", f"rdump / {work}", work / "disk")
    state = recorded = 0
    try:
        if (file := work / f"{CUT}.state").exists():
            state = saved.decoded(file.read_bytes()).moment.wall_ns
        files = sorted((work / "recordings").glob("*.mcap"))[-NEWEST:]
        recorded = max((sum_up(file) for file in files), default=0)
    except (StateError, ConfigError, ValueError) as error:
        return Left(f"unreadable: {error}", recorded, state)
    refused = [file.name for file in work.glob("*refused*")]
    return Left(f"refused: {refused}" if refused else "", recorded, state)


def sum_up(file: Path) -> int:
    """Read a recording whole; the wall-clock time (ns) of its last message."""
    found = open_mcap(file)
    for message in found.messages("/drd/pose", "/raw/events", "/health"):
        message.value()
    return found.last_ns


class Bench:
    """A machine that is booted again and again with the same disk of 64 MB, in `work`."""

    def __init__(self, kernel: Kernel, root: Path, work: Path, seed: int):
        self.kernel, self._work, self._chance = kernel, work, random.Random(seed)
        # Only what is not on the second disk; it is the same at each boot.
        self._root = work / "prepared.ext4"
        image.run("cp", "--sparse=always", root, self._root)
        (own := work / "prepare").mkdir()
        machine = Machine(CUT, kernel, str(self._root), own)
        while machine.is_running():
            time.sleep(POLL_S)
        machine.close()
        self._volatile = work / "volatile"
        self._volatile.mkdir()
        disk = self._volatile / volatile_disk.DISK
        image.run("mke2fs", "-q", "-F", "-t", "ext4", "-b", volatile_disk.BLOCK_BYTES, disk, f"{cut.DISK_BYTES >> 10}k")
        self._before: dict[str, Any] | None = None

    def cut(self) -> dict[str, Any]:
        """Boot, cut the power at a random moment, examine; what happened."""
        shutil.rmtree(own := self._work / "machine", ignore_errors=True)
        own.mkdir()
        after = self._chance.choice(("start", "pose", "pose", "pose"))
        moment_s = self._chance.uniform(0.0, AFTER_START_S if after == "start" else AFTER_POSE_S)
        machine = Machine(CUT, self.kernel, f"{own}/changes,{self._root}", own, self._volatile)
        try:
            began_s = time.monotonic()
            while not self._has(machine, after):
                if not machine.is_running() or time.monotonic() - began_s > LIMIT_S:
                    said = (machine.out / "guest.log").read_text()
                    raise RuntimeError(f"it did not come to its {after}: {console_end(machine.out)}\n{said}")
                machine.step()
                time.sleep(POLL_S)
            reached_s = time.monotonic()
            while (now_s := time.monotonic()) - reached_s < moment_s:
                machine.step()
                time.sleep(POLL_S)
        finally:
            cut_wall_ns = time.time_ns()
            machine.close()
        found = {"after": after, "moment_s": round(moment_s, 3), "booted_s": round(now_s - began_s - moment_s, 1)}
        first = machine.out / cut.RESUMED
        pose = json.loads(first.read_text()) if first.exists() else None
        return found | self._look(poses_outside(machine.out), pose, cut_wall_ns)

    def _has(self, machine: Machine, what: str) -> bool:
        if what == "start":
            return (machine.out / cut.STARTED).exists()
        return bool(poses_outside(machine.out))

    def _look(self, poses: list[dict[str, Any]], first: dict[str, Any] | None, cut_ns: int) -> dict[str, Any]:
        """All disks that the cut may leave; one of them stays. `first`: the first pose inside."""
        unflushed = list(volatile_disk.writes(self._volatile / volatile_disk.UNFLUSHED))
        disks, left = [], []
        for i, share in enumerate(SHARES):
            disks.append(self._work / f"disk{i}")
            shutil.copy(self._volatile / volatile_disk.DISK, disks[-1])
            volatile_disk.apply(disks[-1], volatile_disk.some_of(iter(unflushed), share, self._chance))
            left.append(examine(disks[-1], self._work / "examined"))
        chosen = self._chance.randrange(len(disks))
        shutil.move(disks[chosen], self._volatile / volatile_disk.DISK)
        # Nothing was there to be lost before the first pose.
        first_ns = poses[0]["wall_ns"] if poses else cut_ns
        found = {
            "unflushed_writes": len(unflushed),
            "unflushed_bytes": sum(len(data) for _, data in unflushed),
            "disks": len(disks),
            "troubles": [one.trouble for one in left if one.trouble],
            "states": len({one.state_ns for one in left}),
            "recording_lost_s": [round((cut_ns - max(one.recorded_ns, first_ns)) * S_PER_NS, 3) for one in left],
            "state_lost_s": [round((cut_ns - max(one.state_ns, first_ns)) * S_PER_NS, 3) for one in left],
            "resumed": resumed(self._before, first) if self._before and first else None,
        }
        if poses or self._before is None:
            self._before = {"pose": poses[-1] if poses else None, "has_state": left[chosen].state_ns > 0}
        return found


def resumed(before: dict[str, Any], pose: dict[str, Any]) -> dict[str, Any]:
    """The first pose of a boot against the last before the cut: within its bound, or it says that it is not."""
    if before["pose"] is None or not before["has_state"]:
        return {"kind": "cold"}
    x_m, y_m = (pose[key] - before["pose"][key] for key in ("x_m", "y_m"))
    return {
        "kind": "warm",
        "jump_m": round((x_m**2 + y_m**2) ** 0.5, 3),
        "bound_m": round(pose["position_bound_99_m"] + before["pose"]["position_bound_99_m"], 3),
        "validity": pose["validity"],
    }


def is_kept(rows: list[dict[str, Any]], i: int) -> bool:
    """Whether cut `i` kept the promise. The pose goes on from the state: it lacks the way since that was written."""
    row, again = rows[i], rows[i]["resumed"] or {}
    unseen_s = next((s for before in rows[:i][::-1] if (s := max(before["state_lost_s"])) > 0), 0.0)
    return (
        not row["troubles"]
        and max(row["recording_lost_s"]) <= RECORDING_S
        and max(row["state_lost_s"]) <= STATE_S
        and again.get("jump_m", 0.0) <= min(again.get("bound_m", 0.0), SPEED_M_S * unseen_s + MARGIN_M)
    )


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Lines of Markdown: the sums, then each cut."""
    kept = sum(is_kept(rows, i) for i in range(len(rows)))
    yield f"{len(rows)} cuts, {sum(row['disks'] for row in rows)} disks examined; {kept} cuts as promised.\n"
    for key, promise_s in (("recording_lost_s", RECORDING_S), ("state_lost_s", STATE_S)):
        lost = sorted(s for row in rows for s in row[key])
        middle, most = statistics.median(lost), lost[-1]
        beyond = sum(s > promise_s for s in lost)
        yield f"{key}: median {middle:.2f}, most {most:.2f}, beyond {promise_s:g} s on {beyond} disks.\n"
    yield "| cut | s after | unflushed kB | disks | troubles | recording lost s | state lost s | pose again | kept |"
    yield "| ---: | --- | ---: | ---: | ---: | ---: | ---: | --- | --- |"
    for i, row in enumerate(rows, 1):
        again = row["resumed"] or {}
        pose = f"{again['jump_m']:.2f} of {again['bound_m']:.3g} m, {again['validity']}" if "jump_m" in again else ""
        cells = (
            *(i, f"{row['moment_s']:.2f} {row['after']}", f"{row['unflushed_bytes'] / 1000:.0f}", row["disks"]),
            *(len(row["troubles"]), max(row["recording_lost_s"]), max(row["state_lost_s"])),
            *(pose or again.get("kind", ""), "yes" if is_kept(rows, i - 1) else "NO"),
        )
        yield f"| {' | '.join(map(str, cells))} |"


def main() -> int:
    """Make the cuts that are missing; 1 where one did not keep the promise."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--cuts", type=int, default=200)
    parser.add_argument("--output", type=Path, default=image.CHECKOUT / "out" / "power-cut")
    arguments = parser.parse_args()
    if reason := image.missing():
        sys.exit(reason)
    arguments.output.mkdir(parents=True, exist_ok=True)
    log = arguments.output / "cuts.jsonl"
    rows = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    with tempfile.TemporaryDirectory(prefix="drd-cut-", dir=image.workshop()) as folder:
        if len(rows) < arguments.cuts:
            work = Path(folder)
            chosen, _ = kernel.choose(kernel.makers(work), work)
            bench = Bench(chosen, image.build(work, chosen.modules), work, seed=len(rows))
            with contextlib.suppress(PermissionError):
                os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
            bar = tqdm(total=arguments.cuts, initial=len(rows), desc="cuts")
            while len(rows) < arguments.cuts:
                rows.append(bench.cut())
                with log.open("a") as stream:
                    stream.write(json.dumps(rows[-1]) + "\n")
                (arguments.output / "cuts.md").write_text("\n".join(table(rows)) + "\n")
                bar.update()
    sys.stdout.write("\n".join(list(table(rows))[:3]) + "\n")
    return 0 if all(is_kept(rows, i) for i in range(len(rows))) else 1


if __name__ == "__main__":
    sys.exit(main())
