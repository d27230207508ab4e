"""How sure a claim is: against chance anywhere in the catalogue, and on data it was not fitted to."""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from drd_tools.diagnose.library import Library
from drd_tools.diagnose.problem import Claim, Problem
from drd_tools.diagnose.refine import Fit

Array = npt.NDArray[np.float64]

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
    index = blocks(problem)
    B = np.stack([library.columns[index == b].T @ left[index == b].astype(np.float32) for b in np.unique(index)])
    diagonal = np.maximum(np.diag(library.products).astype(float), 1e-30)
    signs = np.random.default_rng(SEED).choice((-1.0, 1.0), (FLIPS, len(B)))
    result: Array = (0.5 * (signs @ B) ** 2 / diagonal).max(axis=1)
    return result


def family_wise_p(gain: float, chance: Array) -> float:
    """Probability that chance alone gives any candidate such a gain."""
    return float((1 + (chance >= gain).sum()) / (1 + len(chance)))


def unseen_nats(problem: Problem, fit: Fit, claim: Claim) -> tuple[float, float]:
    """Log likelihood ratio of a claim on each half of the data, its size fitted on the other half.

    The halves are alternating segments of equal visibility, so that an effect of one window is tested inside it.
    """
    effect = problem.effect_rows([claim])
    data = fit.left + effect
    order = np.argsort(problem.row_time_s, kind="stable")
    seen = np.cumsum(effect[order] ** 2)
    if seen[-1] <= 0.0:
        return 0.0, 0.0
    half = np.zeros(len(data), bool)
    half[order] = (np.minimum(seen / seen[-1] * SEGMENTS, SEGMENTS - 1e-9).astype(int) % 2).astype(bool)
    found = []
    for train, test in ((half, ~half), (~half, half)):
        size = float(effect[train] @ data[train]) / max(float(effect[train] @ effect[train]), 1e-30)
        test_gain = size * float(effect[test] @ data[test]) - 0.5 * size**2 * float(effect[test] @ effect[test])
        found.append(test_gain)
    return found[0], found[1]


def e_value(nats: tuple[float, float]) -> float:
    """Mean of the two likelihood ratios: an e-value (Vovk and Wang 2021)."""
    return float(np.mean([math.exp(min(n, LARGEST_NATS)) for n in nats]))


def gain_over_time(problem: Problem, fit: Fit, claim: Claim) -> tuple[Array, Array]:
    """Cumulative gain of a claim, nats, at the ends of the blocks."""
    effect = problem.effect_rows([claim])
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
    rms: Array = np.sqrt(np.bincount(index, left**2) / np.maximum(count, 1))
    return start + BLOCK_S * np.arange(0.5, len(rms) + 0.5), rms


def unseen_rms(problem: Problem, fit: Fit) -> tuple[float, float]:
    """Rms of the whitened data without claims, and with claims whose sizes were fitted on the other half each time."""
    effects = [problem.effect_rows([claim]) for claim in fit.claims]
    data = fit.left + sum(effects, np.zeros(len(fit.left)))
    if not effects or not len(data):
        rms = float(np.sqrt(np.mean(data**2))) if len(data) else 0.0
        return rms, rms
    E = np.column_stack(effects)
    odd = (blocks(problem) % 2).astype(bool)
    left = data.copy()
    for train, test in ((odd, ~odd), (~odd, odd)):
        size = np.linalg.lstsq(E[train], data[train], rcond=None)[0]
        left[test] -= E[test] @ size
    return float(np.sqrt(np.mean(data**2))), float(np.sqrt(np.mean(left**2)))
