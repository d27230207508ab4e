"""Tests of a selected effect: against chance anywhere in the catalogue, and on data it was not fitted to."""

import math
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, nuisance_design, refine
from drd_tools.diagnose.results import Array
from drd_tools.diagnose.select.library import Library, is_plausible
from drd_tools.diagnose.selected import Selected

BLOCK_S: Final = 20.0
FLIPS: Final = 999
SEGMENTS: Final = 10
LARGEST_NATS: Final = 690.0  # exp of more is no double
SEED: Final = 20


def blocks(problem: Problem) -> npt.NDArray[np.intp]:
    """Number of the block of BLOCK_S that each whitened row is in, (r,)."""
    t = problem.row_time_s
    return np.asarray((t - t.min()) / BLOCK_S, np.intp)


def chance_gains(problem: Problem, library: Library, left: Array) -> Array:
    """The most that any candidate gains where nothing is there, (FLIPS,), nats: blocks' signs are flipped at random.

    What is white keeps its likelihood when the signs of whole blocks change, and loses what hangs together.
    """
    if not library.columns.size:
        return np.zeros(FLIPS)
    index = blocks(problem)
    B = np.stack([library.columns[index == b].T @ left[index == b].astype(np.float32) for b in np.unique(index)])
    diagonal = np.maximum(np.diag(library.products).astype(float), 1e-30)
    signs = np.random.default_rng(SEED).choice((-1.0, 1.0), (FLIPS, len(B)))
    result: Array = (0.5 * (signs @ B) ** 2 / diagonal).max(axis=1)
    return result


def family_wise_p(gain: float, chance: Array) -> float:
    """Probability that chance alone gives any candidate such a gain."""
    return float((1 + (chance >= gain).sum()) / (1 + len(chance)))


def predictive_nats(problem: Problem, library: Library, fit: Fit, selected: Selected) -> tuple[float, float]:
    """Log likelihood ratio of a selected effect on each half of the data, its parameters found anew on the other half.

    The halves are alternating segments of equal visibility, so that an effect of one window is tested inside it. With
    and without the selected effect the nuisances, and the other selected effects, are fitted anew.
    """
    others = [c for c in fit.selection if c is not selected]
    data = problem.data - problem.effect_rows(others)
    held = nuisance_design(problem, others)
    seen = problem.effect_rows([selected]) ** 2
    order = np.argsort(problem.row_time_s, kind="stable")
    total = np.cumsum(seen[order])
    if total[-1] <= 0.0:
        return 0.0, 0.0
    half = np.zeros(len(data), bool)
    half[order] = (np.minimum(total / total[-1] * SEGMENTS, SEGMENTS - 1e-9).astype(int) % 2).astype(bool)
    parts = problem.part(half, data, held), problem.part(~half, data, held)
    return (
        _nats(library, selected, half, parts[0], parts[1]),
        _nats(library, selected, ~half, parts[1], parts[0]),
    )


def _nats(library: Library, selected: Selected, train: npt.NDArray[np.bool_], part: Problem, test: Problem) -> float:
    """Log likelihood ratio of the effect on `test`, as `part`, the rows `train`, has it; 0 where those show none.

    How well those know its parameters is integrated over: what was learned from little predicts little.
    """
    if selected.begin_s is None:
        found = _relearned(part, library, train, selected)
        choices = 1
    else:
        # Half of the data does not know where an interval ends: its place is kept, and the choice of it is paid for.
        found = _resized(part, selected)
        choices = max(1, sum(c.effect.id == selected.id for c in library.candidates))
    if found is None:
        return 0.0
    # A selected effect that was not refined has no covariance; it is taken as it is.
    T = test.tangents([found]) @ _root(found.covariance) if found.covariance.size else np.zeros((len(test.data), 0))
    effect = test.effect_rows([found])
    M = Marginal(test.nuisance).projected(np.column_stack([effect, test.data, T]))
    nats = float(effect @ M[:, 1]) - 0.5 * float(effect @ M[:, 0])
    A, b = np.eye(T.shape[1]) + T.T @ M[:, 2:], T.T @ (M[:, 1] - M[:, 0])
    nats += 0.5 * float(b @ np.linalg.solve(A, b)) - 0.5 * float(np.linalg.slogdet(A)[1])  # (61)
    return nats - math.log(choices)


def _root(P: Array) -> Array:
    """A root of a covariance (k, k), which may be singular."""
    values, vectors = np.linalg.eigh(P)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def _resized(part: Problem, selected: Selected) -> Selected:
    """The selected effect with the linear parameters that a part of the data gives it."""
    free = tuple(name for name in selected.free if selected.parameter(name).linear)
    return refine(part, [replace(selected, free=free)]).selection[0]


def _relearned(part: Problem, library: Library, train: npt.NDArray[np.bool_], selected: Selected) -> Selected | None:
    """The selected effect as a part of the data alone shows it: its best variant in the library, refined."""
    best, most = None, 0.0
    variants = [c for c in library.candidates if c.effect.id == selected.id]
    index = sorted({i for c in variants for i in c.columns})
    columns = library.columns[:, index][train].astype(float)
    left = Marginal(part.nuisance).projected(np.column_stack([columns, part.data]))
    G, b = columns.T @ left[:, :-1], columns.T @ left[:, -1]
    for variant in variants:
        at = [index.index(i) for i in variant.columns]
        gain, found = variant.fitted(G[np.ix_(at, at)], b[at])
        if gain > most and found is not None and found.free == selected.free:
            best, most = found, gain
    if best is None:
        return None
    refined = refine(part, [best]).selection[0]
    return refined if is_plausible(refined) else best


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
    """Rms of whitened rows per block, at the blocks' middles."""
    index = blocks(problem)
    count = np.bincount(index)
    start = float(problem.row_time_s.min())
    size: Array = np.sqrt(np.bincount(index, left**2) / np.maximum(count, 1))
    return start + BLOCK_S * np.arange(0.5, len(size) + 0.5), size


def unseen_rms(problem: Problem, fit: Fit) -> tuple[float, float]:
    """Rms of the whitened data without and with the effects; all that is fitted is that of the other half each time.

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
