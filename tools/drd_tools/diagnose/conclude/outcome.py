"""Results of the conclusion: verdict, findings, model, and the series to be drawn."""

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from msgspec import UNSET, UnsetType

from drd.arrays import Array
from drd.effects.model import Model, make_model
from drd.effects.motion import Motion
from drd_tools.diagnose.conclude.cause import Cause
from drd_tools.diagnose.conclude.conclusion import Conclusion
from drd_tools.diagnose.conclude.confirm import rms_per_block
from drd_tools.diagnose.conclude.scatter import is_loud
from drd_tools.diagnose.error_model.ranges import seen
from drd_tools.diagnose.files import plain
from drd_tools.diagnose.observe.parts import with_whole
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.results import Amount, Finding, Term, Verdict
from drd_tools.diagnose.select.orders import Ripple
from drd_tools.diagnose.select.splines import PLACE
from drd_tools.diagnose.selected import SCALE, Selected
from drd_tools.diagnose.series import Course, Mismatch, Residual
from drd_tools.recordings.folder import Recording

WHOLE_SHARE: Final = 0.1  # of the mismatch: at most this much may remain in an explained one
BAND_SIGMAS: Final = 1.96  # 95 % of a Gaussian


def verdict(conclusion: Conclusion) -> Verdict:
    """The verdict of a conclusion. Noise far above its stated size may hide physics, too."""
    causes = conclusion.causes
    loud = is_loud(conclusion.found.problem)
    if not causes:
        return Verdict.PARTLY if loud else Verdict.NOTHING
    if all(c.selected is None for c in causes):
        return Verdict.UNKNOWN
    has_unnamed = any(c.selected is None for c in causes)
    return Verdict.PARTLY if has_unnamed or loud or conclusion.unexplained > WHOLE_SHARE else Verdict.EXPLAINED


def term_of(m: Motion, selected: Selected) -> Term:
    """An effect with its parameters in the catalogue's units, and the range of its covariate along a motion."""
    amounts, choices = parameters_of(selected)
    return Term(effect=selected.id, parameters=amounts, choices=choices, seen=seen(m, selected))


def parameters_of(selected: Selected) -> tuple[dict[str, Amount], dict[str, str]]:
    """Numerical parameters of an effect, in the catalogue's units, and its choices."""
    effect = selected.effect
    absorbed = effect.absorbed(selected.values, selected.number(SCALE.name)) if SCALE.name in selected.values else None
    values = selected.values if absorbed is None else absorbed
    amounts = {
        q.name: Amount(float(values[q.name]) / q.si, selected.sigma(q.name) / q.si, q.unit)
        for q in effect.parameters
        if not q.choices
    }
    return amounts, {q.name: str(values[q.name]) for q in effect.parameters if q.choices}


def terms_found(findings: Sequence[Finding]) -> list[Term]:
    """The named findings as a model's effects, each with the linear term up to which its form is determined."""
    named = [f for f in findings if f.is_named]
    terms = [
        Term(
            effect=f.effect,
            parameters=f.parameters,
            choices=f.choices,
            seen=f.seen,
            provenance={"recording": with_whole(f.recording)} if f.recording else {},
        )
        for f in named
    ]
    return terms + [f.beside for f in named if f.beside and f.beside.effect not in names_of(named)]


def _beside(selected: Selected) -> Term | UnsetType:
    """The linear term that was fitted together with an effect, if any."""
    if (effect := selected.beside) is None:
        return UNSET
    (q,) = effect.parameters
    amount = Amount(selected.number(SCALE.name) / q.si, selected.sigma(SCALE.name) / q.si, q.unit)
    why = f"linear term fitted together with {selected.id}"
    return Term(effect=effect.id, parameters={q.name: amount}, provenance={"why": why})


def model_of(terms: Iterable[Term], recording: Recording, names: str, version: str) -> Model:
    """The nominal robot with these effects. `names`: of the recordings in which they were found."""
    nominal = recording.nominal
    wheel: dict[str, Any] = {"radius_m": nominal.wheel_radius_m}
    if nominal.counts_per_revolution is not None:
        wheel["counts_per_revolution"] = nominal.counts_per_revolution
    robot = {} if recording.wheels is None else {"wheel": wheel, "tread_m": nominal.tread_m}
    sha = recording.sha256.get("encoders.csv") or next(iter(recording.sha256.values()), "")
    return make_model([plain(t) for t in terms], robot, recording=names, tool=f"drd diagnose {version}", sha256=sha)


