"""Hours of fuzzing: all targets in rounds, a corpus that is kept small, findings collected, figures that add up."""

import hashlib
import json
import os
import re
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from tqdm import tqdm

from drd_tools.report.terminal import columns

Target = Callable[[bytes], None]
HERE: Final = Path(__file__).resolve().parent
# A turn: long beside starting and merging (some seconds), short beside an hour, so that each target has many.
TURN_S: Final = 120.0
NO_FIGURES: Final = {"executions": 0, "seconds": 0.0, "edges": 0, "crashes": 0, "turns": 0}


def collecting(target: Target, folder: Path | None) -> Target:
    """The target, which goes on after an exception: the first input of each place is left in `folder`, if there is one.

    A place: the exception's type, and the line that raised it.
    """
    seen: set[str] = set()

    def collect(data: bytes) -> None:
        try:
            target(data)
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{type(error).__name__} {Path(last.filename).name}:{last.lineno}"
            if folder is not None and place not in seen:
                file = folder / f"raised-{hashlib.sha256(place.encode()).hexdigest()[:12]}"
                if not file.exists():
                    file.write_bytes(data)
                    file.with_suffix(".txt").write_text("".join(traceback.format_exception(error)), encoding="utf-8")
            seen.add(place)

    return collect


class Campaign:
    """In `folder`: TARGET/corpus, TARGET/findings, TARGET/log and figures.json, from which a later one goes on.

    `fuzz` is run.fuzz, which does not return.
    """

    def __init__(self, folder: Path, targets: Mapping[str, Target], fuzz: Callable[..., None]):
        self._folder, self._targets, self._fuzz = folder.absolute(), targets, fuzz
        self._file = self._folder / "figures.json"
        self.figures: dict[str, dict[str, Any]] = {}
        if self._file.exists():
            self.figures = json.loads(self._file.read_text(encoding="utf-8"))
        for name in targets:
            self.figures.setdefault(name, dict(NO_FIGURES))
            for kind in ("corpus", "findings"):
                (self._folder / name / kind).mkdir(parents=True, exist_ok=True)

    def run(self, hours: float, workers: int) -> int:
        """Until the time is over; prints a table. Returns 1 where there are findings, of this or an earlier run."""
        budget_s = 3600.0 * hours
        turn_s = max(1.0, min(TURN_S, budget_s * workers / len(self._targets)))
        rounds = max(1, round(budget_s * workers / (turn_s * len(self._targets))))
        running: dict[int, str] = {}
        with tqdm(total=rounds * len(self._targets), desc="fuzz", unit="turn", disable=None) as bar:
            for name in [*self._targets] * rounds:
                while len(running) >= workers:
                    self._end_one(running, bar)
                running[self._begin(name, turn_s)] = name
            while running:
                self._end_one(running, bar)
        print(self.table())  # noqa: T201 - what it is for
        return int(any(self.findings(name) for name in self._targets))

    def findings(self, name: str) -> list[Path]:
        """Inputs that raised, crashed, hung or took too much memory."""
        return sorted(file for file in (self._folder / name / "findings").iterdir() if file.suffix != ".txt")

    def table(self) -> str:
        """By target, and in all."""
        rows = [("target", "executions", "hours", "exec/s", "edges", "corpus", "findings")]
        found = 0
        for name, f in self.figures.items():
            found += (count := len(self.findings(name)))
            files = sum(1 for _ in (self._folder / name / "corpus").iterdir())
            rate = f["executions"] / max(f["seconds"], 1e-9)
            rows.append((name, f"{f['executions']:,}", f"{f['seconds'] / 3600:.2f}", f"{rate:.0f}",
                         str(f["edges"]), str(files), str(count)))  # fmt: skip
        executions, seconds = (sum(f[key] for f in self.figures.values()) for key in ("executions", "seconds"))
        rows.append(("all", f"{executions:,}", f"{seconds / 3600:.2f}", f"{executions / max(seconds, 1e-9):.0f}",
                     "", "", str(found)))  # fmt: skip
        return "\n".join(columns(rows, text=(0,)))

    def _begin(self, name: str, turn_s: float) -> int:
        """Start a target's turn; the process's number."""
        f = self.figures[name]
        f["turns"] += 1
        child = os.fork()  # the watched modules are loaded once for all
        if child:
            return child
        code = 70
        try:
            log = os.open(self._folder / name / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(log, 2)
            os.dup2(log, 1)
            code = self._turn(name, round(turn_s), f["turns"])
        finally:
            os._exit(code & 0xFF)

    def _turn(self, name: str, seconds: int, seed: int) -> int:
        """Fuzz, then keep of the corpus what reaches something; libFuzzer ends its process, hence one for each."""
        folder = self._folder / name
        target = collecting(self._targets[name], folder / "findings")
        seeds, own, new = str(HERE / "corpus" / name), folder / "corpus", folder / "merged"
        bounds = [f"-artifact_prefix={folder}/findings/", f"-max_total_time={seconds}", f"-seed={seed}"]
        code = _in_fork(lambda: self._fuzz(name, target, [*bounds, str(own), seeds]))
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir()
        program = folder / "again"
        program.write_text(f'#!/bin/sh\nexec {sys.executable} {HERE}/run.py {name} --inner "$@"\n', encoding="utf-8")
        program.chmod(0o755)
        merge = [f"-artifact_prefix={folder}/findings/", "-merge=1", str(new), str(own), seeds]
        if _in_fork(lambda: self._fuzz(name, target, merge, str(program))) == 0 and any(new.iterdir()):
            shutil.rmtree(own)
            new.rename(own)
        return code

    def _end_one(self, running: dict[int, str], bar: Any) -> None:
        """Wait for a turn's end and add up what it did."""
        child, status = os.wait()
        name = running.pop(child)
        f, log = self.figures[name], (self._folder / name / "log").read_text(encoding="utf-8", errors="replace")
        done = re.search(r"stat::number_of_executed_units: (\d+)", log)
        counts = re.findall(r"^#(\d+)\t", log.partition("MERGE-OUTER")[0], re.M)
        executions = int(done[1]) if done else int(counts[-1]) if counts else 0
        rate = re.search(r"stat::average_exec_per_sec: +(\d+)", log)
        f["executions"] += executions
        f["seconds"] += executions / int(rate[1]) if rate and int(rate[1]) else TURN_S
        f["edges"] = max([f["edges"], *map(int, re.findall(r" cov: (\d+)", log))])
        f["crashes"] += os.waitstatus_to_exitcode(status) != 0
        f["ended"] = round(time.time())
        new = self._file.with_suffix(".new")
        new.write_text(json.dumps(self.figures, indent=1) + "\n", encoding="utf-8")
        new.replace(self._file)
        bar.update()
        bar.set_postfix_str(f"{sum(f['executions'] for f in self.figures.values()):.2e} executions")


def _in_fork(work: Callable[[], object]) -> int:
    """The exit code of `work` in a process of its own."""
    child = os.fork()
    if not child:
        try:
            work()
        finally:
            os._exit(71)  # libFuzzer ends the process itself
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
