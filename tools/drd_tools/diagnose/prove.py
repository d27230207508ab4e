"""The model that is written, and what it is worth in recordings that it was not fitted to.

There a term must hold: the data must not speak against it. What only stands in for a curve must bring the poses nearer.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from drd.model import Model, save_model
from drd_tools.diagnose import outcome
from drd_tools.diagnose.conclude import CONFIRMING_E
from drd_tools.diagnose.elsewhere import CONTRADICTED_NATS, nats_elsewhere
from drd_tools.diagnose.finding import Status
from drd_tools.diagnose.heading_only import heading_figures
from drd_tools.recordings.folder import Recording

NEARER: Final = ("position_rms_m", "heading_rms_deg")
NO_POSES: Final = np.zeros((0, 10))
Content = dict[str, Any]
Figures = dict[str, float]


class Proof(NamedTuple):
    """The model that was saved, its figures as diagnosis.json has them, and their bars as series.json has them."""

    model: Model
    figures: Content
    bars: list[Content]


def judged(recording: Recording, model: Path | None) -> tuple[Figures, Any]:
    """Figures against the reference, with a model or without, and the poses (n, columns); none without wheels."""
    if recording.wheels is None:
        return heading_figures(recording, model), NO_POSES
    run_, rows = outcome.judged(recording, model)
    return outcome.figures(run_), rows


def save_proven(
    file: Path, make: Callable[[list[Content]], Model], findings: Sequence[Content], held_out: Sequence[Recording]
) -> Proof:
    """Save the model that `make` makes of its findings and of stand-ins, less what does not hold in `held_out`.

    The findings get what those recordings say of them, and lose the stand-ins by which not each of them gains.
    """

    def saved(stand_ins: list[Content]) -> tuple[Model, list[Figures]]:
        model = make(stand_ins)
        model = replace(model, terms=tuple(t for t in model.terms if t.effect.id not in refused))
        save_model(file, model)
        return model, [judged(other, file)[0] for other in held_out]

    refused = _refused(findings, nats_elsewhere(make([]).terms, held_out))
    before = [judged(other, None)[0] for other in held_out]
    stand_ins = [f["stand_in"] for f in findings if f.get("stand_in")]
    model, after = saved([])
    if stand_ins and held_out:
        better, figures = saved(stand_ins)
        if _all_gain(after, figures):
            return _proof(better, held_out, before, figures)
        save_model(file, model)
    for finding in findings:
        finding["stand_in"] = None
    return _proof(model, held_out, before, after)


def _refused(findings: Sequence[Content], nats: dict[str, float]) -> set[str]:
    """The effects that are left out; each finding is told what the held-out recordings say of it."""
    for finding in findings:
        if finding["effect"] not in nats:
            continue
        worth = nats[finding["effect"]]
        speak = "against" if worth < CONTRADICTED_NATS else "for" if worth > -CONTRADICTED_NATS else "neither"
        finding["held_out"] = {"nats": worth, "speaks": speak}
        if speak == "against":
            finding["status"] = Status.SUSPECTED.value
        elif worth >= math.log(CONFIRMING_E) and finding["status"] == Status.SUPPORTED.value:
            finding["status"] = Status.CONFIRMED.value
    return {effect for effect, worth in nats.items() if worth < CONTRADICTED_NATS}


def _all_gain(without: Sequence[Figures], with_them: Sequence[Figures]) -> bool:
    pairs = zip(without, with_them, strict=True)
    return all(a and all(b[q] <= a[q] for q in NEARER if q in a) for a, b in pairs)


def _proof(model: Model, held_out: Sequence[Recording], before: list[Figures], after: list[Figures]) -> Proof:
    names = [other.name for other in held_out]
    bars = []
    for name, first, second in zip(names, before, after, strict=True):
        for q in first:
            quantity, unit = q.rsplit("_", 1)
            unit = "%" if unit == "percent" else unit
            bars.append({"name": name, "quantity": quantity.replace("_", " "), "unit": unit,
                         "before": first[q], "after": second[q]})  # fmt: skip
    figures = {"before": dict(zip(names, before, strict=True)), "after": dict(zip(names, after, strict=True))}
    return Proof(model, figures, bars)
