"""Fit the parameters of effects together: Gauss and Newton, each step bounded where the model is not linear."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from drd_tools.diagnose.error_model.sensitivities import DRIFT
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem, Wanted
from drd_tools.diagnose.results import Amount, Array
from drd_tools.diagnose.selected import Selected, shape_of

ROUNDS: Final = 12  # at most; it ends before where it converges: limits the time
ENOUGH_NATS: Final = 0.02  # that a whole step would still bring
LONGER, SHORTEST = 3.0, 0.05  # the next share of the moves, of the last, where that was good and where not
FAIR_ROUNDS: Final = 2  # before a set of effects may be given up
HOPELESS_NATS: Final = 30.0  # that a score lies below what is asked for, although the linear model was followed
CLEAR_ROUNDS: Final = 3  # after so many, if
HOPED: Final = 5.0  # times what the linear model still expects would not be enough
PRIOR_SIZES: Final = 3.0  # a parameter of so many times its plausible range is implausible
FREE: Final = 1e6  # prior, in units of the data's deviation, of what is as good as free
DISCREPANCY_SHARE: Final = 0.15  # of an effect's size: how wrong its catalogue form is taken to be


PPM: Final = 1e-6
CLEARLY: Final = 3.0  # sigmas: of a fault of the reference that is told


@dataclass(frozen=True)
class Fit:
    """Selected effects with fitted parameters.

    `cost`: nats by which the data are unlikely under the selected effects, nuisances and other shapes integrated over.
    `nuisance`: coefficients in units of their priors. `left` (r,): whitened data less effects, nuisances and shapes.
    """

    selection: tuple[Selected, ...]
    cost: float
    nuisance: Array
    left: Array


def refine(problem: Problem, selection: Sequence[Selected]) -> Fit:
    """Improve the parameters until the cost stays."""
    return refine_all(problem, [selection])[0]


def refine_all(problem: Problem, sets: Sequence[Sequence[Selected]], least: float = -math.inf) -> list[Fit]:
    """Refine several sets of effects side by side: passing all their sensitivities at once costs little more than one.

    Those that will clearly not reach the score `least` are left as they are.
    """
    searches, kept = [_Descent(problem, tuple(selection), least) for selection in sets], _Kept()
    for _ in range(ROUNDS):
        active = [s for s in searches if not s.done]
        if not active:
            break
        problem.units([wanted for s in active for wanted in s.wanted()])
        for s in active:
            s.step(kept)
    return [s.fit for s in searches]


def reference_drift(problem: Problem, fit: Fit) -> Amount | None:
    """By how much a reference's clock drifts from that of the robot without a gyro; None where that is not clear."""
    names = [name for name, _, _ in problem.nuisances]
    if DRIFT not in names:
        return None
    i = names.index(DRIFT)
    size = problem.nuisances[i][1] / PPM
    sigma = math.sqrt(float(np.linalg.inv(Marginal(problem.nuisance).A)[i, i]))
    is_clear = abs(float(fit.nuisance[i])) > CLEARLY * sigma
    return Amount(float(fit.nuisance[i]) * size, sigma * size, "ppm") if is_clear else None


class _Descent:
    """Descent of one set of selected effects."""

    def __init__(self, problem: Problem, selection: tuple[Selected, ...], least: float):
        self._problem, self._current = problem, selection
        self._enough = -least - problem.penalty(selection)
        self._rounds = 0
        self._best: Fit | None = None
        self._moves: Array = np.zeros(0)
        self._share = 1.0  # of the moves, that is tried
        self._gain = 0.0  # that all of them would bring where the model is linear, nats
        self.done = False

    def _is_hopeless(self, cost: float) -> bool:
        if self._rounds >= CLEAR_ROUNDS and cost - HOPED * self._gain > self._enough:
            return True
        return self._rounds >= FAIR_ROUNDS and cost - self._gain > self._enough + HOPELESS_NATS

    @property
    def fit(self) -> Fit:
        assert self._best is not None
        return self._best

    def wanted(self) -> list[Wanted]:
        problem, selection = self._problem, self._current
        discrepancy_shapes = [w for c in selection for w in problem.wanted_shapes(c)]
        return problem.wanted_rows(selection) + problem.wanted_tangents(selection) + discrepancy_shapes

    def step(self, kept: "_Kept") -> None:
        fit, moves, reachable = _evaluate(self._problem, self._current, kept)
        self._rounds += 1
        if self._best is None or fit.cost < self._best.cost - 1e-9:
            # Where the moves were too long they will be so again.
            self._best, self._moves, self._share = fit, moves, min(1.0, LONGER * self._share)
            self._gain = fit.cost - reachable
            self.done = self._is_hopeless(fit.cost)
        else:
            # The parabola through both costs, with the slope that the linear model has.
            least = self._share * self._gain / (fit.cost - self._best.cost + 2.0 * self._share * self._gain)
            self._share *= min(max(least, SHORTEST), 0.5)
        self.done = self.done or self._share * self._gain < ENOUGH_NATS
        self._current = _moved(self._best.selection, self._moves * self._share)


