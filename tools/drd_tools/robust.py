"""Robust measures of scatter."""

import numpy as np

from drd.arrays import Array


def deviation(values: Array, about: float | None = None) -> float:
    """Standard deviation from the median absolute deviation about `about`, by default the values' median."""
    middle = np.median(values) if about is None else about
    return 1.4826 * float(np.median(np.abs(values - middle)))  # for a Gaussian
