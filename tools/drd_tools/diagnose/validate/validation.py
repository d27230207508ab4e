"""Held-out validation of the model.

Held-out data must not contradict a term. A surrogate must reduce the errors of the poses.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from drd.effects.catalogue import catalogue
from drd.effects.model import Model, save_model
from drd_tools.diagnose.conclude.judgement import CONFIRMING_E
from drd_tools.diagnose.results import Figures, Finding, HeldOut, Status, Term, Validation
from drd_tools.diagnose.series import Bar
from drd_tools.diagnose.validate.held_out import CONTRADICTED_NATS, Prepared, held_out_nats
from drd_tools.diagnose.validate.trajectory import errors_of
from drd_tools.processes import Map

NEARER: Final = ("position_rms_m", "heading_rms_deg")
BORNE_OUT: Final = {Status.SUSPECTED: Status.SUPPORTED, Status.SUPPORTED: Status.CONFIRMED}
SURROGATE: Final = "stands in for an unidentified curve, being the effect nearest to it"


class Validated(NamedTuple):
    """The model, the findings with their held-out evidence, and the figures of the held-out recordings."""

    model: Model
    findings: list[Finding]
    figures: Validation
    poses_after: Sequence[Figures]
    bars: list[Bar]


def validate(
    file: Path,
    build: Callable[[Sequence[Term]], Model],
    terms: Sequence[Term],
    findings: Sequence[Finding],
    held_out: Sequence[Prepared],
    each: Map = map,
) -> Validated:
    """Save the model of the terms and surrogates, without terms that are only suspected, also in view of `held_out`.

    The findings receive their held-out evidence, and lose their surrogates unless every held-out recording improves.
    """
    nats = held_out_nats(build(terms).terms, held_out, each)
    findings = [_with_verdict(f, nats.get(f.effect)) for f in findings]
    accepted = _accepted(findings)

    before, recordings = [other.nominal for other in held_out], [other.measured.recording for other in held_out]

    def saved(more: Sequence[Term]) -> tuple[Model, list[Figures]]:
        model = build([*(t for t in terms if t.effect in accepted), *more])
        save_model(file, model)
        if not model.terms:
            return model, before
        return model, list(each(partial(errors_of, model=file), recordings))

    model, after = saved(())
    near = [msgspec.structs.replace(f.surrogate, provenance={"why": SURROGATE}) for f in findings if f.surrogate]
    if near and held_out:
        better, figures = saved(near)
        if _all_gain(after, figures):
            return _validated(better, findings, held_out, before, figures)
        save_model(file, model)
    findings = [msgspec.structs.replace(f, surrogate=None) for f in findings]
    return _validated(model, findings, held_out, before, after)


def _accepted(findings: Iterable[Finding]) -> set[str]:
    """Names that are more than suspected, and the linear terms up to which their forms are determined."""
    names = {f.effect for f in findings if f.is_named and f.status is not Status.SUSPECTED}
    return names | {beside.id for name in names if (beside := catalogue()[name].beside) is not None}


def _with_verdict(finding: Finding, worth: float | None) -> Finding:
    """Add the held-out evidence to a finding."""
    if worth is None:
        return finding
    if worth < CONTRADICTED_NATS:
        return msgspec.structs.replace(finding, held_out=HeldOut(worth, "against"), status=Status.SUSPECTED)
    status = BORNE_OUT.get(finding.status, finding.status) if worth >= math.log(CONFIRMING_E) else finding.status
    said = HeldOut(worth, "for" if worth > -CONTRADICTED_NATS else "neither")
    return msgspec.structs.replace(finding, held_out=said, status=status)


def _all_gain(without: Sequence[Figures], with_them: Sequence[Figures]) -> bool:
    pairs = zip(without, with_them, strict=True)
    return all(a and all((b[q] or 0.0) <= (a[q] or 0.0) for q in NEARER if q in a) for a, b in pairs)


def _validated(
    model: Model,
    findings: list[Finding],
    held_out: Sequence[Prepared],
    before: Sequence[Figures],
    after: Sequence[Figures],
) -> Validated:
    names, bars = [other.recording.name for other in held_out], []
    for name, first, second in zip(names, before, after, strict=True):
        for q in first:
            quantity, unit = q.rsplit("_", 1)
            unit = "%" if unit == "percent" else unit
            bars.append(Bar(name, quantity.replace("_", " "), unit, first[q], second[q]))
    figures = Validation(dict(zip(names, before, strict=True)), dict(zip(names, after, strict=True)))
    return Validated(model, findings, figures, after, bars)
