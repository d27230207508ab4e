"""Tests of a selected effect: family-wise against chance, and on data to which it was not fitted."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import FREE, Fit, free_columns, refine, shape_columns
from drd_tools.diagnose.select.library import Library, is_plausible
from drd_tools.diagnose.selected import Selected

BLOCK_S: Final = 20.0  # longer than slip and references are correlated, (78): signs of blocks are exchangeable
FLIPS: Final = 999  # p is a multiple of 0.001: finer than any threshold on it
SEGMENTS: Final = 10  # five in each half: both contain windows of time and slow changes
LEAST_SEEN: Final = 0.01  # of an effect's square, outside the time at which it is most visible
LARGEST_NATS: Final = 690.0  # exp of more overflows
LEAST_NORM: Final = 1e-100  # of a column: a smaller one is unobserved, and scaling it would overflow
SEED: Final = 20  # any: the same recording gives the same p


def blocks(problem: Problem) -> npt.NDArray[np.intp]:
    """Index of the block of BLOCK_S that contains each whitened row, (r,)."""
    t = problem.row_time_s
    return np.asarray((t - t.min()) / BLOCK_S, np.intp)


def chance_gains(problem: Problem, library: Library, left: Array, name: str = "") -> Array:
    """Largest gain of any candidate by chance, (FLIPS,), nats, under random flips of the signs of blocks.

    Flipping whole blocks keeps the likelihood of noise, but destroys an effect that persists over blocks. (84)
    `name`: of the only effect that was searched for; by default the whole catalogue was.
    """
    columns, square = library.columns, np.diag(library.products)
    if name:
        own = sorted({i for c in library.candidates if c.effect.id == name for i in c.columns})
        columns, square = columns[:, own], square[own]
    if not columns.size:
        return np.zeros(FLIPS)
    index = blocks(problem)
    B = np.stack([columns[index == b].T @ left[index == b].astype(np.float32) for b in np.unique(index)])
    diagonal = np.maximum(square.astype(float), 1e-30)
    signs = np.random.default_rng(SEED).choice((-1.0, 1.0), (FLIPS, len(B)))
    result: Array = (0.5 * (signs @ B) ** 2 / diagonal).max(axis=1)
    return result


def family_wise_p(gain: float, chance: Array) -> float:
    """Probability that some candidate gains as much by chance alone."""
    return float((1 + (chance >= gain).sum()) / (1 + len(chance)))


class OtherHalf:
    """Predictive test of a selected effect: fitted to each half of the data, evaluated on the other. (85)

    The halves are alternating segments of equal visibility, so that an effect of one window is tested inside it. The
    other selected effects are predicted from the same half, with and without the tested one.
    """

    def __init__(self, problem: Problem, library: Library, fit: Fit, selected: Selected):
        self.selected = selected
        self._problem, self._library, self._fit = problem, library, fit

    @cached_property
    def nats(self) -> tuple[float, float]:
        """Log likelihood ratio of the effect on each half; 0 if it is visible in neither."""
        return _on_each(self._halves, partial(_nats, self._library, self.selected))

    def curve_nats(self, columns: Array) -> tuple[float, float]:
        """Log likelihood ratio of a curve in the effect's place, on each half; `columns` (r, k): of prior 1."""
        return _on_each(self._halves, partial(_curve_nats, columns))

    @cached_property
    def _halves(self) -> "tuple[_Half, _Half] | None":
        others = [c for c in self._fit.selection if c is not self.selected]
        return _split(self._problem, others, self._problem.effect_rows([self.selected]))


def curve_nats(problem: Problem, fit: Fit, rows: Array, columns: Array) -> tuple[float, float]:
    """Log likelihood ratio of a curve beside all effects of a fit, on each half as predicted from the other. (85)

    `rows` (r,): data that it explains; `columns` (r, k): its basis, of prior 1.
    """
    return _on_each(_split(problem, fit.selection, rows), partial(_curve_nats, columns))


class _Half(NamedTuple):
    """Half of the data: its problem, its rows among all, columns of this half alone, and columns common to both."""

    problem: Problem
    rows: npt.NDArray[np.bool_]
    soft: Array
    freed: Array


def _on_each(halves: tuple[_Half, _Half] | None, nats: Callable[[_Half, _Half], float]) -> tuple[float, float]:
    """Nats of each half as predicted from the other; 0 if there are no halves."""
    return (0.0, 0.0) if halves is None else (nats(halves[0], halves[1]), nats(halves[1], halves[0]))


def _split(problem: Problem, others: Sequence[Selected], rows: Array) -> tuple[_Half, _Half] | None:
    """Halves, less the other effects, of segments in which `rows` (r,) are equally visible; None if they are visible
    nowhere or at one time only: the components of a single fix do not confirm each other.
    """
    data = problem.data - problem.effect_rows(others)
    soft, freed = shape_columns(problem, others), free_columns(problem, others)
    _, at = np.unique(problem.row_time_s, return_inverse=True)
    visible = np.bincount(at, rows**2)
    total = np.cumsum(visible)
    if total[-1] - visible.max() <= LEAST_SEEN * total[-1]:
        return None
    half = (np.minimum(total / total[-1] * SEGMENTS, SEGMENTS - 1e-9).astype(int) % 2).astype(bool)[at]
    held = np.column_stack([soft, freed])
    first, second = (_Half(problem.part(rows, data, held), rows, soft[rows], freed[rows]) for rows in (half, ~half))
    return first, second


