"""Search for effects: forward, delete and swap, each choice with its parameters fitted."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.effects.effect import END, START, ActsOn
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, nuisance_design, refine, refine_all
from drd_tools.diagnose.results import Array
from drd_tools.diagnose.select.intervals import Intervals, joined, same_window
from drd_tools.diagnose.select.library import Candidate, choices, is_plausible, is_possible, library_of
from drd_tools.diagnose.selected import Selected

_Products = tuple[Array, Array]  # of columns among themselves and with the data, beside a fit

MOST_SELECTED: Final = 6  # effects beside those known: limits the time of a search
RIVALS: Final = 6  # by the linear ranking, to be refined: limits the time
SWAPS: Final = 3  # best names in a selected effect's place: limits the time
ROUGH_SHARE: Final = 0.6  # of its worth that an effect shows at least in the roughest variant of the library
EXACT_SHARE: Final = 0.9  # where it is linear
CLEARLY_BETTER: Final = 0.1  # nats, against running in circles
# Where effects explain so much, or shift the time, sensitivities must be taken along a motion cleared of them.
STRONG_NATS: Final = 2000.0
RELINEARISATIONS: Final = 3  # at most; it ends before where it converges
PATHS: Final = 6  # at most: each leaves a third of the noise in the one before
CONVERGED_NATS: Final = 1.0  # less does not change which name is best: CLASS_NATS is more
ROUGH_SQUARE: Final = 1.5  # mean of what is left, in sigmas
LITTLE_SHARE: Final = 0.1  # of the data's nats where the fit is rough, and where it is not:
NEXT_TO_NOTHING: Final = 0.003
CLOSE_SHARE: Final = 0.08  # of what the best explains: so near, a rival gets its own linearisation
CLOSE_RIVALS: Final = 3  # linearised each by itself: limits the time
TURNED_RAD: Final = 0.3  # of a wheel's turn, lost: a ripple's phase is then off by so much
CLASS_NATS: Final = 4.0  # names whose scores are so near are one class
EXACT_NATS: Final = 0.5  # less between two names of a class is rounding of their descent
PAIRS: Final = 200  # of variants, the best, from which so many
MOST_PAIRS: Final = 3  # of effects are tried
APART_SHARE: Final = 0.01  # of a column's square that the other of its pair must leave


@dataclass(frozen=True)
class Found:
    """A problem, linearised around the selected effects of a fit."""

    problem: Problem
    fit: Fit
    score: float
    null: float  # score without any selected effect
    is_cleared: bool = False  # whether the motion was cleared of the selected effects to see how the wheels turn
    is_complete: bool = False  # whether no other selected effect is worth its cost


def is_rough(fit: Fit) -> bool:
    """Whether the data are so far from the model that the noise must be larger: gains and their costs mean little."""
    return bool(fit.left.size) and float(np.mean(fit.left**2)) > ROUGH_SQUARE


def coarse_search(
    problem: Problem, known: Sequence[Selected] = (), start: Sequence[Selected] = (), last: Found | None = None
) -> Found:
    """Search for the effects that matter to the noise, until another effect changes little of what is left.

    `start`: effects from which it sets out, and which stay. `last`: a search with other noise, to go on from.
    """
    fit = refine(problem, known)
    null = -fit.cost - problem.penalty(fit.selection)
    found = Found(problem, fit, null, null)
    if start:
        names = {c.id for c in (*known, *start)}
        others = [] if last is None else [c for c in last.fit.selection if c.id not in names]
        found = linearised(problem, replace(fit, selection=(*fit.selection, *start, *others)), null)
        known = [*known, *start]
        swapped = Search(found.problem, known).backward_swapped(found.fit)
        found = replace(found, fit=swapped, score=-swapped.cost - found.problem.penalty(swapped.selection))
    while (better := _better(found, known)) is not None:
        little = LITTLE_SHARE if is_rough(better.fit) else NEXT_TO_NOTHING
        if better.score < (1.0 - little) * found.score:
            return better
        found = better
    return replace(found, is_complete=True)


def full_search(found: Found, known: Sequence[Selected] = ()) -> Found:
    """Continue a coarse search until no selected effect is worth its cost and no other name, or form, is better."""
    while not found.is_complete and (better := _better(found, known)) is not None:
        found = better
    return _by_exact_form(_relinearised_rivals(Search(found.problem, known), found), {c.id for c in known})


def _better(found: Found, known: Sequence[Selected]) -> Found | None:
    """Add the best effect, and swap the others; None where none is worth its cost."""
    if len(found.fit.selection) >= MOST_SELECTED + len(known):
        return None
    search, is_cleared = Search(found.problem, known), found.is_cleared
    better = _one_more(search, found)
    if better is None and not is_cleared and _turns_wheels(found):
        better, is_cleared = linearised(found.problem, found.fit, found.null), True
    if better is None:
        return None
    if better.problem is not found.problem:
        search = Search(better.problem, known)
    fit = search.backward_swapped(better.fit)
    return Found(better.problem, fit, search.score(fit), found.null, is_cleared)


def _turns_wheels(found: Found) -> bool:
    """Whether the effects leave the wheels elsewhere in their turn than the counts say: a ripple is not seen so."""
    for selected in found.fit.selection:
        sensitivity = found.problem.sensitivity(selected.effect, selected.values)
        for way in (sensitivity.left_m, sensitivity.right_m):
            if np.abs(np.cumsum(way)).max(initial=0.0) > TURNED_RAD * found.problem.evidence.radius_m:
                return True
    return False


def _by_exact_form(found: Found, known: set[str]) -> Found:
    """Give each effect the name, of those in one class with it, whose exact form fits best."""
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
            found = Found(found.problem, best, search.score(best), found.null)
    return found


def _relinearised_rivals(search: "Search", found: Found) -> Found:
    """Give the nearest rival of each strong effect its own linearisation: close names differ in second order only."""
    for selected in found.fit.selection:
        if selected.id in search.known:
            continue
        rest = refine(found.problem, [c for c in found.fit.selection if c is not selected])
        worth = found.score - search.score(rest)
        if not _needs_linearising([selected], worth):
            continue
        rivals = [r for gain, r in search.ranked(rest) if r.id != selected.id and gain > (1.0 - CLOSE_SHARE) * worth]
        sets = [[*rest.selection, r] for r in rivals[:CLOSE_RIVALS]]
        # Two delays may stand for one: each alone is far off until the time is shifted by it.
        sets += [[*rest.selection]] if any(c.effect.acts_on is ActsOn.TIMING for c in rest.selection) else []
        for fit in refine_all(found.problem, sets):
            if not _is_plausible(found.problem, fit):
                continue
            other = linearised(found.problem, fit, found.null)
            if other.score > found.score + CLEARLY_BETTER:
                found = other
    return found


def _one_more(search: "Search", found: Found) -> Found | None:
    """The best selected effect beside those that are there; None where none holds once it is linearised around."""
    tried = search.grown(found.fit)
    if not tried:
        return None
    best, selection, least = tried[0], tried[0].selection, found.null
    if found.problem.evidence.is_far:  # its constants are linearised around already, and explain most
        before = {c.id for c in found.fit.selection}
        selection, least = tuple(c for c in selection if c.id not in before), found.score
    if not _needs_linearising(selection, search.score(best) - least):
        return Found(found.problem, best, search.score(best), found.null)
    # Along another path, or with other noise, the best may explain less than nothing does here.
    margin = CLOSE_SHARE * max(search.score(best) - least, 0.0)
    close = [t for t in tried[:CLOSE_RIVALS] if search.score(t) >= search.score(best) - margin]
    chosen = max((linearised(found.problem, t, found.null) for t in close), key=lambda o: o.score)
    return chosen if chosen.score > found.score else None


def _needs_linearising(selection: Sequence[Selected], worth: float) -> bool:
    return worth > STRONG_NATS or any(c.effect.acts_on is ActsOn.TIMING for c in selection)


def linearised(problem: Problem, fit: Fit, null: float) -> Found:
    """Linearise around the selected effects, fit them again, and so on while that helps."""
    best: Found | None = None
    for _ in range(RELINEARISATIONS):
        problem = problem.around(fit.selection)
        fit = refine(problem, fit.selection)
        score = -fit.cost - problem.penalty(fit.selection)
        if best is not None and score < best.score + CONVERGED_NATS:
            break
        best = Found(problem, fit, score, null)
    assert best is not None
    return best


def converged(problem: Problem, known: Sequence[Selected]) -> Problem:
    """The problem around the path that it leads to: the first goes through all fixes, and has their noise in it.

    Beside that noise any later path would seem worse, and so would all that is linearised around.
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
        self._last: tuple[Fit, list[_Products]] | None = None

    def score(self, fit: Fit) -> float:
        """Log likelihood of the data less the penalty of the selected effects, nats. (80)"""
        return -fit.cost - self.problem.penalty(fit.selection)

    def exact_score(self, fit: Fit) -> float:
        """Score if no cause had another shape than the catalogue's."""
        residual = self.problem.data - self.problem.effect_rows(fit.selection)
        nats = -0.5 * float(residual @ Marginal(self.problem.nuisance).projected(residual))
        return nats - self.problem.penalty(fit.selection)

    def ranked(self, fit: Fit) -> list[tuple[float, Selected]]:
        """Gain of each effect beside the selected ones, with its best variants; best first."""
        (G, b), *intervals = self._beside(fit)
        best: dict[str, tuple[float, Selected]] = {}
        # Of thresholds and delays, the one that fits best as it is begins a search of its own.
        as_they_are: dict[str, tuple[float, Selected]] = {}
        for candidate in self._free(fit, G):
            index = list(candidate.columns)
            own = G[np.ix_(index, index)], b[index]
            for found, (gain, selected) in ((best, candidate.fitted(*own)), (as_they_are, candidate.as_it_is(*own))):
                if selected is not None and gain - candidate.penalty > found.get(selected.id, (0.0,))[0]:
                    found[selected.id] = (gain - candidate.penalty, selected)
        for each, products in zip(self.library.intervals, intervals, strict=True):
            for gain, selected in self._in_intervals(each, *products):
                if gain > best.get(selected.id, (0.0,))[0]:
                    best[selected.id] = (gain, selected)
        return sorted([*best.values(), *as_they_are.values()], key=lambda r: -r[0])

    def _in_intervals(self, intervals: Intervals, G: Array, b: Array) -> Iterator[tuple[float, Selected]]:
        for which in choices(intervals.effect, intervals.names):
            names = tuple(intervals.names[i] for i in which)
            best = intervals.best(names, G, b)
            if best is None:
                continue
            values = {**best.shape, **dict.fromkeys(intervals.names, 0.0)}
            values |= zip(names, map(float, best.sizes), strict=True)
            selected = Selected(intervals.effect, values, (*names, START.name, END.name))
            if is_plausible(selected):
                yield best.nats - self.problem.penalty([selected]), selected

    def paired(self, fit: Fit) -> list[tuple[Selected, Selected]]:
        """Pairs of effects that hide each other: together they gain more than each alone; best first."""
        G, b = self._beside(fit)[0]
        single = [c for c in self._free(fit, G) if len(c.columns) == 1]
        if not single:
            return []
        index = np.array([c.columns[0] for c in single])
        G, b, own = G[np.ix_(index, index)], b[index], np.diag(G)[index]
        penalty = np.array([c.penalty for c in single])
        alone = np.maximum(0.5 * b**2 / own - penalty, 0.0)
        determinant = own[:, None] * own - G * G
        # Of two that are nearly the same only noise can tell.
        separable = determinant > APART_SHARE * own[:, None] * own
        names = np.array([c.effect.id for c in single])
        separable &= names[:, None] != names
        both = 0.5 * (b[:, None] ** 2 * own + b**2 * own[:, None] - 2.0 * b[:, None] * b * G)
        gain = np.divide(both, determinant, out=np.zeros_like(G), where=separable) - penalty[:, None] - penalty
        gain = np.triu(np.where(gain > alone[:, None] + alone, gain, 0.0))
        found: dict[tuple[str, str], tuple[Selected, Selected]] = {}
        for flat in np.argsort(gain, axis=None)[: -PAIRS - 1 : -1]:
            i, j = (int(k) for k in np.unravel_index(flat, gain.shape))
            if gain[i, j] <= 0.0 or len(found) == MOST_PAIRS:
                break
            x = np.linalg.solve(G[np.ix_([i, j], [i, j])], b[[i, j]])
            pair = single[i].selected(x[:1]), single[j].selected(x[1:])
            if pair[0] is not None and pair[1] is not None:
                found.setdefault((single[i].effect.id, single[j].effect.id), (pair[0], pair[1]))
        return list(found.values())

    def scatter(self, fit: Fit, selected: Selected) -> float:
        """How much more an effect of an interval scatters over this drive than its deviations say; 1 of any other."""
        for intervals, products in zip(self.library.intervals, self._beside(fit)[1:], strict=True):
            if intervals.effect.id == selected.id:
                return intervals.scatter(selected, *products)
        return 1.0

    def _beside(self, fit: Fit) -> list[_Products]:
        """Products beside a fit: of the library's columns, and of those of each effect of an interval."""
        if self._last is None or self._last[0] is not fit:
            self._last = fit, self._products(fit)
        return self._last[1]

    def _products(self, fit: Fit) -> list[_Products]:
        problem = self.problem
        held = nuisance_design(problem, fit.selection)
        residual = problem.data - problem.effect_rows(fit.selection)
        marginal = Marginal(held)
        left = marginal.projected(residual).astype(np.float32)
        own = self.library.columns, self.library.products
        made: list[_Products] = []
        for columns, products in (own, *((s.columns, s.products) for s in self.library.intervals)):
            cross = np.asarray(columns.T @ held.astype(np.float32), float)
            b = np.asarray(columns.T @ left, float)
            made.append((marginal.beside(products, cross.T), b))
        return made

    def _free(self, fit: Fit, G: Array) -> list[Candidate]:
        """Candidates that a fit leaves something of, and does not have already."""
        free = np.diag(G) > 1e-5 * np.diag(self.library.products)
        taken = {c.id for c in fit.selection if not c.effect.repeats}
        return [c for c in self.library.candidates if c.effect.id not in taken and free[list(c.columns)].all()]

    def grown(self, fit: Fit) -> list[Fit]:
        """Fits with one selected effect more, or two that hide each other, that are better; best first."""
        more = [*((selected,) for _, selected in self.ranked(fit)[:RIVALS]), *self.paired(fit)]
        tried = refine_all(self.problem, [[*fit.selection, *selection] for selection in more], self.score(fit))
        good = [t for t in tried if _is_plausible(self.problem, t) and self.score(t) > self.score(fit)]
        return sorted(good, key=self.score, reverse=True)

    def backward_swapped(self, fit: Fit) -> Fit:
        """Delete and swap selected effects, while that is better."""
        while any(c.id not in self.known for c in fit.selection):
            rests = [[c for c in fit.selection if c is not one] for one in fit.selection if one.id not in self.known]
            least = self.score(fit)
            less = refine_all(self.problem, rests, least)
            swaps = [[*rest.selection, c] for rest in less for c in self._rivals(fit, rest)] if len(rests) > 1 else []
            swaps += [
                [*(c for c in fit.selection if c is not one), other]
                for one in fit.selection
                if one.id not in self.known
                for other in same_window(one)
            ]
            found = [c for c in fit.selection if c.id not in self.known]
            swaps += [[*(c for c in fit.selection if c not in pair), one] for pair, one in joined(found)]
            good = [t for t in (*less, *refine_all(self.problem, swaps, least)) if _is_plausible(self.problem, t)]
            better = max(good, key=self.score, default=fit)
            if self.score(better) <= self.score(fit) + CLEARLY_BETTER:
                break
            fit = better
        return fit

    def _rivals(self, fit: Fit, rest: Fit) -> list[Selected]:
        """Effects that may be worth as much beside `rest` as what it lacks of `fit`, once they are refined."""
        worth = self.score(fit) - self.score(rest)

        # What is linear gains no more by being refined.
        def share(c: Selected) -> float:
            return EXACT_SHARE if all(q.linear for q in c.effect.parameters) else ROUGH_SHARE

        return [c for gain, c in self.ranked(rest)[:SWAPS] if gain > share(c) * worth]


def _is_plausible(problem: Problem, fit: Fit) -> bool:
    return all(is_possible(problem, c) for c in fit.selection)
