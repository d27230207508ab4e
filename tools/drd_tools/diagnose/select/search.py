"""Search for effects: find the best of all small sets, refine it, linearise around it, and repeat while that gains."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, refine, refine_all
from drd_tools.diagnose.select.library import is_possible, library_of
from drd_tools.diagnose.select.sets import Sets
from drd_tools.diagnose.selected import Selected, shape_of

MOST_SELECTED: Final = 6  # effects besides the known ones: limits the time of a search
RIVALS: Final = 6  # refined, the best by linear ranking: limits the time
CLEARLY_BETTER: Final = 0.1  # nats: prevents cycles
# If effects explain so much, or shift the time, sensitivities must be recomputed along a motion cleared of them.
STRONG_NATS: Final = 2000.0
RELINEARISATIONS: Final = 8  # at most; fewer on convergence
PATHS: Final = 6  # at most: each iteration keeps a third of the remaining noise
CONVERGED_NATS: Final = 1.0  # less does not change the best name: CLASS_NATS is larger
ROUGH_SQUARE: Final = 1.5  # mean of the squared residual, in sigmas
MOVED: Final = 0.05  # sigmas: less changes no linearisation
LITTLE_SHARE: Final = 0.1  # of the data's nats if the fit is rough, and if it is not:
NEXT_TO_NOTHING: Final = 0.003
MUCH_SHARE: Final = 0.02  # if so much had counted as noise, the noise is refitted: beside it, others pass for effects
CLOSE_SHARE: Final = 0.08  # of what the best explains: rivals so close get their own linearisation
CLOSE_RIVALS: Final = 3  # each linearised separately: limits the time
TURNED_RAD: Final = 0.3  # wheel angle by which a ripple's phase may be wrong
CLASS_NATS: Final = 4.0  # names with scores so close form one class
EXACT_NATS: Final = 0.5  # a smaller difference within a class is numerical
SETS: Final = 12  # refined, the best by linear score: limits the time
LARGEST: Final = 4  # effects of a set: C(31, 4) sets are scored in a second, those of five take ten
MORE: Final = 2  # effects at a time: two may hide each other
REPLACED: Final = 3  # effects at a time, where there are more


@dataclass(frozen=True)
class Found:
    """A problem, linearised around the selected effects of a fit."""

    problem: Problem
    fit: Fit
    null: float  # score without any selected effect
    is_cleared: bool = False  # whether the motion was cleared of the selected effects to see how the wheels turn
    is_complete: bool = False  # whether no other selected effect is worth its cost
    is_noise_due: bool = False  # whether the noise must be refitted before the search continues

    @cached_property
    def score(self) -> float:
        """Score of the fit, nats. (80)"""
        return score_of(self.problem, self.fit)


def score_of(problem: Problem, fit: Fit) -> float:
    """Log likelihood less the penalty of the selected effects, nats. (80)"""
    return -fit.cost - problem.penalty(fit.selection)


def is_rough(fit: Fit) -> bool:
    """Whether the residual shows that the noise is larger than assumed: gains and their costs then mean little."""
    return bool(fit.left.size) and float(np.mean(fit.left**2)) > ROUGH_SQUARE


def coarse_search(
    problem: Problem, known: Sequence[Selected] = (), start: Sequence[Selected] = (), last: Found | None = None
) -> Found:
    """Search for the effects that affect the fit of the noise, until another effect gains little.

    `start`: effects to start from and keep; with them, a set that gains much also ends the search. `last`: an earlier
    search, with other noise, to continue from.
    """
    fit = refine(problem, known)
    null = score_of(problem, fit)
    found = Found(problem, fit, null)
    if start:
        names = {c.id for c in (*known, *start)}
        others = [] if last is None else [c for c in last.fit.selection if c.id not in names]
        found = _with_others(problem, replace(fit, selection=(*fit.selection, *start)), others, null)
        known = [*known, *start]
    while (better := _better(found, known)) is not None:
        little = LITTLE_SHARE if is_rough(better.fit) else NEXT_TO_NOTHING
        gain, found = 1.0 - better.score / found.score, better
        if gain < little or (start and gain > MUCH_SHARE):
            return replace(found, is_noise_due=gain > little)
    return replace(found, is_complete=True)


def _with_others(problem: Problem, fit: Fit, others: Sequence[Selected], null: float) -> Found:
    """Add other effects to the fit and linearise around them, dropping those whose sizes become impossible."""
    found = linearised(problem, replace(fit, selection=(*fit.selection, *others)), null)
    fitted = found.fit.selection[len(fit.selection) :]
    kept = [c for c, own in zip(others, fitted, strict=True) if is_possible(problem, own)]
    return found if len(kept) == len(others) else _with_others(problem, fit, kept, null)


def full_search(found: Found, known: Sequence[Selected] = ()) -> Found:
    """Continue a coarse search until no further effect is worth its cost and no other name, or form, is better."""
    while not found.is_complete and (better := _better(found, known)) is not None:
        found = better
    return _by_exact_form(_relinearised_rivals(Search(found.problem, known), found), {c.id for c in known})


def _better(found: Found, known: Sequence[Selected]) -> Found | None:
    """Find a better set of effects; None if there is none."""
    search, is_cleared = Search(found.problem, known), found.is_cleared
    better = _other_set(search, found)
    if better is None and not is_cleared and _turns_wheels(found):
        better, is_cleared = _plausibly_linearised(found, found.fit) or found, True
    return None if better is None else replace(better, is_cleared=is_cleared)


def _turns_wheels(found: Found) -> bool:
    """Whether the effects shift the wheels' angles from those counted: without this, a ripple would be missed."""
    for selected in found.fit.selection:
        sensitivity = found.problem.sensitivity(selected.effect, selected.values)
        for travel in (sensitivity.left_m, sensitivity.right_m):
            if np.abs(np.cumsum(travel)).max(initial=0.0) > TURNED_RAD * found.problem.evidence.radius_m:
                return True
    return False


