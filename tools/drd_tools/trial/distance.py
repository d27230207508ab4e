"""Whitened distance of two explanations: the part of one effect's errors that the other cannot reproduce. (93)

`Rivals`: candidates of some effects, and the best variant of each in another's place. `half_square`: half the squared
residual that this leaves, in nats. `nearest`: distances of an effect from all its surrogates. `ceiling` and `least`:
how often the best possible method tells names at these distances apart.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from scipy.special import ndtr

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import nuisance_design, refine_all
from drd_tools.diagnose.results import NOTHING
from drd_tools.diagnose.select.intervals import same_window
from drd_tools.diagnose.select.library import Candidate, columns_of, is_possible, variants
from drd_tools.diagnose.selected import SCALE, Selected, linear_names

ALIKE: Final = 4.0  # distance below which two effects are look-alikes: the best method confuses one in forty
REFINED: Final = 6  # number of rivals refined, the nearest by their variants: limits the time


def half_square(residual: Array, held: Array) -> float:
    """Half the square of a residual (r,), nats, after fitting columns (r, q) of unit prior variance."""
    A = Marginal(held).A
    scale = 1.0 / np.sqrt(np.diag(A))
    b = scale * (held.T @ residual)
    x = np.linalg.lstsq(A * scale[:, None] * scale, b, rcond=1e-10)[0]
    return max(0.0, 0.5 * float(residual @ residual - b @ x))


def rival_names(problem: Problem) -> list[str]:
    """Effects that can be surrogates of others: those that raw readings show by logic are never confused."""
    return [x.id for x in catalogue().values() if x.searched and x.channel in problem.evidence.channels]


class Rivals:
    """Candidates of a few effects, whitened once."""

    def __init__(self, problem: Problem, names: Sequence[str]):
        self._candidates: list[Candidate] = []
        sensitivities: list[Sensitivity] = []
        for effect in (catalogue()[name] for name in names):
            for shape in variants(problem, effect):
                made, own = columns_of(problem, effect, shape, len(sensitivities))
                self._candidates += made
                sensitivities += own
        self.names = tuple(names)
        self.rows = problem.whiten(sensitivities)

    def best(self, name: str, data: Array, held: Array, allowed: Callable[[Selected], bool]) -> Selected | None:
        """Fit the variants of an effect to the data (r,) beside columns `held` (r, q) of unit prior variance.

        Returns the `allowed` one that explains most, with its parameters.
        """
        own = [c for c in self._candidates if c.effect.id == name]
        columns = sorted({i for c in own for i in c.columns})
        at = {column: k for k, column in enumerate(columns)}
        S = self.rows[:, columns]
        marginal, C = Marginal(held), held.T @ S
        G, b = marginal.beside(S.T @ S, C), marginal.beside(S.T @ data, C, held.T @ data)
        best: tuple[float, Selected] | None = None
        for candidate in own:
            index = [at[i] for i in candidate.columns]
            x = np.asarray(np.linalg.lstsq(G[np.ix_(index, index)], b[index], rcond=1e-8)[0], float)
            gain = float(b[index] @ x - 0.5 * x @ G[np.ix_(index, index)] @ x)
            if best is not None and gain <= best[0]:
                continue
            if (selected := candidate.selected(x)) is not None and allowed(selected):
                best = gain, selected
        return None if best is None else best[1]


class Near(NamedTuple):
    """A surrogate of an effect (NOTHING: none), and its whitened distance from the effect."""

    name: str
    distance: float


def nearest(
    problem: Problem, one: Selected, others: Sequence[Selected], rivals: Rivals, most: int | None = None
) -> list[Near]:
    """Find the surrogates of `one` beside the `others`, whose free parameters adapt, the nearest first.

    Each distance is attained by parameters in the catalogue's plausible range, at most `most` of them free: it may be
    too large if the descent ends too early, but never too small. Causes have the catalogue's form.
    """
    exact = problem.exact().with_data(problem.effect_rows([one, *others]))
    rows, taken = exact.effect_rows([one]), {one.id, *(c.id for c in others)}
    # Tangents along nonlinear parameters would promise more than the others can do.
    held = nuisance_design(exact, [replace(c, free=linear_names(c.effect, c.values)) for c in others])

    def allowed(c: Selected) -> bool:
        return (most is None or len(c.free) <= most) and is_usual(c) and is_possible(exact, c)

    starts: dict[str, Selected] = {}
    reached = {NOTHING: half_square(rows, held)}
    for name in (n for n in rivals.names if n not in taken):
        reached[name] = reached[NOTHING]  # of no size
        best = rivals.best(name, rows, held, allowed)
        if best is not None:
            starts[name] = best
            reached[name] = min(reached[NOTHING], half_square(rows - exact.effect_rows([best]), held))
    begun = [starts[name] for name in sorted(starts, key=lambda n: reached[n])[:REFINED]]
    begun += [c for c in same_window(one) if c.id in rivals.names and c.id not in taken]
    for fit in refine_all(exact, [[*others, c] for c in begun]):
        if allowed(fit.selection[-1]):
            name, left = fit.selection[-1].id, exact.data - exact.effect_rows(fit.selection)
            reached[name] = min(reached[name], half_square(left, exact.nuisance))
    return sorted((Near(name, math.sqrt(2.0 * nats)) for name, nats in reached.items()), key=lambda n: n.distance)


def is_usual(selected: Selected) -> bool:
    """Whether the parameters lie in the catalogue's plausible ranges, without SCALE; a size may be smaller."""
    if SCALE.name in selected.values:
        return False
    for q in selected.effect.parameters:
        if q.choices or q.moment or q.is_angle or q.fixed:
            continue
        value, is_size = selected.number(q.name) / q.si, q.linear or not selected.effect.linear()
        if abs(value) > q.high or (abs(value) < q.low and (q.neutral or not is_size)):
            return False
    return True


def ceiling(distances: Sequence[float]) -> float:
    """Upper limit of the probability of choosing correctly between two equally likely names: the truth and its nearest
    rival, given the rivals' `distances`. (93)
    """
    return float(ndtr(0.5 * min(distances, default=math.inf)))


def least(distances: Sequence[float]) -> float:
    """Probability that the best method attains against all rivals together, sizes known, by the union bound. (93)"""
    return max(0.0, 1.0 - float(sum(ndtr(-0.5 * d) for d in distances)))
