"""Adaptive smoothing: as wide as the noise requires and the signal allows."""

from functools import lru_cache
from typing import Final

import numpy as np
from scipy.fft import dct, idct, rfft

from drd.arrays import Array

# Noise on a nearly constant signal must not be mistaken for a change: each width doubles the last.
WIDTHS: Final = 5
AGREE_SIGMAS: Final = 2.5  # of the mean: 1 % of a constant signal keeps a narrower window
REACH: Final = 4.0  # sigmas
MOST_KEPT: Final = 32  # Gaussians: those of a recording's speeds and turns


def denoised(values: Array, sigma: Array | float, width: float, widths: int = WIDTHS) -> Array:
    """Smooth values (n,) with white noise of deviation `sigma` (n,), through Gaussians of at least `width` samples.

    Each sample gets the widest window whose mean agrees with those of all narrower ones (the intersection of confidence
    intervals: Goldenshluger and Nemirovski 1997).
    """
    n = len(values)
    variance = np.broadcast_to(np.asarray(sigma, float) ** 2, values.shape)
    # A series mirrored at its ends is a sum of cosines; smoothing multiplies each by a factor.
    cosines = dct(np.stack([values, variance]))
    result = values
    low, high = np.full(n, -np.inf), np.full(n, np.inf)
    agrees = np.ones(n, bool)
    for doubling in range(widths):
        s = width * 2.0**doubling
        if doubling and 4.0 * s > n:
            break
        mean, spread = idct(cosines * _gaussian(n, s))
        # Standard error of a mean with Gaussian weights of deviation s samples.
        error = AGREE_SIGMAS * np.sqrt(np.maximum(spread, 0.0) / (2.0 * np.sqrt(np.pi) * s))
        low, high = np.maximum(low, mean - error), np.minimum(high, mean + error)
        agrees &= low <= high
        result = np.where(agrees, mean, result)
    # The result jumps where the window changes: smooth once more.
    return np.asarray(idct(dct(result) * _gaussian(n, 0.5 * width)), float)


@lru_cache(maxsize=MOST_KEPT)
def _gaussian(n: int, sigma: float) -> Array:
    """Frequency response, for each of n cosines, of a Gaussian of `sigma` samples cut off at REACH sigmas."""
    reach = int(REACH * sigma + 0.5)
    k = np.arange(-reach, reach + 1)
    weight = np.exp(-0.5 * (k / sigma) ** 2)
    around = np.bincount(k % (2 * n), weight / weight.sum(), 2 * n)
    return np.asarray(rfft(around).real[:n], float)
