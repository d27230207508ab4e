"""Causes from selected effects: how sure each is, what else it could be, where, and in words."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd_tools.diagnose.conclude.cause import Cause
from drd_tools.diagnose.conclude.confirm import (
    LARGEST_NATS,
    OtherHalf,
    chance_gains,
    curve_nats,
    e_value,
    family_wise_p,
    gain_over_time,
)
from drd_tools.diagnose.conclude.identify import APART_NATS, Identifiability
from drd_tools.diagnose.conclude.rivals import Near, at_odds, near_sets, posterior, rivals_of, unique
from drd_tools.diagnose.conclude.shares import shared_nats
from drd_tools.diagnose.conclude.uncertainty import BARELY, odds_over_the_reference, reported_estimates
from drd_tools.diagnose.observe.events import Event
from drd_tools.diagnose.regression.noise_fit import ratios
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine, refine_all
from drd_tools.diagnose.results import NOTHING, UNNAMED, Array, Because, Gain, Smallest, Status, Support, Window
from drd_tools.diagnose.select.orders import Ripple, ripples
from drd_tools.diagnose.select.search import Found, Search, linearised
from drd_tools.diagnose.select.sets import Sets
from drd_tools.diagnose.select.splines import CHANNELS, PLACE, Curve, SplineTerms
from drd_tools.diagnose.selected import Selected

# What a world that is a little unlike the model gives to some name or curve: so weak, nothing is said. Found
# by the trial.
LEAST_NATS: Final = 12.0
FAILING_NATS: Final = -0.01  # of both halves: 0, for or against nothing, but for rounding
# A curve without a name, beside all names, must be no mere rest of a name's imperfect form.
UNKNOWN_SHARE: Final = 0.02  # of what all effects explain: 14 % of their size is another form
GENERIC_SHARE: Final = 0.01  # of the names' worth, or
UNLIKE_SHARE: Final = 0.25  # of them where the world is unlike the model, and no name has the exact form, or
UNLIKE_NOISE: Final = 1.5  # times the noise that is stated: from there on it is
GENERIC_NATS: Final = 5.0  # by so much a curve without a name must beat a name: found by the trial
FAMILY_WISE: Final = 0.05  # the usual 5 %, over all of the catalogue
SUSPECTING: Final = 0.5  # chance does as well more often than not: no suspicion
CONFIRMING_E: Final = 100.0  # 100 to 1 in data that the fit has not seen: decisive (Jeffreys 1961)


@dataclass(frozen=True)
class Conclusion:
    """Causes, the largest share first, and what was not found.

    `of_the_reference`: delays and clock rates that it may well have by itself, where no gyro tells whose they are.
    """

    causes: list[Cause]
    found: Found
    ruled_out: list[Because]
    detectable: dict[str, Smallest]
    classes: list[list[str]]
    unexplained: float
    of_the_reference: Sequence[Selected] = ()


def conclude(
    found: Found, events: Sequence[Event], calibrated: Collection[str] = (), expected: Collection[str] = ()
) -> Conclusion:
    """Judge each selected effect, and what is left. `calibrated`, `expected`: names that a calibration, other
    recordings have given.
    """
    constants = {*calibrated, *expected}
    logic = [e.selected for e in events]
    before, search = found.fit, Search(found.problem, logic)
    tests = _tests(found, search)
    found = _held(found, search, tests, constants, expected)
    search, splines = Search(found.problem, logic), SplineTerms(found.problem)
    identity = Identifiability(found.problem, search.library)
    chance = chance_gains(found.problem, search.library, found.fit.left)
    by_logic = {e.selected.id: e for e in events}
    found, unnamed = _in_place_of_several(found, search, splines, chance, constants)
    if found.fit is not before:
        tests = _tests(found, search)
    near = near_sets(found, search)
    unnamed += [_periodic(r) for r in ripples(found.problem, found.fit.selection, LEAST_NATS, FAMILY_WISE)]
    estimates = reported_estimates(
        found.problem, found.fit, search.known, Sets(found.problem, found.fit.selection).scatter
    )
    odds = [odds_over_the_reference(found.problem, reported) for reported in estimates]
    of_the_reference = [reported for reported, own in zip(estimates, odds, strict=True) if own < BARELY]
    taken = search.known.union(one.id for one in of_the_reference)
    nats = shared_nats(found.problem, found.fit, taken)
    explained = sum(nats.values()) + sum(c.gain_nats for c in unnamed) + sum(e.nats for e in events)
    left = splines.best(found.fit.selection)
    if left is not None and left.gain <= max(LEAST_NATS, UNKNOWN_SHARE * explained):
        left = None
    whole = max(explained + (0.0 if left is None else left.gain), LEAST_NATS)
    findings = [replace(c, explains=c.gain_nats / whole) for c in unnamed]
    for test, reported, own in zip(tests, estimates, odds, strict=True):
        name = test.selected.id
        event = by_logic.get(name)
        if event is not None:
            findings.append(_event_finding(test.selected, event, event.nats / whole))
        elif own >= BARELY:
            share = nats[name] / whole
            cause = _finding(found, search, splines, test, reported, near, chance, share, name in constants)
            findings.append(replace(cause, probabilities=at_odds(cause.probabilities, own)))
    unexplained = 0.0
    if left is not None:
        # What it leaves is the noise: a cause whose sign changes by itself looks like chance when blocks are flipped.
        rest = found.fit.left - splines.rows(left)
        p = family_wise_p(left.gain + splines.cost, chance_gains(found.problem, search.library, rest))
        unexplained = left.gain / whole
        same = any(f.selected is None and f.curve is not None and f.curve.covariate == left.covariate for f in findings)
        unseen = curve_nats(found.problem, found.fit, splines.rows(left), splines.columns(left))
        if p <= FAMILY_WISE and not same and _holds(found.problem, unseen):
            findings.append(_unknown(left, p, unexplained, e=e_value(unseen)))
    findings = [f for f in _merged(findings) if f.effect in constants or (f.support.family_wise_p or 0.0) <= SUSPECTING]
    named = {f.effect for f in findings} | {name for f in findings for name in f.also_fits}
    bounds = identity.bounds(found.fit.left)
    ruled_out = [Because(name, text) for name, text in sorted(bounds.items()) if name not in named]
    return Conclusion(
        findings, found, ruled_out, identity.detectable(), identity.classes(), unexplained, of_the_reference
    )


def _merged(findings: Sequence[Cause]) -> list[Cause]:
    """Sort the causes, the largest share first, and merge the names that one and the same curve beats."""
    found: dict[tuple[str, str] | int, Cause] = {}
    for i, finding in enumerate(sorted(findings, key=lambda f: -f.explains)):
        key = (
            i
            if finding.selected is not None or finding.curve is None
            else (finding.curve.channel, finding.curve.covariate)
        )
        first = found.setdefault(key, finding)
        if first is not finding:
            found[key] = replace(
                first,
                rivals=unique((*first.rivals, *finding.rivals)),
                surrogate=first.surrogate or finding.surrogate,
                explains=min(1.0, first.explains + finding.explains),
            )
    return list(found.values())


def _in_place_of_several(
    found: Found, search: Search, splines: SplineTerms, chance: Array, constants: Collection[str]
) -> tuple[Found, list[Cause]]:
    """Replace all names of a channel by one curve without a name where that is better; its share is not known yet."""
    problem, fit = found.problem, found.fit
    unknown: list[Cause] = []
    for acts_on in dict.fromkeys(c.acts_on for c in CHANNELS.values()):
        named = (c for c in fit.selection if c.id not in search.known and c.id not in constants)
        group = [c for c in named if c.effect.channel == acts_on]
        if len(group) < 2:
            continue
        rest = refine(problem, [c for c in fit.selection if c not in group])
        worth = rest.cost - fit.cost
        curve = splines.best(rest.selection)
        margin = max(GENERIC_NATS, _generic_share(problem) * worth)
        if curve is None or CHANNELS[curve.channel].acts_on != acts_on:
            continue
        if curve.gain < worth - problem.penalty(group) + margin:
            continue
        unseen = curve_nats(problem, rest, splines.rows(curve), splines.columns(curve))
        if not _holds(problem, unseen):
            continue
        p = family_wise_p(curve.gain, chance)
        unknown.append(_unknown(curve, p, 0.0, rivals=unique(group), e=e_value(unseen)))
        fit = rest
    return Found(problem, fit, search.score(fit), found.null), unknown


def _generic_share(problem: Problem) -> float:
    """Share of a name's worth by which a curve without a name must be better."""
    slip = ratios(problem).get("slip") or 0.0
    return UNLIKE_SHARE if problem.evidence.is_far or slip > UNLIKE_NOISE else GENERIC_SHARE


