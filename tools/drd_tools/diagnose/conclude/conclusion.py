"""The conclusion: which selected effects are causes, which causes have no name, and which effects are ruled out."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.effects.effect import ActsOn
from drd_tools.diagnose.conclude.cause import Cause
from drd_tools.diagnose.conclude.confirm import OtherHalf, chance_gains, curve_nats, e_value, family_wise_p
from drd_tools.diagnose.conclude.identify import Identifiability
from drd_tools.diagnose.conclude.judgement import (
    FAMILY_WISE,
    holds,
    judge,
    judge_curve,
    judge_event,
    judge_ripple,
    margin,
)
from drd_tools.diagnose.conclude.reference import BARELY, over_the_reference
from drd_tools.diagnose.conclude.rivals import LEAST_PROBABILITY, beside_nothing, near_sets, unique
from drd_tools.diagnose.conclude.shares import shared_nats
from drd_tools.diagnose.conclude.uncertainty import reported_estimates
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.observe.events import Event
from drd_tools.diagnose.observe.evidence import INFLATION
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, refine, refine_all
from drd_tools.diagnose.results import Because, Smallest
from drd_tools.diagnose.select.intervals import moved
from drd_tools.diagnose.select.orders import ripples
from drd_tools.diagnose.select.search import Found, Search, linearised
from drd_tools.diagnose.select.sets import Sets
from drd_tools.diagnose.select.splines import CHANNELS, Curve, SplineTerms
from drd_tools.diagnose.selected import SCALE, Selected

# A world slightly unlike the model gives this much to some name or curve: weaker causes are not reported. Found by
# the trial.
LEAST_NATS: Final = 12.0
CONSTANT_NATS: Final = 4.5  # 3 sigmas: nobody chose it from the catalogue, the calibrator measures it in any drive
FAILING_NATS: Final = -0.01  # of both halves: 0 up to rounding, neither for nor against
# An unnamed curve, beside all names, must not be the mere remainder of a name's imperfect form.
UNKNOWN_SHARE: Final = 0.02  # of what all effects explain: an error of form of 14 % of their size
SUSPECTING: Final = 0.5  # p: beyond, chance does as well more often than not


@dataclass(frozen=True)
class Conclusion:
    """Causes, the largest share first, and effects that were not found.

    `of_the_reference`: delays and clock rates attributed to the reference, for lack of a gyro to show whose they are.
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
    """Judge each selected effect, and the remaining mismatch. `calibrated`, `expected`: names from a calibration and
    from other recordings.
    """
    constants = {*calibrated, *expected}
    logic = [e.selected for e in events]
    found = _beyond_a_bias(_straight(found))
    before, search = found.fit, Search(found.problem, logic)
    tests = _tests(found, search)
    found = _held(found, search, tests, constants, expected)
    search, splines = Search(found.problem, logic), SplineTerms(found.problem)
    chance = chance_gains(found.problem, search.library, found.fit.left)
    by_logic = {e.selected.id: e for e in events}
    found, unnamed = _in_place_of_several(found, search, splines, chance, constants)
    if found.fit is not before:
        tests = _tests(found, search)
    near, problem, fit = near_sets(found, search), found.problem, found.fit
    unnamed += [judge_ripple(r) for r in ripples(problem, fit.selection, LEAST_NATS, FAMILY_WISE)]
    beside = Sets(problem, fit.selection)
    reported = reported_estimates(problem, fit, search.known, beside.scatter)
    estimates, odds = over_the_reference(problem, reported)
    of_the_reference = [one for one, own in zip(estimates, odds, strict=True) if own < BARELY]
    nats = shared_nats(problem, fit, search.known.union(one.id for one in of_the_reference))
    explained = sum(nats.values()) + sum(c.gain_nats for c in unnamed) + sum(e.nats for e in events)
    left = splines.best(fit.selection)
    if left is not None and left.gain <= max(LEAST_NATS, UNKNOWN_SHARE * explained):
        left = None
    whole = max(explained + (0.0 if left is None else left.gain), LEAST_NATS)
    findings = [replace(c, explains=c.gain_nats / whole) for c in unnamed]
    for test, estimate, own in zip(tests, estimates, odds, strict=True):
        name = test.selected.id
        event = by_logic.get(name)
        if event is not None:
            findings.append(judge_event(test.selected, event, event.nats / whole))
        elif own >= BARELY:
            share = nats[name] / whole
            cause = judge(found, search, splines, test, estimate, near, chance, share, name in constants)
            findings.append(_or_the_reference(cause, own))
    unexplained = 0.0 if left is None else left.gain / whole
    if left is not None:
        findings += _left_over(found, search, splines, left, findings, unexplained)
    findings = [f for f in _merged(findings) if f.effect in constants or (f.support.family_wise_p or 0.0) <= SUSPECTING]
    named = {f.effect for f in findings} | {name for f in findings for name in f.also_fits}
    identity = Identifiability(problem, beside)
    bounds = sorted(identity.bounds().items())
    ruled_out = [Because(name, text) for name, text in bounds if name not in named]
    return Conclusion(
        findings, found, ruled_out, identity.detectable(), identity.classes(), unexplained, of_the_reference
    )


