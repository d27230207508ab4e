"""Fit the parameters of effects together: Gauss and Newton, each step bounded where the model is not linear."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem, Wanted, factors_of
from drd_tools.diagnose.results import Array
from drd_tools.diagnose.selected import Selected

ROUNDS: Final = 12  # at most; it ends before where it converges: limits the time
ENOUGH_NATS: Final = 0.02  # that a whole step would still bring
LONGER, SHORTEST = 3.0, 0.05  # the next share of the moves, of the last, where that was good and where not
FAIR_ROUNDS: Final = 2  # before a set of effects may be given up
HOPELESS_NATS: Final = 30.0  # that a score lies below what is asked for, although the linear model was followed
CLEAR_ROUNDS: Final = 3  # after so many, if
HOPED: Final = 5.0  # times what the linear model still expects would not be enough
PRIOR_SIZES: Final = 3.0  # a parameter of so many times its plausible range is implausible
ROUNDING: Final = 1e-14  # of the products of columns: where counters leap by a kilometre it is more than their priors
UNSEEN: Final = 1e-60  # square of a column that is all rounding: its inverse would overflow
FREE: Final = 1e6  # prior, in units of the data's deviation, of what is as good as free
DISCREPANCY_SHARE: Final = 0.15  # of an effect's size: how wrong its catalogue form is taken to be


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
    searches = [_Descent(problem, tuple(selection), least) for selection in sets]
    for _ in range(ROUNDS):
        active = [s for s in searches if not s.done]
        if not active:
            break
        problem.units([wanted for s in active for wanted in s.units.wanted])
        for s in active:
            s.step()
    return [s.fit for s in searches]


class _Descent:
    """Descent of one set of selected effects."""

    def __init__(self, problem: Problem, selection: tuple[Selected, ...], least: float):
        self._problem = problem
        self._set_out(selection)
        self._enough = -least - problem.penalty(selection)
        self._rounds = 0
        self._best: _Evaluated | None = None
        self._moves: Array = np.zeros(0)
        self._share = 1.0  # of the moves, that is tried
        self._gain = 0.0  # that all of them would bring where the model is linear, nats
        self.done = False

    def _set_out(self, selection: tuple[Selected, ...]) -> None:
        self._current, self.units = selection, _Units(self._problem, selection)

    def _is_hopeless(self, cost: float) -> bool:
        if self._rounds >= CLEAR_ROUNDS and cost - HOPED * self._gain > self._enough:
            return True
        return self._rounds >= FAIR_ROUNDS and cost - self._gain > self._enough + HOPELESS_NATS

    @property
    def fit(self) -> Fit:
        """The best that was found."""
        best = self._best
        assert best is not None
        left = self._problem.combined(best.left, best.wanted)
        return Fit(best.selection, best.cost, best.nuisance, left)

    def step(self) -> None:
        """Evaluate the current parameters, and choose the next."""
        tried = _evaluate(self._problem, self._current, self.units)
        self._rounds += 1
        if self._best is None or tried.cost < self._best.cost - 1e-9:
            # Where the moves were too long they will be so again.
            self._best, self._moves, self._share = tried, tried.moves, min(1.0, LONGER * self._share)
            self._gain = tried.cost - tried.reachable
            self.done = self._is_hopeless(tried.cost)
        else:
            # The parabola through both costs, with the slope that the linear model has.
            least = self._share * self._gain / (tried.cost - self._best.cost + 2.0 * self._share * self._gain)
            self._share *= min(max(least, SHORTEST), 0.5)
        self.done = self.done or self._share * self._gain < ENOUGH_NATS
        if not self.done:
            self._set_out(_moved(self._best.selection, self._moves * self._share))


class _Evaluated(NamedTuple):
    """Effects as they are: their cost, nats (74), and the nuisances' coefficients (q,).

    `moves` (k,) of the free parameters, as a linear model proposes them (76), and the cost `reachable` by them.
    `left` (1 + q + m,): what is left of the data, as coefficients of data, nuisances and the units `wanted`.
    """

    selection: tuple[Selected, ...]
    cost: float
    nuisance: Array
    moves: Array
    reachable: float
    wanted: list[Wanted]
    left: Array


class _Units:
    """Units of a set of effects: `wanted`, and which are each effect's rows, tangents and other shapes.

    Of the columns whose products `Problem.products` gives: the data, the nuisances, and the units.
    """

    def __init__(self, problem: Problem, selection: Sequence[Selected]):
        self.wanted: list[Wanted] = []
        self._first = 1 + problem.nuisance.shape[1]
        self.rows = [self._taken(problem.wanted_rows([c])) for c in selection]
        self.tangents = [self._taken(problem.wanted_tangents([c])) for c in selection]
        self.shapes = [self._taken(problem.wanted_shapes(c)) for c in selection]

    def _taken(self, wanted: Sequence[Wanted]) -> slice:
        first = self._first + len(self.wanted)
        self.wanted += wanted
        return slice(first, first + len(wanted))


def _evaluate(problem: Problem, selection: tuple[Selected, ...], units: _Units) -> _Evaluated:
    """Cost of effects as they are, all by products of columns: those of many rows are taken once, by `Gram`."""
    G, q = problem.products(units.wanted), problem.nuisance.shape[1]
    columns = np.eye(len(G))
    residual, tangents = columns[0], np.concatenate([columns[:0], *(columns[t] for t in units.tangents)])
    soft = [columns[1 : 1 + q]]
    for selected, rows, own, shapes in zip(selection, units.rows, units.tangents, units.shapes, strict=True):
        explained = np.array(factors_of(selected)) @ columns[rows]
        residual = residual - explained
        size = math.sqrt(max(float(explained @ G @ explained), 0.0))
        soft.append(DISCREPANCY_SHARE * size * _beyond(columns[shapes], columns[own], G))
    N = np.concatenate(soft)
    A, b = N @ G @ N.T, N @ G @ residual
    A += np.diag(1.0 + ROUNDING * len(N) * (np.abs(N) @ np.sqrt(np.maximum(np.diag(G), 0.0))) ** 2)
    L = np.linalg.cholesky(A)
    x = np.linalg.solve(L.T, np.linalg.solve(L, b))
    left = residual - x @ N
    # Of the nuisances' determinant a constant part is the same for all selected effects.
    cost = 0.5 * float(residual @ G @ residual - b @ x) + float(np.log(np.diag(L)).sum())
    off, weight = _measured(selection)
    cost += 0.5 * float(off @ (weight * off))
    if not len(tangents):
        return _Evaluated(selection, cost, x[:q], off, cost, units.wanted, left)
    # In the directions that nuisances and shapes leave.
    priors, C = np.concatenate([precisions(c) for c in selection]) + weight, N @ G @ tangents.T
    inverse = _inverse(tangents @ G @ tangents.T - C.T @ np.linalg.solve(A, C) + np.diag(priors))
    g = tangents @ G @ left - weight * off
    moves = inverse @ g
    reachable = cost - 0.5 * float(g @ moves)
    return _Evaluated(_with_covariance(selection, inverse), cost, x[:q], moves, reachable, units.wanted, left)


def _beyond(shapes: Array, tangents: Array, G: Array) -> Array:
    """Shapes (s, p) of norm 1, less what tangents (k, p) can make of them; of columns whose products are G (p, p)."""
    norms = np.sqrt(np.maximum(np.sum(shapes @ G * shapes, axis=1), 0.0))
    F: Array = shapes[norms > 0.0] / norms[norms > 0.0, None]
    if F.size and tangents.size:
        F = F - F @ G @ tangents.T @ _inverse(tangents @ G @ tangents.T) @ tangents
    return F


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


def joint_covariance(problem: Problem, fit: Fit) -> Array:
    """Covariance (q + k, q + k) of the nuisances' coefficients and the free parameters of a fit."""
    columns = np.column_stack([problem.nuisance, problem.tangents(fit.selection)])
    priors = np.concatenate([np.ones(problem.nuisance.shape[1]), *(precisions(c) for c in fit.selection)])
    return _inverse(columns.T @ columns + np.diag(priors))


def _inverse(S: Array) -> Array:
    """Inverse of a symmetric matrix (k, k), 0 for what is not seen."""
    if len(S) == 1:
        return np.where(S > UNSEEN, 1.0 / np.maximum(S, UNSEEN), 0.0)
    scale: Array = np.where(np.diag(S) > UNSEEN, 1.0 / np.sqrt(np.maximum(np.diag(S), UNSEEN)), 0.0)
    inverse: Array = np.linalg.pinv(S * scale[:, None] * scale, rcond=1e-10, hermitian=True) * scale[:, None] * scale
    return inverse


def discrepancies(problem: Problem, selected: Selected) -> Array:
    """Other shapes of an effect's cause (r, s), as large as they may be, less what its own parameters can make of them.

    What is left of them cannot be traded for the parameters: they keep their meaning. (75)
    """
    F, T = problem.unit_shapes(selected).T, problem.tangents([selected]).T
    if F.size and T.size:
        F = F - F @ T.T @ _inverse(T @ T.T) @ T
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
