"""Diagnose cases blind, each in a process, and keep what was said beside the answer."""

import json
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from drd.schema import ConfigError
from drd_tools.diagnose import outcome
from drd_tools.diagnose.diagnose import Diagnosis, diagnose
from drd_tools.diagnose.problem import Claim
from drd_tools.diagnose.refine import refine
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.simulate.simulator import Effects
from drd_tools.trial.draw import Drawing, make

Record = dict[str, Any]
Answer = dict[str, Any]
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


def from_folder(folder: Path, answer: Answer) -> Record:
    """Diagnose a recording on disk."""
    kind = f"given {answer['kind']}"
    return {**answer, "kind": kind, **_said(read_recording(folder / answer["case"]))}


def simulated(drawing: Drawing) -> Record:
    """Simulate a case and diagnose it; one that cannot be made is said to be `not_made`."""
    try:
        case = make(drawing)
    except ValueError as error:
        return {"case": drawing.name, "kind": drawing.kind, "effects": [], "not_made": str(error)}
    return {**case.answer, **_said(case.simulated.recording, case.simulated.effects)}


def _said(recording: Recording, truth: Effects = ()) -> Record:
    began_s = time.perf_counter()
    try:
        result = diagnose(recording)
    except Exception as error:  # a diagnosis that fails is a result of the trial
        return {"verdict": "failed", "findings": [], "error": f"{type(error).__name__}: {error}"}
    problem, took_s = result.conclusion.found.problem, time.perf_counter() - began_s
    said = {
        "verdict": outcome.verdict(result.conclusion),
        "findings": [outcome.plain_finding(f, problem) for f in result.conclusion.findings],
        "noise": result.noise_ratios(),
        "took_s": took_s,
    }
    names = [f.effect for f in result.conclusion.findings]
    if truth and sorted(names) != sorted(effect.id for effect, _ in truth):
        said["truth_nats"] = _truth_nats(result, truth)
    return said


def _truth_nats(result: Diagnosis, truth: Effects) -> float:
    """Score of the true effects, refined from their true values, less that of what was found.

    Above 0 the search has missed the better answer; below, the evidence as it is weighed speaks for the wrong one.
    """
    found = result.conclusion.found
    claims = [
        Claim(effect, values, tuple(q.name for q in effect.parameters if not q.choices and not q.fixed))
        for effect, values in truth
    ]
    # Both ways in which the search looks at a claim: around the nominal path, and around that without the claims.
    problems = result.null_problem, found.problem.around(claims)
    scores = [-fit.cost - p.penalty(fit.claims) for p in problems for fit in [refine(p, claims)]]
    return max(scores) - found.score


def run(folder: Path | None, answers: Sequence[Answer], drawn: Sequence[Drawing], jobs: int) -> Iterator[Record]:
    """Records as they are ready."""
    calls: list[Callable[[], Record]] = []
    if folder is not None:
        calls += [partial(from_folder, folder, answer) for answer in answers]
    calls += [partial(simulated, drawing) for drawing in drawn]
    with tqdm(total=len(calls), desc="trial", unit="case", disable=None) as bar:
        for record in _each(calls, jobs):
            yield record
            bar.update()


def _each(calls: Sequence[Callable[[], Record]], jobs: int) -> Iterator[Record]:
    if jobs == 1:
        for call in calls:
            yield call()
        return
    # A forked child of a process with threads may lock up.
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        futures = [pool.submit(call) for call in calls]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)