def _or_the_reference(cause: Cause, odds: float) -> Cause:
    """A delay or clock rate at these odds that it is more than the reference's own; any other cause as it is."""
    rest = 1.0 / (1.0 + odds)
    if rest < LEAST_PROBABILITY:
        return cause
    text = f"{cause.sentence} Without a gyro, it may also be the reference's own (probability {rest:.2g})."
    return replace(cause, probabilities=beside_nothing(cause.probabilities, rest), sentence=text)


def _straight(found: Found) -> Found:
    """Replace an effect by its linear term alone if its nonlinear part gains next to nothing."""
    for one in found.fit.selection:
        if (line := one.beside) is None:
            continue
        (q,) = line.parameters
        straight = Selected(line, {q.name: one.number(SCALE.name)}, (q.name,))
        others = [c for c in found.fit.selection if c is not one and c.id != line.id]
        fit = refine(found.problem, [*others, straight])
        if fit.cost - found.fit.cost < LEAST_NATS:
            found = replace(found, fit=fit)
    return found


def _beyond_a_bias(found: Found) -> Found:
    """Drop effects on the gyro that gain next to nothing where its constant bias is free. (78)

    Rows divided by their long-run deviation tell little of the bias's prior: one of degrees per second, which the
    filter has forgotten after seconds, would explain slow errors of a real reference.
    """
    problem, e = found.problem, found.problem.evidence
    if e.gyro_rad is None or not e.is_far:
        return found
    free = problem.with_nuisance(Sensitivity(gyro_rad=INFLATION * e.datasheet.bias_rad_s * e.step_s))
    kept = list(found.fit.selection)
    for one in found.fit.selection:
        others = [c for c in kept if c is not one]
        if one.effect.acts_on is ActsOn.GYRO and refine(free, others).cost - refine(free, kept).cost < LEAST_NATS:
            kept = others
    return found if len(kept) == len(found.fit.selection) else linearised(problem, refine(problem, kept), found.null)


def _left_over(
    found: Found, search: Search, splines: SplineTerms, left: Curve, causes: Sequence[Cause], explains: float
) -> list[Cause]:
    """The curve that remains beside all causes, if neither chance nor one of them explains it."""
    # Flip the noise that it leaves: a cause whose sign alternates would itself look like chance.
    rest = found.fit.left - splines.rows(left)
    p = family_wise_p(left.gain + splines.cost, chance_gains(found.problem, search.library, rest))
    curves = [f.curve for f in causes if f.selected is None and f.curve is not None]
    is_other = any(c.covariate == left.covariate and c.channel != left.channel for c in curves)
    unseen = curve_nats(found.problem, found.fit, splines.rows(left), splines.columns(left))
    is_real = p <= FAMILY_WISE and not is_other and holds(found.problem, unseen)
    return [judge_curve(left, p, explains, e=e_value(unseen))] if is_real else []