def _nats(library: Library, selected: Selected, train: _Half, test: _Half) -> float:
    """Log likelihood ratio of the effect on `test`, as learned from `train`; 0 if `train` does not show it.

    The uncertainty of the learned parameters is integrated out: little data predict little. (85)
    """
    part = train.problem
    if selected.begin_s is None:
        found = _relearned(part, library, train.rows, selected)
        choices = 1
    else:
        # Half of the data cannot determine an interval's edges: keep them, and charge for the choice of its place.
        found = _resized(part, selected)
        choices = max(1, sum(c.effect.id == selected.id for c in library.candidates))
    if found is None:
        return 0.0
    T = [h.problem.tangents([found]) if found.free else np.zeros((len(h.soft), 0)) for h in (train, test)]
    norms = np.linalg.norm(T[0], axis=0)
    scale = np.divide(FREE, norms, out=np.zeros_like(norms), where=norms > LEAST_NORM)
    left = [h.problem.data - h.problem.effect_rows([found]) for h in (train, test)]
    return _log_ratio(train, test, [t * scale for t in T], left) - math.log(choices)


def _curve_nats(columns: Array, train: _Half, test: _Half) -> float:
    """Log likelihood ratio of a curve on `test`, as learned from `train`."""
    halves = train, test
    return _log_ratio(train, test, [columns[h.rows] for h in halves], [h.problem.data for h in halves])


def _log_ratio(train: _Half, test: _Half, columns: Sequence[Array], left: Sequence[Array]) -> float:
    """Log likelihood ratio on `test`, as learned from `train`, of the residual `left` with these columns over the data.

    `columns`, `left`: of both halves; the columns' prior is 1.
    """
    with_it = _predicted(train.soft, np.column_stack([train.freed, columns[0]]), left[0])
    without = _predicted(train.soft, train.freed, train.problem.data)
    nats = with_it(test.soft, np.column_stack([test.freed, columns[1]]), left[1])
    return nats - without(test.soft, test.freed, test.problem.data)


def _predicted(soft: Array, freed: Array, left: Array) -> Callable[[Array, Array, Array], float]:
    """Predictive log likelihood of other rows, with the posterior of the coefficients of `freed` (r, k), of prior 1."""
    M = Marginal(soft).projected(np.column_stack([freed, left]))
    P = np.linalg.inv(np.eye(freed.shape[1]) + freed.T @ M[:, :-1])
    mean, root = P @ (freed.T @ M[:, -1]), _root(0.5 * (P + P.T))

    def nats(soft: Array, freed: Array, left: Array) -> float:
        return Marginal(np.column_stack([soft, freed @ root])).nats(left - freed @ mean)

    return nats


def _root(P: Array) -> Array:
    """Square root of a covariance (k, k), which may be singular."""
    values, vectors = np.linalg.eigh(P)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def _resized(part: Problem, selected: Selected) -> Selected:
    """The selected effect with its linear parameters refitted to a part of the data."""
    free = tuple(name for name in selected.free if selected.parameter(name).linear)
    return refine(part, [replace(selected, free=free)]).selection[0]


def _relearned(part: Problem, library: Library, train: npt.NDArray[np.bool_], selected: Selected) -> Selected | None:
    """The selected effect as learned from a part of the data alone: its best variant in the library, refined."""
    best, most = None, 0.0
    variants = [c for c in library.candidates if c.effect.id == selected.id]
    index = sorted({i for c in variants for i in c.columns})
    columns = library.columns[:, index][train].astype(float)
    left = Marginal(part.nuisance).projected(np.column_stack([columns, part.data]))
    G, b = columns.T @ left[:, :-1], columns.T @ left[:, -1]
    for variant in variants:
        at = [index.index(i) for i in variant.columns]
        gain, found = variant.fitted(G[np.ix_(at, at)], b[at], selected.prior)
        if gain > most and found is not None and found.free == selected.free:
            best, most = found, gain
    if best is None:
        return None
    refined = refine(part, [best]).selection[0]
    return refined if is_plausible(refined, selected.prior) else best


def e_value(nats: tuple[float, float]) -> float:
    """Mean of the two likelihood ratios: an e-value (Vovk and Wang 2021)."""
    return float(np.mean([math.exp(min(n, LARGEST_NATS)) for n in nats]))


def gain_over_time(problem: Problem, fit: Fit, selected: Selected) -> tuple[Array, Array]:
    """Cumulative gain of a selected effect, nats, at the ends of the blocks."""
    effect = problem.effect_rows([selected])
    gains = effect * (fit.left + effect) - 0.5 * effect**2
    index = blocks(problem)
    per_block = np.bincount(index, gains)
    start = float(problem.row_time_s.min())
    return start + BLOCK_S * np.arange(1.0, len(per_block) + 1.0), np.asarray(np.cumsum(per_block), float)


def rms_per_block(problem: Problem, left: Array) -> tuple[Array, Array]:
    """Rms of whitened rows per block, at the middles of the blocks."""
    index = blocks(problem)
    count = np.bincount(index)
    start = float(problem.row_time_s.min())
    size: Array = np.sqrt(np.bincount(index, left**2) / np.maximum(count, 1))
    return start + BLOCK_S * np.arange(0.5, len(size) + 0.5), size


def unseen_rms(problem: Problem, fit: Fit) -> tuple[float, float]:
    """Cross-validated rms of the whitened data without and with the effects, each half fitted to the other.

    The halves are alternating blocks.
    """
    odd = (blocks(problem) % 2).astype(bool)
    found = []
    for selection in ((), fit.selection):
        left = problem.data.copy()
        for train in (odd, ~odd):
            known, test = refine(problem.part(train, problem.data), selection), problem.part(~train, problem.data)
            left[~train] -= test.effect_rows(known.selection) + test.nuisance @ known.nuisance
        found.append(rms(left))
    return found[0], found[1]


def rms(rows: Array) -> float:
    """Root mean square; 0 of no rows."""
    return float(np.sqrt(np.mean(rows**2))) if len(rows) else 0.0
