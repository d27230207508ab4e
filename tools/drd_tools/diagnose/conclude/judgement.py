"""Judgement of one effect: its status, its rivals, and its windows of time."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.conclude.cause import Cause, sentence
from drd_tools.diagnose.conclude.confirm import (
    LARGEST_NATS,
    OtherHalf,
    chance_gains,
    e_value,
    family_wise_p,
    gain_over_time,
)
from drd_tools.diagnose.conclude.identify import APART_NATS
from drd_tools.diagnose.conclude.reference import BARELY
from drd_tools.diagnose.conclude.rivals import Near, posterior, rivals_of
from drd_tools.diagnose.observe.events import Event
from drd_tools.diagnose.regression.noise_fit import ratios
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.results import NOTHING, UNNAMED, Status, Support, Window
from drd_tools.diagnose.select.orders import Ripple
from drd_tools.diagnose.select.search import Found, Search
from drd_tools.diagnose.select.splines import CHANNELS, PLACE, Curve, SplineTerms
from drd_tools.diagnose.selected import Selected
from drd_tools.diagnose.series import Gain

# An unnamed curve must not be the mere remainder of a name's imperfect form.
GENERIC_SHARE: Final = 0.01  # margin, of the names' worth
UNLIKE_SHARE: Final = 0.25  # the same if the world is unlike the model, so that no name has the exact form
UNLIKE_NOISE: Final = 1.5  # times the stated noise: beyond, the world is unlike the model
GENERIC_NATS: Final = 5.0  # least margin of an unnamed curve over a name: found by the trial
FAMILY_WISE: Final = 0.05  # the usual 5 %, over the whole catalogue
CONFIRMING_E: Final = 100.0  # 100 to 1 in data that the fit has not seen: decisive (Jeffreys 1961)


def margin(problem: Problem, worth: float) -> float:
    """Nats by which an unnamed curve must beat names of that worth."""
    slip = ratios(problem).get("slip") or 0.0
    is_unlike = problem.evidence.is_far or slip > UNLIKE_NOISE
    return max(GENERIC_NATS, (UNLIKE_SHARE if is_unlike else GENERIC_SHARE) * worth)


def status_of(p: float, e: float, nothing: float = 0.0) -> Status:
    """Status of a finding with family-wise probability p by chance and e-value e on unseen data; `nothing`: the
    probability that there is no effect.
    """
    if p > FAMILY_WISE or 1.0 - nothing < BARELY * nothing:
        return Status.SUSPECTED
    return Status.CONFIRMED if e >= CONFIRMING_E else Status.SUPPORTED


def holds(problem: Problem, unseen: tuple[float, float]) -> bool:
    """Whether neither half of the data contradicts it: real ground causes effects that only one half shows."""
    return not problem.evidence.is_far or min(unseen) > -APART_NATS


def judge(
    found: Found,
    search: Search,
    splines: SplineTerms,
    test: OtherHalf,
    reported: Selected,
    near: Sequence[Near],
    chance: Array,
    explains: float,
    is_constant: bool,
) -> Cause:
    """Judge a selected effect, as `reported`, or replace it by an unnamed curve if that is better."""
    problem, fit, selected = found.problem, found.fit, test.selected
    others = [c for c in fit.selection if c is not selected]
    rest = refine(problem, others)
    worth = rest.cost - fit.cost
    e = e_value(test.nats)
    # A constant was tested alone, before all other effects.
    by_chance = chance_gains(problem, search.library, fit.left, selected.id) if is_constant else chance
    p = family_wise_p(worth, by_chance)
    rivals = rivals_of(found, search, selected, rest, near)
    rival = splines.best(fit.selection, selected)
    # A calibrated constant is never replaced by a curve, however it varies.
    unnamed = None if is_constant or rival is None else _unnamed_nats(found, test, rival, worth, splines, rivals.own)
    probabilities = rivals.probabilities(unnamed)
    if rival is not None and unnamed is not None and unnamed > rivals.own:
        surrogate = reported if selected.effect.lasting and e >= CONFIRMING_E else None
        also = (selected, *rivals.alike)
        return judge_curve(rival, p, explains, surrogate, also, e, probabilities)
    curve = _curve(splines, found, selected, rival)
    return Cause(
        selected=reported,
        status=status_of(p, e, probabilities.get(NOTHING, 0.0)),
        rivals=rivals.alike,
        windows=_windows(selected, problem.evidence.time_s),
        support=Support(worth, p, e),
        explains=explains,
        sentence=sentence(reported, explains, [r.id for r in rivals.alike]),
        probabilities=probabilities,
        curve=curve,
        gain=Gain(*gain_over_time(problem, fit, selected)),
        fitted=None if curve is None else splines.reported(selected, others, curve),
    )


def _unnamed_nats(found: Found, test: OtherHalf, rival: Curve, worth: float, splines: SplineTerms, own: float) -> float:
    """Nats of an unnamed curve, less its required margin over an effect of that worth; `own`: the effect's nats."""
    problem = found.problem
    nats = rival.gain - margin(problem, worth)
    if problem.evidence.is_far:
        # If the world is unlike the model, some curve always fits better: it must also predict both halves better.
        unseen = test.curve_nats(splines.columns(rival))
        nats = min(nats, *(own + u - n for u, n in zip(unseen, test.nats, strict=True)))
    # The others, refitted without the effect, may take its part; beside the curve they are held.
    return nats - max(splines.nats_of_name(found.fit.selection, test.selected) - worth, 0.0)