def _merged(findings: Sequence[Cause]) -> list[Cause]:
    """Sort the causes, the largest share first, and merge the names that the same curve replaces."""
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


def _at_likeliest_moments(problem: Problem, fit: Fit) -> Fit:
    """Move effects that begin and last to their most likely times: one step may lie between two that were found, where
    no descent from either leads.
    """
    length_s = float(np.ptp(problem.evidence.edges_s))
    for i, one in enumerate(fit.selection):
        if one.end_s is not None:
            continue
        before, after = fit.selection[:i], fit.selection[i + 1 :]
        fits = refine_all(problem, [[*before, other, *after] for other in moved([one], length_s)])
        fit = min([fit, *fits], key=lambda f: f.cost)
    return fit


def _in_place_of_several(
    found: Found, search: Search, splines: SplineTerms, chance: Array, constants: Collection[str]
) -> tuple[Found, list[Cause]]:
    """Replace all names of a channel by one unnamed curve if that is better; its share is not known yet."""
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
        if curve is None or CHANNELS[curve.channel].acts_on != acts_on:
            continue
        if curve.gain < worth - problem.penalty(group) + margin(problem, worth):
            continue
        unseen = curve_nats(problem, rest, splines.rows(curve), splines.columns(curve))
        if not holds(problem, unseen):
            continue
        p = family_wise_p(curve.gain, chance)
        unknown.append(judge_curve(curve, p, 0.0, rivals=unique(group), e=e_value(unseen)))
        fit = rest
    return Found(problem, fit, found.null), unknown


def _tests(found: Found, search: Search) -> list[OtherHalf]:
    """Predictive test of each selected effect."""
    return [OtherHalf(found.problem, search.library, found.fit, c) for c in found.fit.selection]


def _fails(problem: Problem, test: OtherHalf) -> bool:
    """Whether data to which an effect was not fitted contradict it."""
    return sum(test.nats) <= FAILING_NATS or not holds(problem, test.nats)


def _held(
    found: Found, search: Search, tests: Sequence[OtherHalf], constants: Collection[str], expected: Collection[str] = ()
) -> Found:
    """Drop the selected effects that fail on data to which they were not fitted, or gain next to nothing.

    One at a time: of two that share an effect, each fails beside the other. An effect visible in a single fix cannot be
    tested so, and stays.
    """
    problem, fit = found.problem, found.fit
    stays = search.known.union(constants)
    while failing := [(sum(t.nats), t.selected) for t in tests if t.selected.id not in stays and _fails(problem, t)]:
        worst = min(failing, key=lambda f: f[0])[1]
        fit = refine(problem, [c for c in fit.selection if c is not worst])
        tests = _tests(replace(found, fit=fit), search)
    stays = search.known.union(expected)
    while others := [one for one in fit.selection if one.id not in stays]:
        rests = refine_all(problem, [[c for c in fit.selection if c is not one] for one in others])
        needed = [CONSTANT_NATS if one.id in constants else LEAST_NATS for one in others]
        beyond = [rest.cost - fit.cost - nats for rest, nats in zip(rests, needed, strict=True)]
        least = int(np.argmin(beyond))
        if beyond[least] >= 0.0:
            break
        name, rest = others[least].id, rests[least]
        # Without a constant that is far off, the others are linearised around the wrong path.
        if name in constants and linearised(problem, rest, found.null).fit.cost - fit.cost >= CONSTANT_NATS:
            stays = stays | {name}
        else:
            fit = rest
    if fit is found.fit:
        return found
    fit = _at_likeliest_moments(problem, fit)
    # The constants were linearised around together with the dropped effects, which absorbed part of them.
    return linearised(problem, fit, found.null) if constants else Found(problem, fit, found.null)
