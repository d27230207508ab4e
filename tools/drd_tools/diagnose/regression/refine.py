"""Fit the parameters of effects jointly by Gauss-Newton steps, bounded where the model is nonlinear."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem, Wanted, factors_of
from drd_tools.diagnose.selected import Selected

ROUNDS: Final = 12  # at most, fewer on convergence: limits the time
ENOUGH_NATS: Final = 0.02  # converged if a full step gains less
LONGER, SHORTEST = 3.0, 0.05  # bounds of the next step length over the last, after success and failure
FAIR_ROUNDS: Final = 2  # before a set of effects may be given up
HOPELESS_NATS: Final = 30.0  # shortfall of a score from the target, after the step of the linear model
CLEAR_ROUNDS: Final = 3  # after so many rounds, give up if
HOPED: Final = 5.0  # times the gain that the linear model still predicts is not enough
PRIOR_SIZES: Final = 3.0  # prior sigma of a parameter, in its largest plausible sizes
ROUNDING: Final = 1e-14  # of the columns' products: if counters leap by a kilometre it exceeds their priors
UNSEEN: Final = 1e-60  # square of a column of rounding errors only: its inverse would overflow
FREE: Final = 1e6  # prior sigma, in the data's sigmas, of practically free parameters
DISCREPANCY_SHARE: Final = 0.15  # of an effect's size: how wrong its catalogue form is taken to be


@dataclass(frozen=True)
class Fit:
    """Selected effects with fitted parameters.

    `cost`: negative log likelihood, nats, of the data, with nuisances and other shapes integrated out.
    `nuisance`: coefficients in units of their priors. `left` (r,): whitened data less effects, nuisances and shapes.
    """

    selection: tuple[Selected, ...]
    cost: float
    nuisance: Array
    left: Array


def refine(problem: Problem, selection: Sequence[Selected]) -> Fit:
    """Improve the parameters until the cost converges."""
    return refine_all(problem, [selection])[0]


def refine_all(problem: Problem, sets: Sequence[Sequence[Selected]], least: float = -math.inf) -> list[Fit]:
    """Refine several sets of effects together: whitening all sensitivities at once costs little more than one.

    Sets that will clearly not reach the score `least` are abandoned early.
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
        self._share = 1.0  # of the moves: the step length
        self._gain = 0.0  # of the whole moves by the linear model, nats
        self.done = False

    def _set_out(self, selection: tuple[Selected, ...]) -> None:
        self._current, self.units = selection, _Units(self._problem, selection)

    def _is_hopeless(self, cost: float) -> bool:
        if self._rounds >= CLEAR_ROUNDS and cost - HOPED * self._gain > self._enough:
            return True
        return self._rounds >= FAIR_ROUNDS and cost - self._gain > self._enough + HOPELESS_NATS

    @property
    def fit(self) -> Fit:
        """The best fit found."""
        best = self._best
        assert best is not None
        left = self._problem.combined(best.left, best.wanted)
        return Fit(best.selection, best.cost, best.nuisance, left)

    def step(self) -> None:
        """Evaluate the current parameters, and choose the next."""
        tried = _evaluate(self._problem, self._current, self.units)
        self._rounds += 1
        if self._best is None or tried.cost < self._best.cost - 1e-9:
            # If the last moves were too long, the next ones probably are, too.
            self._best, self._moves, self._share = tried, tried.moves, min(1.0, LONGER * self._share)
            self._gain = tried.cost - tried.reachable
            self.done = self._is_hopeless(tried.cost)
        else:
            # Minimum of the parabola through both costs, with the slope of the linear model.
            least = self._share * self._gain / (tried.cost - self._best.cost + 2.0 * self._share * self._gain)
            self._share *= min(max(least, SHORTEST), 0.5)
        self.done = self.done or self._share * self._gain < ENOUGH_NATS
        if not self.done:
            self._set_out(_moved(self._best.selection, self._moves * self._share))


class _Evaluated(NamedTuple):
    """Cost of effects at given parameters, nats (74), and the nuisances' coefficients (q,).

    `moves` (k,): Gauss-Newton step of the free parameters (76). `reachable`: its cost by the linear model.
    `left` (1 + q + m,): the residual, as coefficients of data, nuisances and the units `wanted`.
    """

    selection: tuple[Selected, ...]
    cost: float
    nuisance: Array
    moves: Array
    reachable: float
    wanted: list[Wanted]
    left: Array