def _curve(splines: SplineTerms, found: Found, selected: Selected, rival: Curve | None) -> Curve | None:
    """The mismatch that an effect explains, as a curve of the effect's own covariate if there is one."""
    options = [
        splines.best(found.fit.selection, selected, (channel, selected.effect.covariate))
        for channel, where in CHANNELS.items()
        if where.acts_on == selected.effect.channel
    ]
    curves = [c for c in options if c is not None]
    return max(curves, key=lambda c: c.gain, default=rival)


def judge_event(selected: Selected, event: Event, explains: float) -> Cause:
    """Judge an effect that the readings show by logic."""
    e = math.exp(min(event.nats, LARGEST_NATS))
    p = max(min(1.0, len(catalogue()) / e), 1e-6)
    text = f"{selected.effect.sentence} Observed: {event.seen}."
    support = Support(float(event.nats), p, e)
    return Cause(
        selected=selected,
        status=Status.CONFIRMED,
        rivals=(),
        windows=event.windows,
        support=support,
        explains=explains,
        sentence=text,
        probabilities=posterior({selected.id: event.nats, NOTHING: 0.0}),
    )


def judge_curve(
    curve: Curve,
    p: float,
    explains: float,
    surrogate: Selected | None = None,
    rivals: tuple[Selected, ...] = (),
    e: float = 1.0,
    probabilities: dict[str, float] | None = None,
) -> Cause:
    """Judge a smooth error that no effect of the catalogue explains."""
    peak = int(np.argmax(np.abs(curve.value) / np.maximum(curve.sigma, 1e-12)))
    where = (
        "around x = {:.3g} m, y = {:.3g} m".format(*curve.knots[peak])
        if curve.covariate == PLACE
        else f"at {curve.knots[peak]:.3g} {curve.covariate_unit}"
    )
    text = (
        f"Something outside the catalogue acts on the {curve.channel} and depends on "
        f"{curve.covariate.replace('_', ' ')}: "
        f"{curve.value[peak]:+.3g} +- {curve.sigma[peak]:.2g} {curve.unit} {where}."
    )
    return Cause(
        selected=None,
        status=status_of(p, e),
        rivals=rivals,
        windows=(),
        support=Support(curve.gain, p, e),
        explains=explains,
        sentence=text,
        probabilities=probabilities or posterior({UNNAMED: curve.gain, NOTHING: 0.0}),
        curve=curve,
        surrogate=surrogate,
    )


def judge_ripple(ripple: Ripple) -> Cause:
    """Judge an unnamed periodic error of a wheel."""
    text = (
        f"Something outside the catalogue acts on the {ripple.side} wheel and repeats {ripple.order:.4g} +- "
        f"{ripple.sigma_order:.2g} times per revolution, as a gear does: the wheel reads up to "
        f"{100.0 * ripple.amplitude:.2g} +- {100.0 * ripple.sigma:.1g} % too much or too little."
    )
    return Cause(
        selected=None,
        status=Status.SUPPORTED,
        rivals=(),
        windows=(),
        support=Support(ripple.gain, ripple.p, None),
        explains=0.0,
        sentence=text,
        probabilities=posterior({UNNAMED: ripple.gain, NOTHING: 0.0}),
        ripple=ripple,
    )


def _windows(selected: Selected, time_s: Array) -> tuple[Window, ...]:
    begin_s, end_s = selected.begin_s, selected.end_s
    return ((float(time_s[0]) if begin_s is None else begin_s, float(time_s[-1]) if end_s is None else end_s),)