def _by_exact_form(found: Found, known: set[str]) -> Found:
    """Give each effect the name in its class whose exact form fits best."""
    search = Search(found.problem)
    for name in [c.id for c in found.fit.selection if c.id not in known]:
        selected = next((c for c in found.fit.selection if c.id == name), None)
        rest = refine(found.problem, [c for c in found.fit.selection if c is not selected])
        least = found.score - CLASS_NATS
        rivals = [[*rest.selection, r] for _, r in search.ranked(rest)[:RIVALS] if r.id != name]
        fits = [f for f in refine_all(found.problem, rivals, least) if _is_plausible(found.problem, f)]
        alike = [f for f in fits if search.score(f) > least]
        best = max(alike, key=search.exact_score, default=found.fit)
        if search.exact_score(best) > search.exact_score(found.fit) + EXACT_NATS:
            found = Found(found.problem, best, found.null)
    return found


def _relinearised_rivals(search: "Search", found: Found) -> Found:
    """Linearise separately around the nearest rivals of each strong effect: close names differ only in second order."""
    for selected in found.fit.selection:
        rest = refine(found.problem, [c for c in found.fit.selection if c is not selected])
        worth = found.score - search.score(rest)
        if not _needs_linearising([selected], worth):
            continue
        is_known, is_late = selected.id in search.known, any(c.is_timing for c in rest.selection)
        # Two delays, or a delay and other effects, may imitate one: each alone fits badly until the time is shifted.
        sets = [[*rest.selection]] if is_late and not is_known else []
        if selected.is_timing and not is_known:
            sets.append([*(c for c in rest.selection if c.id in search.known), selected])
        if not is_known:
            close = (1.0 - CLOSE_SHARE) * worth
            rivals = [r for gain, r in search.ranked(rest) if r.id != selected.id and gain > close]
            sets += [[*rest.selection, r] for r in rivals[:CLOSE_RIVALS]]
        for fit in refine_all(found.problem, sets):
            other = _plausibly_linearised(found, fit)
            if other is not None and other.score > found.score + CLEARLY_BETTER:
                found = other
    return found


def _other_set(search: "Search", found: Found) -> Found | None:
    """The best other set of effects; None if none is still better after linearising around it."""
    tried = search.others(found.fit)
    if not tried:
        return None
    best, selection, least = tried[0], tried[0].selection, found.null
    if found.problem.evidence.is_far:  # already linearised around the constants, which explain most
        before = {c.id for c in found.fit.selection}
        selection, least = tuple(c for c in selection if c.id not in before), found.score
    if not _needs_linearising(selection, search.score(best) - least):
        return Found(found.problem, best, found.null)
    # Along another path, or with other noise, the best set may score below the null here.
    margin = CLOSE_SHARE * max(search.score(best) - least, 0.0)
    close = [t for t in tried[:CLOSE_RIVALS] if search.score(t) >= search.score(best) - margin]
    held = (_plausibly_linearised(found, t) for t in close)
    chosen = max((h for h in held if h is not None), key=lambda h: h.score, default=found)
    return chosen if chosen.score > found.score + CLEARLY_BETTER else None


def _plausibly_linearised(found: Found, fit: Fit) -> Found | None:
    """Linearise around a fit; None if a parameter's size is, or becomes, impossible."""
    if not _is_plausible(found.problem, fit):
        return None
    made = linearised(found.problem, fit, found.null)
    return made if _is_plausible(made.problem, made.fit) else None


