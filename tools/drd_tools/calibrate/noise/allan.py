"""The Allan deviation of a gyro's rate, and the five-term noise model fitted to it (IEEE Std 952). SI and radians.

Terms and units: Q quantisation (rad), N angle random walk (rad/sqrt(s)), B bias instability (rad/s), K rate random
walk (rad/s/sqrt(s)), R rate ramp (rad/s^2).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final

import allantools
import numpy as np
import numpy.typing as npt
from allantools.ci import confidence_interval, edf_greenhall

from drd.arrays import Array

TERMS: Final = "QNBKR"
Q, N, B, K, R = range(5)
FLOOR: Final = 2.0 * math.log(2.0) / math.pi  # Allan variance of flicker with B = 1: a floor at 0.664 B
# Power-law exponent of the frequency noise with the slope of each term, for the degrees of freedom.
ALPHA: Final = (2, 0, -1, -2, -2)
CONFIDENCE: Final = 0.90
# Averages over more than a third of the log have at most about two independent differences.
LONGEST_PART: Final = 3
# Number of blocks that the log is cut into for long averaging times; the intervals are simulated with as many.
MAX_BLOCKS: Final = 8192
ITERATIONS: Final = 4
# Slopes of the curve are compared if known to 0.2; a difference must exceed twice its standard deviation.
TELLING_EDF: Final = 300.0
SURELY: Final = 2.0
OCTAVE: Final = 2  # averaging times
# A unit of variance far below any gyro's, so that a curve of zeros has a finite weight.
TINY: Final = 1e-40


@dataclass(frozen=True)
class Curve:
    """Overlapping Allan deviation at `factors * interval_s`, shape (k,), with 90 % limits. rad/s and s.

    It begins where a filter in the gyro no longer shows, or at a single sample if there is no filter.
    `edf`: degrees of freedom of each point if the noise were each of TERMS, shape (k, 5). `block`: averaging factors
    of this size and more are whole multiples of it.
    """

    interval_s: float
    count: int
    block: int
    factors: npt.NDArray[np.int64]
    deviation: Array
    low: Array
    high: Array
    edf: Array

    @property
    def tau_s(self) -> Array:
        """Averaging times, s."""
        return np.asarray(self.factors * self.interval_s)


@dataclass(frozen=True)
class Fit:
    """Squared coefficients of TERMS (SI), shape (5,), the terms that were fitted, and the model's variance."""

    squares: Array
    terms: tuple[int, ...]
    variance: Array


def shapes(tau_s: Array) -> Array:
    """Allan variance of each term with coefficient 1, shape (k, 5). (49)"""
    one = np.ones_like(tau_s)
    return np.stack([3.0 / tau_s**2, 1.0 / tau_s, FLOOR * one, tau_s / 3.0, tau_s**2 / 2.0], axis=-1)


