"""From what the regression concluded to what is said: verdict, findings, model, and the series that are drawn."""

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from drd.effects.motion import Motion
from drd.model import Model, make_model
from drd_tools.diagnose.claim import SCALE, Claim
from drd_tools.diagnose.conclude import Conclusion
from drd_tools.diagnose.confirm import rms_per_block
from drd_tools.diagnose.files import plain
from drd_tools.diagnose.finding import Cause
from drd_tools.diagnose.problem import Array, Problem
from drd_tools.diagnose.ranges import seen
from drd_tools.diagnose.results import Amount, Course, Finding, Mismatch, Residual, Term, Verdict
from drd_tools.recordings.folder import Recording

WHOLE_SHARE: Final = 0.1  # of the mismatch: so little may be left of what is called explained
BAND_SIGMAS: Final = 1.96


def verdict(conclusion: Conclusion) -> Verdict:
    """One of the four words."""
    causes = conclusion.causes
    if not causes:
        return Verdict.NOTHING
    if all(c.claim is None for c in causes):
        return Verdict.UNKNOWN
    if any(c.claim is None for c in causes) or conclusion.unexplained > WHOLE_SHARE:
        return Verdict.PARTLY
    return Verdict.EXPLAINED


def term_of(m: Motion, claim: Claim) -> Term:
    """An effect with its parameters in the catalogue's units, and where its covariate was along a motion."""
    amounts, choices = parameters_of(claim)
    return Term(effect=claim.id, parameters=amounts, choices=choices, seen=seen(m, claim))


def parameters_of(claim: Claim) -> tuple[dict[str, Amount], dict[str, str]]:
    """Its numbers, in the catalogue's units, and its words."""
    effect = claim.effect
    absorbed = effect.absorbed(claim.values, claim.number(SCALE.name)) if SCALE.name in claim.values else None
    values = claim.values if absorbed is None else absorbed
    amounts = {
        q.name: Amount(float(values[q.name]) / q.si, claim.sigma(q.name) / q.si, q.unit)
        for q in effect.parameters
        if not q.choices
    }
    return amounts, {q.name: str(values[q.name]) for q in effect.parameters if q.choices}


def terms_of(conclusion: Conclusion) -> list[Term]:
    """The findings as a model's effects, each with the effect beside which alone its form is known."""
    motion, made = conclusion.found.problem.signatures.motion, []
    for claim in (c.claim for c in conclusion.causes if c.claim is not None):
        made.append(term_of(motion, claim))
        beside = claim.effect.beside
        if beside and SCALE.name in claim.values and claim.effect.absorbed(claim.values, 0.0) is None:
            (q,) = beside.parameters
            amount = Amount(claim.number(SCALE.name) / q.si, claim.sigma(SCALE.name) / q.si, q.unit)
            why = f"the straight line beside {claim.id}"
            made.append(Term(effect=beside.id, parameters={q.name: amount}, why=why))
    return made


def terms_found(findings: Iterable[Finding]) -> list[Term]:
    """The findings that have a name, as a model's effects."""
    return [
        Term(effect=f.effect, parameters=f.parameters, choices=f.choices, seen=f.seen) for f in findings if f.is_named
    ]


def model_of(terms: Iterable[Term], recording: Recording, names: str, version: str) -> Model:
    """The nominal robot with these effects. `names`: of the recordings in which they were found."""
    nominal = recording.nominal
    wheel: dict[str, Any] = {"radius_m": nominal.wheel.radius_m}
    if nominal.wheel.counts_per_revolution is not None:
        wheel["counts_per_revolution"] = nominal.wheel.counts_per_revolution
    robot = {} if recording.wheels is None else {"wheel": wheel, "tread_m": nominal.tread_m}
    sha = recording.sha256.get("encoders.csv") or next(iter(recording.sha256.values()), "")
    effects = [plain(t) | ({"provenance": {"why": t.why}} if t.why else {}) for t in terms]
    return make_model(effects, robot, recording=names, tool=f"drd diagnose {version}", sha256=sha)


def finding_of(cause: Cause, problem: Problem) -> Finding:
    """As it is reported."""
    motion, time_s = problem.signatures.motion, problem.evidence.time_s
    amounts, choices = ({}, {}) if cause.claim is None else parameters_of(cause.claim)
    return Finding(
        effect=cause.effect,
        status=cause.status,
        also_fits=cause.also_fits,
        acts_on=cause.acts_on,
        parameters=amounts,
        choices=choices,
        windows=cause.windows or ((float(time_s[0]), float(time_s[-1])),),
        seen={} if cause.claim is None else seen(motion, cause.claim),
        covariate=cause.driver,
        evidence=cause.support,
        explains=cause.explains,
        surrogate=None if cause.surrogate is None else term_of(motion, cause.surrogate),
        sentence=cause.sentence,
        probability=cause.probability,
    )


def findings_of(conclusion: Conclusion) -> list[Finding]:
    """All causes as they are reported, the best first."""
    return [finding_of(cause, conclusion.found.problem) for cause in conclusion.causes]


def course_of(cause: Cause) -> Course:
    """What is drawn of a cause."""
    curve, fitted, nothing = cause.curve, cause.fitted, np.zeros(0)
    if curve is None:
        return Course(cause.effect, None, cause.gain)
    x, fit, band = nothing, nothing, nothing
    if fitted is not None and cause.claim is not None:
        x, fit, band = curve.knots, fitted, BAND_SIGMAS * _relative_sigma(cause.claim) * np.abs(fitted)
    mismatch = Mismatch(
        curve.driver, curve.driver_unit, curve.unit, curve.channel, curve.knots, curve.value, curve.sigma,
        x, fit, fit - band, fit + band,
    )  # fmt: skip
    return Course(cause.effect, mismatch, cause.gain)


def _relative_sigma(claim: Claim) -> float:
    shares = [
        claim.sigma(n) / abs(claim.number(n)) for n in claim.effect.linear() if n in claim.free and claim.number(n)
    ]
    return min(1.0, min(shares, default=0.0))


def residual_of(null: Array, null_problem: Problem, conclusion: Conclusion) -> Residual:
    """Rms of the whitened data per block, before and after."""
    time_s, before = rms_per_block(null_problem, null)
    _, after = rms_per_block(conclusion.found.problem, conclusion.found.fit.left)
    return Residual(time_s, before, after)


def names_of(findings: Sequence[Finding]) -> set[str]:
    """The effects that were found."""
    return {f.effect for f in findings}
