"""Diagnose cases blind, and record the findings with the answer."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from drd_tools.diagnose.analysis import Analysis, analyse
from drd_tools.diagnose.conclude import outcome
from drd_tools.diagnose.regression.refine import refine
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.trial import held_out, sbmi
from drd_tools.trial.baselines import baselines
from drd_tools.trial.ceiling import set_given
from drd_tools.trial.draw import make
from drd_tools.trial.overlay import Effects
from drd_tools.trial.plan import Drawing
from drd_tools.trial.results import FAILED, Answer, NotMade, Record, Row
from drd_tools.trial.size import selected_of
from drd_tools.trial.unknown import HIDDEN


class Others(NamedTuple):
    """Other methods: the `names` of regressions, and the file of SBMI's training, if it was trained."""

    names: Sequence[str] = ()
    trained: Path | None = None

    def selected(self, recording: Recording) -> dict[str, list[str]]:
        """Names that each method selects."""
        learned = {sbmi.METHOD: partial(sbmi.selected, file=self.trained)} if self.trained else {}
        return baselines(recording, self.names, learned)


NO_OTHERS: Final = Others()


def calls(
    folder: Path | None, answers: Sequence[Answer], drawn: Sequence[Drawing], others: Others, beside: int = 1
) -> list[Callable[[], Row]]:
    """Make a call for each case. `others`: other methods, which run on one in `beside` of the drawn cases."""
    made: list[Callable[[], Row]] = [] if folder is None else [partial(from_folder, folder, a, others) for a in answers]
    return [*made, *(partial(simulated, d, NO_OTHERS if d.number % beside else others) for d in drawn)]


def from_folder(folder: Path, answer: Answer, others: Others) -> Record:
    """Diagnose a recording on disk."""
    recording = read_recording(folder / answer.case)
    set_given(recording, answer.effects)
    record, _ = judged(recording, answer)
    record.kind, record.baselines = f"given {answer.kind}", others.selected(recording)
    return record


def simulated(drawing: Drawing, others: Others = NO_OTHERS) -> Row:
    """Simulate a case and diagnose it, if it can be made."""
    try:
        case = make(drawing)
    except ValueError as error:
        return NotMade(drawing.name, drawing.kind, str(error))
    record, result = judged(case.recording, case.answer, case.effects)
    record.baselines = others.selected(case.recording)
    if result is not None and (case.effects or result.conclusion.causes):
        try:
            record.held_out = held_out.judged(result, case.effects, case.again())
        except Exception as error:  # a model that cannot be applied is a result, too
            record.error = f"on another drive: {type(error).__name__}: {error}"
    return record


def judged(recording: Recording, answer: Answer, truth: Effects = ()) -> tuple[Record, Analysis | None]:
    """Diagnose a recording; return its record and the analysis, or None if it failed: that is a result, too."""
    began_s = time.perf_counter()
    about: dict[str, Any] = {name: getattr(answer, name) for name in Answer.__struct_fields__}
    try:
        result = analyse(recording)
    except Exception as error:
        return Record(**about, verdict=FAILED, findings=(), error=f"{type(error).__name__}: {error}"), None
    record = Record(
        **about,
        verdict=outcome.verdict(result.conclusion).value,
        findings=tuple(outcome.findings_of(result.conclusion)),
        noise=result.noise_ratios(),
        took_s=time.perf_counter() - began_s,
    )
    known = [effect.id for effect, _ in truth if effect.id not in HIDDEN]
    if known and sorted(f.effect for f in record.findings) != sorted(known):
        record.truth_nats = _truth_nats(result, truth)
    return record, result


def _truth_nats(result: Analysis, truth: Effects) -> float:
    """Score of the true effects, refined from their true values, minus that of the effects found."""
    found, selection = result.conclusion.found, selected_of(truth)
    # The search linearises both ways: around the nominal path, and around the one without the effects.
    problems = result.null_problem, found.problem.around(selection)
    scores = [-fit.cost - p.penalty(fit.selection) for p in problems for fit in [refine(p, selection)]]
    return max(scores) - found.score
