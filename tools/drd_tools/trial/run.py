"""Diagnose cases blind, each in a process, and keep what was said beside the answer."""

import json
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from drd.config.schema import ConfigError
from drd_tools.diagnose.analysis import Analysis, analyse
from drd_tools.diagnose.conclude import outcome
from drd_tools.diagnose.files import plain
from drd_tools.diagnose.regression.refine import refine
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.trial import held_out
from drd_tools.trial.baselines import baselines
from drd_tools.trial.draw import make
from drd_tools.trial.overlay import Effects
from drd_tools.trial.plan import Drawing
from drd_tools.trial.size import selected_of
from drd_tools.trial.unknown import HIDDEN

Record = dict[str, Any]
Answer = dict[str, Any]
Call = Callable[[], Record]
ANSWERS = "answers.json"


def read_answers(folder: Path) -> list[Answer]:
    """answers.json of a folder of recordings. Raises ConfigError."""
    file = folder / ANSWERS
    try:
        answers = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(str(file), "", "a JSON file with the answers", str(error)) from error
    if not isinstance(answers, list) or not all(
        isinstance(a, dict) and {"case", "kind", "effects"} <= a.keys() for a in answers
    ):
        raise ConfigError(str(file), "", "a list of objects with case, kind and effects", "something else")
    return answers


def from_folder(folder: Path, answer: Answer, names: Sequence[str]) -> Record:
    """Diagnose a recording on disk. `names`: of the other methods."""
    recording = read_recording(folder / answer["case"])
    said, _ = _said(recording)
    return {**answer, "kind": f"given {answer['kind']}", **said, "baselines": baselines(recording, names)}


def simulated(drawing: Drawing, names: Sequence[str]) -> Record:
    """Simulate a case and diagnose it; one that cannot be made is said to be `not_made`."""
    try:
        case = make(drawing)
    except ValueError as error:
        return {"case": drawing.name, "kind": drawing.kind, "effects": [], "not_made": str(error)}
    said, result = _said(case.recording, case.effects)
    record = {**case.answer, **said, "baselines": baselines(case.recording, names)}
    if result is not None and (case.effects or result.conclusion.causes):
        try:
            record["held_out"] = held_out.judged(result, case.effects, case.again())
        except Exception as error:  # so is a model that cannot be applied
            record["error"] = f"on another drive: {type(error).__name__}: {error}"
    return record


def _said(recording: Recording, truth: Effects = ()) -> tuple[Record, Analysis | None]:
    began_s = time.perf_counter()
    try:
        result = analyse(recording)
    except Exception as error:  # a diagnosis that fails is a result of the trial
        return {"verdict": "failed", "findings": [], "error": f"{type(error).__name__}: {error}"}, None
    took_s = time.perf_counter() - began_s
    said = {
        "verdict": outcome.verdict(result.conclusion).value,
        "findings": plain(outcome.findings_of(result.conclusion)),
        "noise": result.noise_ratios(),
        "took_s": took_s,
    }
    names = [c.effect for c in result.conclusion.causes]
    known = [effect.id for effect, _ in truth if effect.id not in HIDDEN]
    if known and sorted(names) != sorted(known):
        said["truth_nats"] = _truth_nats(result, truth)
    return said, result


def _truth_nats(result: Analysis, truth: Effects) -> float:
    """Score of the true effects, refined from their true values, less that of what was found.

    Above 0 the search has missed the better answer; below, the evidence as it is weighed speaks for the wrong one.
    """
    found, selection = result.conclusion.found, selected_of(truth)
    # Both ways in which the search looks at an effect: around the nominal path, and around that without the effects.
    problems = result.null_problem, found.problem.around(selection)
    scores = [-fit.cost - p.penalty(fit.selection) for p in problems for fit in [refine(p, selection)]]
    return max(scores) - found.score


def calls(
    folder: Path | None, answers: Sequence[Answer], drawn: Sequence[Drawing], names: Sequence[str], beside: int = 1
) -> list[Call]:
    """What is to be done, a call for each case. `names`: of other methods, for one in `beside` of those drawn."""
    made: list[Call] = []
    if folder is not None:
        made += [partial(from_folder, folder, answer, names) for answer in answers]
    return [*made, *(partial(simulated, d, () if d.number % beside else names) for d in drawn)]


def run(todo: Sequence[Call], jobs: int) -> Iterator[Record]:
    """Records as they are ready."""
    with tqdm(total=len(todo), desc="trial", unit="case", disable=None) as bar:
        for record in _each(todo, jobs):
            yield record
            bar.update()


def _each(todo: Sequence[Call], jobs: int) -> Iterator[Record]:
    if jobs == 1:
        for call in todo:
            yield call()
        return
    # The processes share the cores; a library that takes all of them for one product only gets in the others' way.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # A forked child of a process with threads may lock up.
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        futures = [pool.submit(call) for call in todo]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)