def _tests(found: Found, search: Search) -> list[OtherHalf]:
    """A test of each selected effect on data that it was not fitted to."""
    return [OtherHalf(found.problem, search.library, found.fit, c) for c in found.fit.selection]


def _held(
    found: Found, search: Search, tests: Sequence[OtherHalf], constants: Collection[str], expected: Collection[str] = ()
) -> Found:
    """Drop the selected effects that fail on data that they were not fitted to, or gain next to nothing.

    One that shows in a single fix has no such data: nothing speaks against it there.
    """
    problem, fit = found.problem, found.fit
    stays = search.known.union(constants)
    unseen = [(0.0, 0.0) if c.id in stays else t.nats for c, t in zip(fit.selection, tests, strict=True)]
    kept = [
        c for c, nats in zip(fit.selection, unseen, strict=True) if sum(nats) > FAILING_NATS and _holds(problem, nats)
    ]
    if len(kept) < len(fit.selection):
        fit = refine(problem, kept)
    while others := [one for one in fit.selection if one.id not in search.known.union(expected)]:
        rests = refine_all(problem, [[c for c in fit.selection if c is not one] for one in others])
        worth = [rest.cost - fit.cost for rest in rests]
        least = int(np.argmin(worth))
        if worth[least] >= LEAST_NATS:
            break
        fit = rests[least]
    if fit is found.fit:
        return found
    # Constants far off were linearised around beside the others, which took part of them.
    return linearised(problem, fit, found.null) if constants else Found(problem, fit, search.score(fit), found.null)