def _needs_linearising(selection: Sequence[Selected], worth: float) -> bool:
    return worth > STRONG_NATS or any(c.is_timing for c in selection)


def linearised(problem: Problem, fit: Fit, null: float) -> Found:
    """Linearise around the selected effects and refit them, repeatedly while that helps."""
    best: Found | None = None
    for _ in range(RELINEARISATIONS):
        before = fit.selection
        problem = problem.around(before)
        fit = refine(problem, before)
        made = Found(problem, fit, null)
        if best is not None and made.score < best.score + CONVERGED_NATS:
            break
        best = made
        if not any(map(_has_moved, before, fit.selection)):
            break
    assert best is not None
    return best


def _has_moved(before: Selected, after: Selected) -> bool:
    """Whether a parameter has moved by more than a small fraction of its sigma."""
    return any(abs(after.number(n) - before.number(n)) > MOVED * after.sigma(n) for n in after.free)


def converged(problem: Problem, known: Sequence[Selected]) -> Problem:
    """Relinearise the problem until its path converges: the first path is bent to all fixes, including their noise.

    Because it fits that noise, any later path, and anything linearised around it, would seem worse.
    """
    cost = math.inf
    for _ in range(PATHS):
        problem = problem.around(known)
        before, cost = cost, refine(problem, known).cost
        if abs(cost - before) < CONVERGED_NATS:
            break
    return problem


class Search:
    """Search among the candidates of one problem."""

    def __init__(self, problem: Problem, known: Sequence[Selected] = ()):
        self.problem, self.library = problem, library_of(problem)
        self.known = {c.id for c in known}

    def score(self, fit: Fit) -> float:
        """Score of a fit, nats. (80)"""
        return score_of(self.problem, fit)

    def exact_score(self, fit: Fit) -> float:
        """Score without model discrepancy: every cause has exactly the catalogue's shape."""
        residual = self.problem.data - self.problem.effect_rows(fit.selection)
        return Marginal(self.problem.nuisance).nats(residual) - self.problem.penalty(fit.selection)

    def averaged_score(self, fit: Fit) -> float:
        """Score if causes equally likely have the catalogue's shapes, as in simulation, or others, as in reality."""
        return float(np.logaddexp(self.score(fit), self.exact_score(fit))) - math.log(2.0)

    def ranked(self, fit: Fit) -> list[tuple[float, Selected]]:
        """Gain of each further effect beside the selected ones, with its best variant; best first."""
        return Sets(self.problem, fit.selection).ranked()

    def others(self, fit: Fit) -> list[Fit]:
        """Fits of better sets of effects; best first."""
        tried = self.near(fit, self.score(fit))
        return [t for t in tried if self.score(t) > self.score(fit) + CLEARLY_BETTER]

    def near(self, fit: Fit, least: float) -> list[Fit]:
        """Fits of the best other sets of effects, best first, refined if they can reach the score `least`. (80)

        If effects are many, three are replaced at a time.
        """
        known = [c for c in fit.selection if c.id in self.known]
        found = sorted((c for c in fit.selection if c.id not in self.known), key=self._size)
        more = Sets(self.problem, fit.selection)
        sets: list[list[Selected]] = []
        if len(found) < MOST_SELECTED:
            sets += [[*fit.selection, *chosen] for chosen in more.best(RIVALS, 1)]
            sets += [[*fit.selection, one] for one in more.as_they_are()]
        for i in range(0, max(len(found), 1), REPLACED):
            replaced = found[i : i + REPLACED]
            held = [*known, *(c for c in found if c not in replaced)]
            if len(held) < len(known) + MOST_SELECTED:
                largest = min(len(replaced) + MORE, LARGEST)
                beside = Sets(self.problem, held, replaced, more.intervals)
                sets += [[*held, *chosen] for chosen in beside.best(SETS, largest)]
                sets += [[*held, one] for one in beside.as_they_are()]
        # The same set is proposed as an addition and as a replacement, and the one found as its own.
        distinct = {_forms(chosen): chosen for chosen in sets}
        distinct.pop(_forms(fit.selection), None)
        tried = (t for t in refine_all(self.problem, list(distinct.values()), least) if _is_plausible(self.problem, t))
        return sorted(tried, key=self.score, reverse=True)

    def _size(self, selected: Selected) -> float:
        rows = self.problem.effect_rows([selected])
        return float(rows @ rows)


def _forms(selection: Sequence[Selected]) -> frozenset[tuple[object, ...]]:
    """Names, free parameters and shapes of effects: a set from which one descent suffices."""
    return frozenset((c.id, c.free, *sorted(shape_of(c.effect, c.values).items())) for c in selection)


def _is_plausible(problem: Problem, fit: Fit) -> bool:
    return all(is_possible(problem, c) for c in fit.selection)
