"""Smoothing as wide as the noise asks for and the signal allows."""

from typing import Final

import numpy as np
from scipy.signal import oaconvolve

from drd_tools.diagnose.results import Array

# Of what is as good as constant, noise must not be taken for a change: each width doubles the last.
WIDEST: Final = 5
AGREE_SIGMAS: Final = 2.5  # of the mean: 1 % of what is constant keeps a narrower window
REACH: Final = 4.0  # sigmas


def denoised(values: Array, sigma: Array | float, width: float) -> Array:
    """Smooth values (n,) with white noise of deviation `sigma` (n,), through Gaussians of at least `width` samples.

    Each sample gets the widest window whose mean agrees with those of all narrower ones (the intersection of confidence
    intervals: Goldenshluger and Nemirovski 1997).
    """
    variance = np.broadcast_to(np.asarray(sigma, float) ** 2, values.shape)
    result = values
    low, high = np.full(len(values), -np.inf), np.full(len(values), np.inf)
    agrees = np.ones(len(values), bool)
    for doubling in range(WIDEST):
        s = width * 2.0**doubling
        if doubling and 4.0 * s > len(values):
            break
        mean = _gaussian(values, s)
        # Of a mean with Gaussian weights of deviation s samples.
        error = AGREE_SIGMAS * np.sqrt(np.maximum(_gaussian(variance, s), 0.0) / (2.0 * np.sqrt(np.pi) * s))
        low, high = np.maximum(low, mean - error), np.minimum(high, mean + error)
        agrees &= low <= high
        result = np.where(agrees, mean, result)
    # Where windows change, the means do not meet.
    return _gaussian(result, 0.5 * width)


def _gaussian(values: Array, sigma: float) -> Array:
    """Smooth by a Gaussian of `sigma` samples, mirrored at the ends; a wide one takes far less time by Fourier."""
    reach = int(REACH * sigma + 0.5)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    padded = np.pad(values, reach, mode="symmetric")
    return np.asarray(oaconvolve(padded, weight / weight.sum(), mode="valid"), float)