def _status(p: float, e: float) -> Status:
    """Status of a finding that chance brings with probability p, and that unseen data bear out by odds of e."""
    if p > FAMILY_WISE:
        return Status.SUSPECTED
    return Status.CONFIRMED if e >= CONFIRMING_E else Status.SUPPORTED


def _holds(problem: Problem, unseen: tuple[float, float]) -> bool:
    """Whether either half of the data bears it out: what only one half of real ground shows is the ground's."""
    return not problem.evidence.is_far or min(unseen) > -APART_NATS


def _finding(
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
    problem, fit, selected = found.problem, found.fit, test.selected
    rest = refine(problem, [c for c in fit.selection if c is not selected])
    worth = rest.cost - fit.cost
    e = e_value(test.nats)
    # A constant was looked for before all others.
    by_chance = chance_gains(problem, search.library, fit.left, selected.id) if is_constant else chance
    p = family_wise_p(worth, by_chance)
    rivals = rivals_of(found, search, selected, rest, near)
    rival, asked = splines.best(fit.selection, selected), max(GENERIC_NATS, _generic_share(problem) * worth)
    # A constant that a calibration gives is no curve, whatever varies about it.
    unnamed = None if is_constant or rival is None else rival.gain - asked
    if rival is not None and unnamed is not None and problem.evidence.is_far:
        # Where the world is unlike the model some curve always fits better: it has to predict either half better, too.
        unseen = test.curve_nats(splines.columns(rival))
        unnamed = min(unnamed, *(rivals.own + u - n for u, n in zip(unseen, test.nats, strict=True)))
    probabilities = rivals.probabilities(unnamed)
    if rival is not None and unnamed is not None and unnamed > rivals.own:
        surrogate = reported if selected.effect.lasting and e >= CONFIRMING_E else None
        also = (selected, *rivals.alike)
        return _unknown(rival, p, explains, surrogate, also, e, probabilities)
    curve = _curve(splines, found, selected, rival)
    return Cause(
        selected=reported,
        status=_status(p, e),
        rivals=rivals.alike,
        windows=_windows(selected, problem.evidence.time_s),
        support=Support(worth, p, e),
        explains=explains,
        sentence=sentence(reported, explains, [r.id for r in rivals.alike]),
        probabilities=probabilities,
        curve=curve,
        gain=Gain(*gain_over_time(problem, fit, selected)),
        fitted=None if curve is None else _at_knots(splines, selected, curve),
    )


def _at_knots(splines: SplineTerms, selected: Selected, curve: Curve) -> Array:
    """The selected effect at the curve's knots; the gyro's constant bias, which is a nuisance, is no part of either."""
    values = splines.reported(selected, curve)
    if curve.channel == "gyro":
        values = values + float(np.average(curve.value - values, weights=1.0 / np.maximum(curve.sigma, 1e-12) ** 2))
    return values


def _curve(splines: SplineTerms, found: Found, selected: Selected, rival: Curve | None) -> Curve | None:
    """The mismatch that an effect explains, against the effect's own covariate where that is one of the smooths'."""
    options = [
        splines.best(found.fit.selection, selected, (channel, selected.effect.covariate))
        for channel, where in CHANNELS.items()
        if where.acts_on == selected.effect.channel
    ]
    curves = [c for c in options if c is not None]
    return max(curves, key=lambda c: c.gain, default=rival)


def _event_finding(selected: Selected, event: Event, explains: float) -> Cause:
    e = math.exp(min(event.nats, LARGEST_NATS))
    p = max(min(1.0, 31.0 / e), 1e-6)
    text = f"{selected.effect.sentence} Seen: {event.seen}."
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


def _unknown(
    curve: Curve,
    p: float,
    explains: float,
    surrogate: Selected | None = None,
    rivals: tuple[Selected, ...] = (),
    e: float = 1.0,
    probabilities: dict[str, float] | None = None,
) -> Cause:
    peak = int(np.argmax(np.abs(curve.value) / np.maximum(curve.sigma, 1e-12)))
    where = (
        "around x = {:.3g} m, y = {:.3g} m".format(*curve.knots[peak])
        if curve.covariate == PLACE
        else f"at {curve.knots[peak]:.3g} {curve.covariate_unit}"
    )
    text = (
        f"Something that is in no catalogue acts on the {curve.channel} and depends on "
        f"{curve.covariate.replace('_', ' ')}: "
        f"{curve.value[peak]:+.3g} +- {curve.sigma[peak]:.2g} {curve.unit} {where}."
    )
    return Cause(
        selected=None,
        status=_status(p, e),
        rivals=rivals,
        windows=(),
        support=Support(curve.gain, p, e),
        explains=explains,
        sentence=text,
        probabilities=probabilities or posterior({UNNAMED: curve.gain, NOTHING: 0.0}),
        curve=curve,
        surrogate=surrogate,
    )


def _periodic(ripple: Ripple) -> Cause:
    text = (
        f"Something that is in no catalogue acts on the {ripple.side} wheel and repeats {ripple.order:.4g} +- "
        f"{ripple.sigma_order:.2g} times in a turn of it, as a gear does: the wheel reads up to "
        f"{100.0 * ripple.amplitude:.2g} +- {100.0 * ripple.sigma:.1g} % too much, and too little."
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


def sentence(selected: Selected, explains: float | None, also_fits: Sequence[str]) -> str:
    """A finding in words; `explains`: its share of the mismatch, where that is known."""
    shown = []
    for q in selected.effect.parameters:
        if q.choices:
            shown.append(f"{q.name} {selected.values[q.name]}")
        elif not (q.fixed or (q.linear and q.name not in selected.free)):
            unit = "" if q.unit == "1" else f" {q.unit}"
            value, sigma = selected.number(q.name) / q.si, selected.sigma(q.name) / q.si
            shown.append(f"{q.name} = {rounded(value, sigma)}{unit}")
    share = "" if explains is None else f"; it explains {100.0 * explains:.0f} % of the mismatch"
    text = f"{selected.effect.sentence} Here {', '.join(shown)}{share}."
    if also_fits:
        text += f" This recording cannot tell it from {', '.join(also_fits)}."
    return f"{text} {selected.effect.caveat}".rstrip()


def rounded(value: float, sigma: float) -> str:
    """A value with its deviation, with as many digits as that warrants."""
    if sigma <= 0.0:
        return f"{value:.4g}"
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:.{digits}f} +- {sigma:.{digits}f}" if digits < 7 else f"{value:.3g} +- {sigma:.2g}"
