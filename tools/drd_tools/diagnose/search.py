"""Which effects are there: forward, delete and swap, each choice with its parameters fitted."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.effects.effect import END, START, ActsOn
from drd_tools.diagnose.claim import Claim
from drd_tools.diagnose.library import Candidate, choices, is_plausible, is_possible, library_of
from drd_tools.diagnose.problem import Problem
from drd_tools.diagnose.refine import Fit, beyond, held_beside, refine, refine_all
from drd_tools.diagnose.stretches import Stretches, joined, same_window

Array = npt.NDArray[np.float64]
_Products = tuple[Array, Array]  # of columns among themselves and with the data, beside a fit

MOST_CLAIMS: Final = 6
RIVALS: Final = 6
SWAPS: Final = 3
ROUGH_SHARE: Final = 0.6  # of its worth that an effect shows at least in the roughest variant of the library
CLEARLY_BETTER: Final = 0.1  # nats, against running in circles
# Where claims explain so much, or shift the time, the signatures must be taken along a motion that is cleared of them.
STRONG_NATS: Final = 2000.0
RELINEARISATIONS: Final = 3
CONVERGED_NATS: Final = 1.0
ROUGH_SQUARE: Final = 1.5  # mean of what is left, in sigmas
LITTLE_SHARE: Final = 0.1  # of the data's nats where the fit is rough, and where it is not:
NEXT_TO_NOTHING: Final = 0.003
CLOSE_SHARE: Final = 0.08  # of what the best explains: so near, a rival gets its own linearisation
CLOSE_RIVALS: Final = 3
TURNED_RAD: Final = 0.3
CLASS_NATS: Final = 4.0  # names whose scores are so near are one class
EXACT_NATS: Final = 0.5
PAIRS: Final = 200  # of variants, the best, from which so many
MOST_PAIRS: Final = 3  # of effects are tried
APART_SHARE: Final = 0.01  # of a column's square that the other of its pair must leave


@dataclass(frozen=True)
class Found:
    """A problem, linearised around the claims of a fit."""

    problem: Problem
    fit: Fit
    score: float
    null: float  # score without any claim
    is_cleared: bool = False  # whether the motion was cleared of the claims to see how the wheels turn
    is_complete: bool = False  # whether no other claim is worth its cost


def is_rough(fit: Fit) -> bool:
    """Whether the data are so far from the model that the noise must be larger: gains and their costs mean little."""
    return bool(fit.left.size) and float(np.mean(fit.left**2)) > ROUGH_SQUARE


def find_roughly(problem: Problem, known: Sequence[Claim] = ()) -> Found:
    """The claims that tell the noise: the search ends as soon as another claim changes little of what is left."""
    fit = refine(problem, known)
    null = -fit.cost - problem.penalty(fit.claims)
    found = Found(problem, fit, null, null)
    while (better := _better(found, known)) is not None:
        little = LITTLE_SHARE if is_rough(better.fit) else NEXT_TO_NOTHING
        if better.score < (1.0 - little) * found.score:
            return better
        found = better
    return replace(found, is_complete=True)


def finished(found: Found, known: Sequence[Claim] = ()) -> Found:
    """A rough search gone on with, until no claim is worth its cost and no other name, or form, is better."""
    while not found.is_complete and (better := _better(found, known)) is not None:
        found = better
    return _by_exact_form(_contested(Search(found.problem, known), found), {c.id for c in known})


def _better(found: Found, known: Sequence[Claim]) -> Found | None:
    """With a claim more, and all settled; None where none is worth its cost."""
    if len(found.fit.claims) >= MOST_CLAIMS + len(known):
        return None
    search, is_cleared = Search(found.problem, known), found.is_cleared
    better = _one_more(search, found)
    if better is None and not is_cleared and _turns_wheels(found):
        better, is_cleared = linearised(found.problem, found.fit, found.null), True
    if better is None:
        return None
    if better.problem is not found.problem:
        search = Search(better.problem, known)
    fit = search.settled(better.fit)
    return Found(better.problem, fit, search.score(fit), found.null, is_cleared)


def _turns_wheels(found: Found) -> bool:
    """Whether the claims leave the wheels elsewhere in their turn than the counts say: a ripple is not seen so."""
    for claim in found.fit.claims:
        signature = found.problem.signature(claim.effect, claim.values)
        for way in (signature.left_m, signature.right_m):
            if np.abs(np.cumsum(way)).max(initial=0.0) > TURNED_RAD * found.problem.evidence.radius_m:
                return True
    return False


def _by_exact_form(found: Found, known: set[str]) -> Found:
    """Of names that the data tell no better apart than a class, each claim has the one whose exact form fits best."""
    search = Search(found.problem)
    for name in [c.id for c in found.fit.claims if c.id not in known]:
        claim = next((c for c in found.fit.claims if c.id == name), None)
        rest = refine(found.problem, [c for c in found.fit.claims if c is not claim])
        least = found.score - CLASS_NATS
        rivals = [[*rest.claims, r] for _, r in search.ranked(rest)[:RIVALS] if r.id != name]
        fits = [f for f in refine_all(found.problem, rivals, least) if _is_plausible(found.problem, f)]
        alike = [f for f in fits if search.score(f) > least]
        best = max(alike, key=search.exact_score, default=found.fit)
        if search.exact_score(best) > search.exact_score(found.fit) + EXACT_NATS:
            found = Found(found.problem, best, search.score(best), found.null)
    return found


def _contested(search: "Search", found: Found) -> Found:
    """Give the nearest rival of each strong claim its own linearisation: close names differ in second order only."""
    for claim in found.fit.claims:
        if claim.id in search.known:
            continue
        rest = refine(found.problem, [c for c in found.fit.claims if c is not claim])
        worth = found.score - search.score(rest)
        if not _needs_linearising([claim], worth):
            continue
        rivals = [r for gain, r in search.ranked(rest) if r.id != claim.id and gain > (1.0 - CLOSE_SHARE) * worth]
        sets = [[*rest.claims, r] for r in rivals[:CLOSE_RIVALS]]
        # Two delays may stand for one: each alone is far off until the time is shifted by it.
        sets += [[*rest.claims]] if any(c.effect.acts_on is ActsOn.TIMING for c in rest.claims) else []
        for fit in refine_all(found.problem, sets):
            if not _is_plausible(found.problem, fit):
                continue
            other = linearised(found.problem, fit, found.null)
            if other.score > found.score + CLEARLY_BETTER:
                found = other
    return found


def _one_more(search: "Search", found: Found) -> Found | None:
    """The best claim beside those that are there; None where none holds once it is linearised around."""
    tried = search.grown(found.fit)
    if not tried:
        return None
    best = tried[0]
    if not _needs_linearising(best.claims, search.score(best) - found.null):
        return Found(found.problem, best, search.score(best), found.null)
    # Along another path, or with other noise, the best may explain less than nothing does here.
    margin = CLOSE_SHARE * max(search.score(best) - found.null, 0.0)
    close = [t for t in tried[:CLOSE_RIVALS] if search.score(t) >= search.score(best) - margin]
    chosen = max((linearised(found.problem, t, found.null) for t in close), key=lambda o: o.score)
    return chosen if chosen.score > found.score else None


def _needs_linearising(claims: Sequence[Claim], worth: float) -> bool:
    return worth > STRONG_NATS or any(c.effect.acts_on is ActsOn.TIMING for c in claims)


def linearised(problem: Problem, fit: Fit, null: float) -> Found:
    """Linearise around the claims, fit them again, and so on while that helps."""
    best: Found | None = None
    for _ in range(RELINEARISATIONS):
        problem = problem.around(fit.claims)
        fit = refine(problem, fit.claims)
        score = -fit.cost - problem.penalty(fit.claims)
        if best is not None and score < best.score + CONVERGED_NATS:
            break
        best = Found(problem, fit, score, null)
    assert best is not None
    return best


class Search:
    """Chooses among the candidates of one problem."""

    def __init__(self, problem: Problem, known: Sequence[Claim] = ()):
        self.problem, self.library = problem, library_of(problem)
        self.known = {c.id for c in known}
        self._last: tuple[Fit, list[_Products]] | None = None

    def score(self, fit: Fit) -> float:
        """Nats: how likely the data, less what the claims cost."""
        return -fit.cost - self.problem.penalty(fit.claims)

    def exact_score(self, fit: Fit) -> float:
        """As `score`, if no cause had another shape than the catalogue's."""
        residual = self.problem.data - self.problem.effect_rows(fit.claims)
        nats = -0.5 * float(residual @ beyond(self.problem.nuisance, residual))
        return nats - self.problem.penalty(fit.claims)

    def ranked(self, fit: Fit) -> list[tuple[float, Claim]]:
        """What each effect would gain beside the claims, with its best variants; best first."""
        (G, b), *stretches = self._beside(fit)
        best: dict[str, tuple[float, Claim]] = {}
        # Of thresholds and delays, the one that fits best as it is begins a search of its own.
        as_they_are: dict[str, tuple[float, Claim]] = {}
        for candidate in self._free(fit, G):
            index = list(candidate.columns)
            own = G[np.ix_(index, index)], b[index]
            for found, (gain, claim) in ((best, candidate.fitted(*own)), (as_they_are, candidate.as_it_is(*own))):
                if claim is not None and gain - candidate.penalty > found.get(claim.id, (0.0,))[0]:
                    found[claim.id] = (gain - candidate.penalty, claim)
        for each, products in zip(self.library.stretches, stretches, strict=True):
            for gain, claim in self._in_stretches(each, *products):
                if gain > best.get(claim.id, (0.0,))[0]:
                    best[claim.id] = (gain, claim)
        return sorted([*best.values(), *as_they_are.values()], key=lambda r: -r[0])

    def _in_stretches(self, stretches: Stretches, G: Array, b: Array) -> Iterator[tuple[float, Claim]]:
        for which in choices(stretches.effect, stretches.names):
            names = tuple(stretches.names[i] for i in which)
            best = stretches.best(names, G, b)
            if best is None:
                continue
            values = {**best.shape, **dict.fromkeys(stretches.names, 0.0)}
            values |= zip(names, map(float, best.sizes), strict=True)
            claim = Claim(stretches.effect, values, (*names, START.name, END.name))
            if is_plausible(claim):
                yield best.nats - self.problem.penalty([claim]), claim

    def paired(self, fit: Fit) -> list[tuple[Claim, Claim]]:
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
        told = determinant > APART_SHARE * own[:, None] * own
        names = np.array([c.effect.id for c in single])
        told &= names[:, None] != names
        both = 0.5 * (b[:, None] ** 2 * own + b**2 * own[:, None] - 2.0 * b[:, None] * b * G)
        gain = np.divide(both, determinant, out=np.zeros_like(G), where=told) - penalty[:, None] - penalty
        gain = np.triu(np.where(gain > alone[:, None] + alone, gain, 0.0))
        found: dict[tuple[str, str], tuple[Claim, Claim]] = {}
        for flat in np.argsort(gain, axis=None)[: -PAIRS - 1 : -1]:
            i, j = (int(k) for k in np.unravel_index(flat, gain.shape))
            if gain[i, j] <= 0.0 or len(found) == MOST_PAIRS:
                break
            x = np.linalg.solve(G[np.ix_([i, j], [i, j])], b[[i, j]])
            pair = single[i].claim(x[:1]), single[j].claim(x[1:])
            if pair[0] is not None and pair[1] is not None:
                found.setdefault((single[i].effect.id, single[j].effect.id), (pair[0], pair[1]))
        return list(found.values())

    def _beside(self, fit: Fit) -> list[_Products]:
        """Products beside a fit: of the library's columns, and of those of each effect of a stretch."""
        if self._last is None or self._last[0] is not fit:
            self._last = fit, self._products(fit)
        return self._last[1]

    def _products(self, fit: Fit) -> list[_Products]:
        problem = self.problem
        held = held_beside(problem, fit.claims)
        residual = problem.data - problem.effect_rows(fit.claims)
        A = held.T @ held + np.eye(held.shape[1])
        left = (residual - held @ np.linalg.solve(A, held.T @ residual)).astype(np.float32)
        own = self.library.columns, self.library.products
        made: list[_Products] = []
        for columns, products in (own, *((s.columns, s.products) for s in self.library.stretches)):
            cross = np.asarray(columns.T @ held.astype(np.float32), float)
            b = np.asarray(columns.T @ left, float)
            made.append((products - cross @ np.linalg.solve(A, cross.T), b))
        return made

    def _free(self, fit: Fit, G: Array) -> list[Candidate]:
        """Candidates that a fit leaves something of, and does not have already."""
        free = np.diag(G) > 1e-5 * np.diag(self.library.products)
        taken = {c.id for c in fit.claims if not c.effect.repeats}
        return [c for c in self.library.candidates if c.effect.id not in taken and free[list(c.columns)].all()]

    def grown(self, fit: Fit) -> list[Fit]:
        """Fits with one claim more, or two that hide each other, that are better; best first."""
        more = [*((claim,) for _, claim in self.ranked(fit)[:RIVALS]), *self.paired(fit)]
        tried = refine_all(self.problem, [[*fit.claims, *claims] for claims in more], self.score(fit))
        good = [t for t in tried if _is_plausible(self.problem, t) and self.score(t) > self.score(fit)]
        return sorted(good, key=self.score, reverse=True)

    def settled(self, fit: Fit) -> Fit:
        """Delete and swap claims, while that is better."""
        while any(c.id not in self.known for c in fit.claims):
            rests = [[c for c in fit.claims if c is not one] for one in fit.claims if one.id not in self.known]
            least = self.score(fit)
            less = refine_all(self.problem, rests, least)
            swaps = [[*rest.claims, c] for rest in less for c in self._rivals(fit, rest)] if len(rests) > 1 else []
            swaps += [
                [*(c for c in fit.claims if c is not one), other]
                for one in fit.claims
                if one.id not in self.known
                for other in same_window(one)
            ]
            found = [c for c in fit.claims if c.id not in self.known]
            swaps += [[*(c for c in fit.claims if c not in pair), one] for pair, one in joined(found)]
            good = [t for t in (*less, *refine_all(self.problem, swaps, least)) if _is_plausible(self.problem, t)]
            better = max(good, key=self.score, default=fit)
            if self.score(better) <= self.score(fit) + CLEARLY_BETTER:
                break
            fit = better
        return fit

    def _rivals(self, fit: Fit, rest: Fit) -> list[Claim]:
        """What may be worth as much beside `rest` as what it lacks of `fit`, once it is refined."""
        least = ROUGH_SHARE * (self.score(fit) - self.score(rest))
        return [c for gain, c in self.ranked(rest)[:SWAPS] if gain > least]


def _is_plausible(problem: Problem, fit: Fit) -> bool:
    return all(is_possible(problem, c) for c in fit.claims)