def _evaluate(problem: Problem, selection: tuple[Selected, ...], kept: "_Kept") -> tuple[Fit, Array, float]:
    """Cost of effects as they are (74); the moves that a linear model proposes (76), and its cost then."""
    residual, T = problem.data - problem.effect_rows(selection), problem.tangents(selection).T
    soft = np.concatenate([problem.nuisance.T, *(discrepancies(problem, selected, kept).T for selected in selection)])
    marginal, b = Marginal(soft.T), soft @ residual
    L = np.linalg.cholesky(marginal.A)
    x = np.linalg.solve(L.T, np.linalg.solve(L, b))
    # Of the nuisances' determinant a constant part is the same for all selected effects.
    cost = 0.5 * float(residual @ residual - b @ x) + float(np.log(np.diag(L)).sum())
    off, weight = _measured(selection)
    cost += 0.5 * float(off @ (weight * off))
    fit = Fit(selection, cost, x[: problem.nuisance.shape[1]], residual - x @ soft)
    if not len(T):
        return fit, np.zeros(0), cost
    priors = np.concatenate([precisions(c) for c in selection]) + weight
    # In the directions that nuisances and shapes leave.
    S = marginal.beside(T @ T.T, soft @ T.T) + np.diag(priors)
    g = T @ fit.left - weight * off
    inverse = _inverse(S)
    moves = inverse @ g
    return replace(fit, selection=_with_covariance(selection, inverse)), moves, cost - 0.5 * float(g @ moves)


class Response(NamedTuple):
    """Response of the effects' free parameters (k,), one selected effect after the other, to what is not certain.

    `covariance` (k, k). `discrepancy_shapes` (k, s): what other shapes of the effects' causes, each as large as its
    effect, move them by.
    """

    covariance: Array
    discrepancy_shapes: Array


def response(problem: Problem, fit: Fit) -> Response:
    """Response of the parameters of a fit."""
    selection = fit.selection
    T = problem.tangents(selection)
    soft = np.column_stack([problem.nuisance, *(discrepancies(problem, selected) for selected in selection)])
    F = np.column_stack([np.zeros((len(T), 0)), *(problem.discrepancy_shapes(selected) for selected in selection)])
    marginal, C = Marginal(soft), soft.T @ T
    priors = np.concatenate([np.zeros(0), *(precisions(c) for c in selection)]) + _measured(selection)[1]
    covariance = _inverse(marginal.beside(T.T @ T, C) + np.diag(priors))
    return Response(covariance, covariance @ marginal.beside(T.T @ F, C, soft.T @ F))


def _inverse(S: Array) -> Array:
    if len(S) == 1:
        return np.where(S > 0.0, 1.0 / np.maximum(S, 1e-300), 0.0)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(S), 1e-300))
    inverse: Array = np.linalg.pinv(S * scale[:, None] * scale, rcond=1e-10, hermitian=True) * scale[:, None] * scale
    return inverse


class _Kept(dict[tuple[object, ...], Array]):
    """Shapes (s, r) of norm 1 less what parameters can make of them, by effect: while only sizes change they stay."""


def discrepancies(problem: Problem, selected: Selected, kept: _Kept | None = None) -> Array:
    """Other shapes of an effect's cause (r, s), as large as they may be, less what its own parameters can make of them.

    What is left of them cannot be traded for the parameters: they keep their meaning. (75)
    """
    shape = shape_of(selected.effect, selected.values)
    key = (selected.id, selected.free, *sorted(shape.items()))
    F = None if kept is None else kept.get(key)
    if F is None:
        F, T = problem.unit_shapes(selected).T, problem.tangents([selected]).T
        if F.size and T.size:
            F = F - F @ T.T @ _inverse(T @ T.T) @ T
        if kept is not None and not shape.keys() & set(selected.free):  # else tangents are of one size
            kept[key] = F
    return DISCREPANCY_SHARE * float(np.linalg.norm(problem.effect_rows([selected]))) * F.T


def nuisance_columns(problem: Problem, selection: Sequence[Selected]) -> tuple[Array, Array]:
    """Columns of prior 1: shapes of the effects' causes (r, s); nuisances, and parameters as good as free (r, k)."""
    T = problem.tangents(selection)
    norms = np.linalg.norm(T, axis=0)
    seen = norms > 0.0
    shapes = [np.zeros((len(T), 0)), *(discrepancies(problem, c) for c in selection)]
    return np.column_stack(shapes), np.column_stack([problem.nuisance, T[:, seen] / norms[seen] * FREE])


def nuisance_design(problem: Problem, selection: Sequence[Selected]) -> Array:
    """Both kinds of `nuisance_columns` (r, s + k)."""
    return np.column_stack(nuisance_columns(problem, selection))


def precisions(selected: Selected) -> Array:
    """Inverse variances (k,) of the free parameters before any data: what is implausible."""
    sizes = [max(PRIOR_SIZES * q.high * q.si, 1e-30) for q in map(selected.parameter, selected.free)]
    return 1.0 / np.array(sizes) ** 2


def _measured(selection: Sequence[Selected]) -> tuple[Array, Array]:
    """How far the free parameters (k,) are from what else has measured them, and the inverse variances of that."""
    pairs = [(c.number(name), c.prior.get(name)) for c in selection for name in c.free]
    off = np.array([0.0 if prior is None else at - prior[0] for at, prior in pairs])
    return off, np.array([0.0 if prior is None else prior[1] ** -2 for _, prior in pairs])


def _with_covariance(selection: Sequence[Selected], covariance: Array) -> tuple[Selected, ...]:
    result, i = [], 0
    for selected in selection:
        k = len(selected.free)
        result.append(replace(selected, covariance=covariance[i : i + k, i : i + k]))
        i += k
    return tuple(result)


def _moved(selection: Sequence[Selected], moves: Array) -> tuple[Selected, ...]:
    """Take the moves, bounded where the model is not linear."""
    result, i = [], 0
    for selected in selection:
        values = dict(selected.values)
        for name in selected.free:
            at = selected.number(name)
            d = selected.parameter(name).bounded(at, float(moves[i]))
            values[name] = at + d if math.isfinite(d) else at
            i += 1
        result.append(replace(selected, values=values))
    return tuple(result)
