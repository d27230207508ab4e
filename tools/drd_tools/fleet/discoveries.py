"""Control of false discovery rates over a fleet: robots times effects make many tests. (107)"""

import numpy as np
import numpy.typing as npt

from drd.arrays import Array

Mask = npt.NDArray[np.bool_]


def benjamini_hochberg(p: Array, level: float) -> Mask:
    """Select the p-values, shape (n,), that are discoveries at a false discovery rate of `level` (1995)."""
    n = len(p)
    order = np.argsort(p)
    below = np.flatnonzero(p[order] <= level * np.arange(1, n + 1) / max(n, 1))
    found = np.zeros(n, bool)
    found[order[: below[-1] + 1 if len(below) else 0]] = True
    return found


def by_probability(probability: Array, level: float, least: float) -> Mask:
    """Select the posterior probabilities, shape (n,), to report: as many as keep the expected false discovery rate
    within `level`, and none below `least` (Newton et al. 2004)."""
    order = np.argsort(-probability, kind="stable")
    share = np.cumsum(1.0 - probability[order]) / np.arange(1, len(probability) + 1)
    found = np.zeros(len(probability), bool)
    found[order[share <= level]] = True
    return found & (probability >= least)