def finding_of(cause: Cause, problem: Problem) -> Finding:
    """The finding that reports a cause."""
    motion, time_s = problem.sensitivities.motion, problem.evidence.time_s
    amounts, choices = _periodic(cause.ripple) if cause.selected is None else parameters_of(cause.selected)
    return Finding(
        effect=cause.effect,
        status=cause.status,
        also_fits=cause.also_fits,
        acts_on=cause.acts_on,
        parameters=amounts,
        choices=choices,
        windows=cause.windows or ((float(time_s[0]), float(time_s[-1])),),
        seen={} if cause.selected is None else seen(motion, cause.selected),
        covariate=cause.covariate,
        evidence=cause.support,
        explains=cause.explains,
        beside=UNSET if cause.selected is None else _beside(cause.selected),
        surrogate=None if cause.surrogate is None else term_of(motion, cause.surrogate),
        sentence=cause.sentence,
        probabilities=cause.probabilities,
    )


def _periodic(ripple: Ripple | None) -> tuple[dict[str, Amount], dict[str, str]]:
    """Side, order and amplitude of a cause that repeats with a wheel's angle; empty for other unnamed causes."""
    if ripple is None:
        return {}, {}
    amounts = {
        "order": Amount(ripple.order, ripple.sigma_order, "1"),
        "amplitude": Amount(ripple.amplitude, ripple.sigma, "1"),
    }
    return amounts, {"side": ripple.side}


def findings_of(conclusion: Conclusion) -> list[Finding]:
    """All causes as findings, the largest share first."""
    return [finding_of(cause, conclusion.found.problem) for cause in conclusion.causes]


def course_of(cause: Cause) -> Course:
    """Series to be drawn for a cause."""
    if cause.ripple is not None:
        return Course(cause.effect, _folded(cause.ripple), cause.gain)
    curve, fitted, nothing = cause.curve, cause.fitted, np.zeros(0)
    if curve is None:
        return Course(cause.effect, None, cause.gain)
    x, y = curve.knots.T if curve.covariate == PLACE else (curve.knots, nothing)
    fit_x, fit, band = nothing, nothing, nothing
    if fitted is not None and cause.selected is not None:
        fit_x, fit, band = x, fitted, BAND_SIGMAS * _relative_sigma(cause.selected) * np.abs(fitted)
    mismatch = Mismatch(
        covariate=curve.covariate,
        covariate_unit=curve.covariate_unit,
        error_unit=curve.unit,
        channel=curve.channel,
        x=x,
        mismatch=curve.value,
        sigma=curve.sigma,
        fit_x=fit_x,
        fit=fit,
        low=fit - band,
        high=fit + band,
        y=y,
    )
    return Course(cause.effect, mismatch, cause.gain)


def _folded(ripple: Ripple) -> Mismatch:
    """The error over a period, and the fitted ripple."""
    phase_rad, error, sigma = ripple.folded
    fit_rad = np.linspace(0.0, 2.0 * np.pi, 73)
    fit, band = ripple.amplitude * np.cos(fit_rad + ripple.phase), BAND_SIGMAS * ripple.sigma
    return Mismatch(
        covariate=f"{ripple.order:.4g}_times_the_{ripple.side}_wheel_angle",
        covariate_unit="deg",
        error_unit="%",
        channel=f"{ripple.side} wheel",
        x=np.degrees(phase_rad),
        mismatch=100.0 * error,
        sigma=100.0 * sigma,
        fit_x=np.degrees(fit_rad),
        fit=100.0 * fit,
        low=100.0 * (fit - band),
        high=100.0 * (fit + band),
    )


def _relative_sigma(selected: Selected) -> float:
    shares = [
        selected.sigma(n) / abs(selected.number(n))
        for n in selected.effect.linear()
        if n in selected.free and selected.number(n)
    ]
    return min(1.0, min(shares, default=0.0))


def residual_of(null: Array, null_problem: Problem, conclusion: Conclusion) -> Residual:
    """Rms of the whitened data per block, without and with the effects."""
    time_s, before = rms_per_block(null_problem, null)
    _, after = rms_per_block(conclusion.found.problem, conclusion.found.fit.left)
    return Residual(time_s, before, after)


def names_of(findings: Iterable[Finding]) -> set[str]:
    """The effects that were found."""
    return {f.effect for f in findings}
