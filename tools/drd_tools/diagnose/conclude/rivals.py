"""Alternatives to a selected effect: other names in its place, no name, or nothing."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, refine_all
from drd_tools.diagnose.results import NOTHING, UNNAMED
from drd_tools.diagnose.select.intervals import same_window
from drd_tools.diagnose.select.library import is_possible
from drd_tools.diagnose.select.search import CLASS_NATS, Found, Search, linearised
from drd_tools.diagnose.selected import Selected

TRIED: Final = 8  # names tried in an effect's place, the best by linear ranking: limits the time
FAR_NATS: Final = 30.0  # the score of a rival so much worse need not be exact
LEAST_PROBABILITY: Final = 0.001  # less is not reported


class Near(NamedTuple):
    """A set of names, its fit, and its averaged score, nats."""

    names: frozenset[str]
    fit: Fit
    score: float


@dataclass(frozen=True)
class Rivals:
    """Names in one effect's place. `own`: its score, nats above that of "nothing".

    `nats`: of its own name and the others, from all sets with each, above "nothing". `alike`: those, as fitted, that
    the recording cannot distinguish from it.
    """

    name: str
    own: float
    nats: Mapping[str, float]
    alike: tuple[Selected, ...]

    def probabilities(self, unnamed: float | None) -> dict[str, float]:
        """Posterior probabilities, the largest first. `unnamed`: score of a curve, less its required margin.

        The scores are log marginal likelihoods including the prior of each name. (80)
        """
        nats = {**self.nats, NOTHING: 0.0}
        if unnamed is not None:
            nats[UNNAMED] = unnamed - self.own + nats[self.name]
        return posterior(nats)


def posterior(nats: Mapping[str, float]) -> dict[str, float]:
    """Probabilities of alternatives from their log marginal likelihoods, the largest first."""
    most = max(nats.values())
    weights = {n: math.exp(max(x - most, -700.0)) for n, x in nats.items()}  # exp of less is 0
    total = sum(weights.values())
    kept = {n: w for n, w in weights.items() if w >= LEAST_PROBABILITY * total}
    return {n: w / sum(kept.values()) for n, w in sorted(kept.items(), key=lambda item: -item[1])}


def beside_nothing(probabilities: Mapping[str, float], nothing: float) -> dict[str, float]:
    """Probabilities of names, scaled to leave this one that the robot has no effect at all."""
    scaled = {name: (1.0 - nothing) * p for name, p in probabilities.items()}
    scaled[NOTHING] = scaled.get(NOTHING, 0.0) + nothing
    return {name: p for name, p in sorted(scaled.items(), key=lambda item: -item[1]) if p > 0.0}


def near_sets(found: Found, search: Search) -> list[Near]:
    """The sets of names that may be true, each with its best fit; the one found comes first."""
    fits: dict[frozenset[str], Fit] = {}
    for fit in (found.fit, *search.near(found.fit, found.score - FAR_NATS)):  # best first
        fits.setdefault(_names(fit), fit)
    return [Near(names, fit, search.averaged_score(fit)) for names, fit in fits.items()]


def _names(fit: Fit) -> frozenset[str]:
    return frozenset(c.id for c in fit.selection)


def rivals_of(found: Found, search: Search, selected: Selected, rest: Fit, near: Sequence[Near]) -> Rivals:
    """Try other names beside `rest`, the fit without the effect. `near`: other sets. (80)"""
    problem, others = found.problem, {c.id for c in rest.selection}
    tried = same_window(selected) + [c for _, c in search.ranked(rest) if c.id != selected.id][:TRIED]
    fits = refine_all(problem, [[*rest.selection, r] for r in tried], found.score - FAR_NATS)
    scores = {one.names: one.score for one in near}
    alike: list[Selected] = []
    for rival, fit in zip(tried, fits, strict=True):
        if not all(is_possible(problem, c) for c in fit.selection):
            continue
        score = _best_score(found, search, selected, rival, fit)
        relinearised = score - search.score(fit)
        scores[_names(fit)] = max(search.averaged_score(fit) + relinearised, scores.get(_names(fit), -math.inf))
        if score + _forgiven_nats(problem, selected, rival) > found.score - CLASS_NATS:
            alike.append(fit.selection[-1])
    # One name may imitate two of those found.
    for one in near:
        if selected.id not in one.names and search.score(one.fit) > found.score - CLASS_NATS:
            alike += [c for c in one.fit.selection if c.id not in others]
    names = {c.id for c in (*tried, *alike)} - others
    nothing = search.averaged_score(rest)
    nats: dict[str, float] = {}
    for own, score in scores.items():
        for name in {selected.id} if selected.id in own else own & names:
            nats[name] = float(np.logaddexp(nats.get(name, -math.inf), score - nothing))
    return Rivals(selected.id, found.score - search.score(rest), nats, unique(alike))


def _best_score(found: Found, search: Search, selected: Selected, rival: Selected, fit: Fit) -> float:
    """Score of a fit with a rival in a selected effect's place; if both shift the time, in its own linearisation."""
    score = search.score(fit)
    if selected.is_timing and rival.is_timing and score <= found.score - CLASS_NATS:
        score = max(score, linearised(found.problem, fit, found.null).score)
    return score


def _forgiven_nats(problem: Problem, selected: Selected, rival: Selected) -> float:
    """Cost not held against a rival: a second size, where one is enough, costs it no likelihood."""
    return problem.per_parameter if rival.begin_s is None and len(rival.free) == len(selected.free) + 1 else 0.0


def unique(rivals: Iterable[Selected]) -> tuple[Selected, ...]:
    """Keep the first effect of each name, in order."""
    found: dict[str, Selected] = {}
    for rival in rivals:
        found.setdefault(rival.id, rival)
    return tuple(found.values())