def averaging_factors(count: int) -> tuple[npt.NDArray[np.int64], int]:
    """Two averaging factors per octave up to a third of the samples, and the block of which long ones are multiples."""
    block = -(-count // MAX_BLOCKS)
    half_octaves = np.unique(np.round(2.0 ** (0.5 * np.arange(64))).astype(np.int64))
    short = half_octaves[half_octaves < block]
    longer = half_octaves[half_octaves <= count // block // LONGEST_PART]
    return np.concatenate([short, block * longer]), block


def allan_curve(rate_rad_s: Array, interval_s: float) -> Curve:
    """Compute the curve of evenly spaced means of the rate, shape (n,). Raises ValueError if n < 30."""
    count = len(rate_rad_s)
    if count < 30:
        raise ValueError(f"{count} samples are too few for an Allan deviation")
    factors, block = averaging_factors(count)
    # The library integrates the rates, so a large bias would cost digits.
    centred = rate_rad_s - rate_rad_s.mean()
    found = allantools.oadev(centred, rate=1.0, data_type="freq", taus=factors.astype(float))
    deviation = np.asarray(found[1]) if len(found[1]) == len(factors) else np.zeros(len(factors))
    edf = degrees_of_freedom(count, tuple(map(int, factors)))
    first = unfiltered(np.asarray(factors * interval_s), deviation**2, edf[:, N])
    factors, deviation, edf = factors[first:], deviation[first:], edf[first:]
    shape = shapes(np.asarray(factors * interval_s))
    largest = np.argmax(shape * fit(shape, deviation**2, edf, (Q, N, B, K)).squares, axis=-1)
    chosen = edf[np.arange(len(edf)), largest]
    limits = np.array([confidence_interval(d, e, CONFIDENCE) for d, e in zip(deviation, chosen, strict=True)])
    return Curve(interval_s, count, block, factors, deviation, limits[:, 0], limits[:, 1], edf)


def unfiltered(tau_s: Array, variance: Array, edf: Array) -> int:
    """Index of the first averaging time whose variance no filter in the gyro has reduced. Shape (k,) each. (49)

    The model, a sum of powers, is convex in logarithms: it falls fastest at the shortest times. If a curve falls
    faster later, a low pass has removed noise at the shorter times; its effect halves with each octave.
    """
    log_tau, log_variance = np.log(tau_s), np.log(np.maximum(variance, TINY))
    octave = log_tau[OCTAVE:] - log_tau[:-OCTAVE]
    slope = (log_variance[OCTAVE:] - log_variance[:-OCTAVE]) / octave
    margin = SURELY * np.sqrt(2.0 / edf[OCTAVE:] + 2.0 / edf[:-OCTAVE]) / octave
    telling = edf[OCTAVE:] >= TELLING_EDF
    if not telling.any():
        return 0
    steepest = np.minimum.accumulate((slope + margin)[telling][::-1])[::-1]
    first = int(np.argmax((slope - margin)[telling] <= steepest))
    return first + OCTAVE if first else 0


def degrees_of_freedom(count: int, factors: Sequence[int]) -> Array:
    """Equivalent degrees of freedom per averaging factor and term, shape (k, 5). Greenhall and Riley (2003)."""
    points = count + 1
    table = np.empty((len(factors), len(ALPHA)))
    for row, m in enumerate(factors):
        for column, alpha in enumerate(ALPHA):
            try:
                table[row, column] = edf_greenhall(alpha, 2, m, points, overlapping=True, modified=False)
            except NotImplementedError:  # quantisation at long averaging times, where it never dominates
                table[row, column] = edf_greenhall(0, 2, m, points, overlapping=True, modified=False)
    # No gyro follows the model to much better than 2 %: without a cap the shortest times would dominate.
    return np.clip(table, 1.0, MAX_BLOCKS / 2)


def fit(shape: Array, measured: Array, edf: Array, terms: Sequence[int], fixed: Any = 0.0) -> Fit:
    """Non-negative weighted least squares of the Allan variance, which is linear in the squared coefficients. (49)

    `measured`: variances, shape (..., k), many curves at once. `fixed`: variance that is given, not fitted. The
    weight of a point is edf / (2 variance^2), where the variance is the model's, found by iteration: the measured
    one would favour points that are low by chance.
    """
    columns, chosen = list(terms), np.arange(shape.shape[0])
    variance = np.maximum(measured, TINY)
    points_edf = edf[:, N]
    squares = np.zeros((*measured.shape[:-1], len(TERMS)))
    for _ in range(ITERATIONS):
        weight = np.sqrt(points_edf / 2.0) / variance
        squares[..., columns] = nonnegative(shape[:, columns], measured - fixed, weight)
        parts = shape * squares[..., None, :]
        variance = np.maximum(parts.sum(axis=-1) + fixed, 1e-3 * measured + TINY)
        points_edf = edf[chosen, np.argmax(parts, axis=-1)]
    return Fit(squares, tuple(terms), variance)


def nonnegative(A: Array, y: Array, weight: Array) -> Array:
    """Find x >= 0 that minimises |weight (A x - y)|^2, for many y at once: y, weight (..., k), A (k, p), x (..., p).

    The optimum is the ordinary solution on its support, so with p <= 5 all supports are tried. scipy's nnls solves
    for one y at a time; the intervals need thousands.
    """
    scale = 1.0 / np.sqrt(np.mean((weight[..., None] * A) ** 2, axis=-2))
    design = weight[..., None] * A * scale[..., None, :]
    G = np.einsum("...ki,...kj->...ij", design, design)
    h = np.einsum("...ki,...k->...i", design, weight * y)
    best, x = np.zeros(y.shape[:-1]), np.zeros(h.shape)
    for size in range(1, A.shape[1] + 1):
        for support in map(list, combinations(range(A.shape[1]), size)):
            part = G[..., support, :][..., support] + 1e-12 * len(A) * np.eye(size)
            solution = np.linalg.solve(part, h[..., support, None])[..., 0]
            gain = np.where((solution >= 0.0).all(axis=-1), (solution * h[..., support]).sum(axis=-1), -np.inf)
            better = gain > best
            best = np.where(better, gain, best)
            candidate = np.zeros(h.shape)
            candidate[..., support] = solution
            x = np.where(better[..., None], candidate, x)
    return np.asarray(x * scale)