class _Units:
    """Units `wanted` of a set of effects, and which of them are each effect's rows, tangents and other shapes.

    Slices count the columns of `Problem.products`: the data, the nuisances, and the units.
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
    """Evaluate effects at their parameters from products of columns, which `Gram` computes over the rows once."""
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
    # The nuisances' determinant includes a constant part, the same for every selection.
    cost = 0.5 * float(residual @ G @ residual - b @ x) + float(np.log(np.diag(L)).sum())
    off, weight = _measured(selection)
    cost += 0.5 * float(off @ (weight * off))
    if not len(tangents):
        return _Evaluated(selection, cost, x[:q], off, cost, units.wanted, left)
    # Projected off nuisances and shapes.
    priors, C = np.concatenate([precisions(c) for c in selection]) + weight, N @ G @ tangents.T
    inverse = _inverse(tangents @ G @ tangents.T - C.T @ np.linalg.solve(A, C) + np.diag(priors))
    g = tangents @ G @ left - weight * off
    moves = inverse @ g
    reachable = cost - 0.5 * float(g @ moves)
    return _Evaluated(_with_covariance(selection, inverse), cost, x[:q], moves, reachable, units.wanted, left)


def _beyond(shapes: Array, tangents: Array, G: Array) -> Array:
    """Shapes (s, p), scaled to norm 1, less their projection on tangents (k, p); G (p, p): products of the columns."""
    norms = np.sqrt(np.maximum(np.sum(shapes @ G * shapes, axis=1), 0.0))
    F: Array = shapes[norms > 0.0] / norms[norms > 0.0, None]
    if F.size and tangents.size:
        F = F - F @ G @ tangents.T @ _inverse(tangents @ G @ tangents.T) @ tangents
    return F


class Response(NamedTuple):
    """Uncertainty of the effects' free parameters (k,), in the order of the selected effects.

    `covariance` (k, k). `discrepancy_shapes` (k, s): displacement of the parameters by other shapes of the effects'
    causes, each as large as its effect.
    """

    covariance: Array
    discrepancy_shapes: Array


def response(problem: Problem, fit: Fit) -> Response:
    """Compute the response of a fit's parameters."""
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
    """Inverse of a symmetric matrix (k, k), 0 for unobserved parameters."""
    if len(S) == 1:
        return np.where(S > UNSEEN, 1.0 / np.maximum(S, UNSEEN), 0.0)
    scale: Array = np.where(np.diag(S) > UNSEEN, 1.0 / np.sqrt(np.maximum(np.diag(S), UNSEEN)), 0.0)
    inverse: Array = np.linalg.pinv(S * scale[:, None] * scale, rcond=1e-10, hermitian=True) * scale[:, None] * scale
    return inverse


def discrepancies(problem: Problem, selected: Selected) -> Array:
    """Model discrepancy of an effect (r, s): other shapes of its cause, less their projection on its own tangents.

    The remainder is orthogonal to the parameters, which therefore keep their meaning. (75)
    """
    F, T = problem.unit_shapes(selected).T, problem.tangents([selected]).T
    if F.size and T.size:
        F = F - F @ T.T @ _inverse(T @ T.T) @ T
    return DISCREPANCY_SHARE * float(np.linalg.norm(problem.effect_rows([selected]))) * F.T


def shape_columns(problem: Problem, selection: Sequence[Selected]) -> Array:
    """Shapes of the effects' causes as columns of prior 1, (r, s)."""
    return np.column_stack([np.zeros((len(problem.data), 0)), *(discrepancies(problem, c) for c in selection)])


def free_columns(problem: Problem, selection: Sequence[Selected]) -> Array:
    """Nuisances and practically free parameters as columns of prior 1, (r, k)."""
    T = problem.tangents(selection)
    norms = np.linalg.norm(T, axis=0)
    seen = norms > 0.0
    return np.column_stack([problem.nuisance, T[:, seen] / norms[seen] * FREE])


def nuisance_design(problem: Problem, selection: Sequence[Selected]) -> Array:
    """`shape_columns` and `free_columns` (r, s + k)."""
    return np.column_stack([shape_columns(problem, selection), free_columns(problem, selection)])


def with_priors(problem: Problem, selection: Sequence[Selected]) -> tuple[Array, Array]:
    """`nuisance_design`, but parameters that were measured have their priors; and the data less the effects (r,), at
    the means of those.
    """
    T, (off, weight) = problem.tangents(selection), _measured(selection)
    sizes = FREE / np.maximum(np.linalg.norm(T, axis=0), math.sqrt(UNSEEN))
    sizes[weight > 0.0] = weight[weight > 0.0] ** -0.5
    left = problem.data - problem.effect_rows(selection) + T @ off
    return np.column_stack([shape_columns(problem, selection), problem.nuisance, T * sizes]), left


def precisions(selected: Selected) -> Array:
    """Inverse prior variances (k,) of the free parameters, from their plausible sizes."""
    sizes = [max(PRIOR_SIZES * q.high * q.si, 1e-30) for q in map(selected.parameter, selected.free)]
    return 1.0 / np.array(sizes) ** 2


def _measured(selection: Sequence[Selected]) -> tuple[Array, Array]:
    """Differences (k,) of the free parameters from their measured priors, and the inverse variances of those."""
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
    """Apply the moves, bounded where the model is nonlinear."""
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
