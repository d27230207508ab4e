"""Robust measures of scatter."""

import math

import numpy as np

from drd.arrays import Array


def deviation(values: Array, about: float | None = None) -> float:
    """Standard deviation from the median absolute deviation about `about`, by default the values' median."""
    middle = np.median(values) if about is None else about
    return 1.4826 * float(np.median(np.abs(values - middle)))  # for a Gaussian


def scatter(rows: Array) -> float:
    """Standard deviation of the white noise of a smooth path's rows (n,) or (n, k); 0 for fewer than three.

    The second difference of three rows has six times their variance.
    """
    return deviation(np.diff(rows, n=2, axis=0)) / math.sqrt(6.0) if len(rows) > 2 else 0.0
