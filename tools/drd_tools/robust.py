"""Figures of scatter that a few wild values do not move."""

import numpy as np

from drd.arrays import Array


def deviation(values: Array, about: float | None = None) -> float:
    """Standard deviation of values by the median of their distances from `about`, which is their median by default."""
    middle = np.median(values) if about is None else about
    return 1.4826 * float(np.median(np.abs(values - middle)))  # of a Gaussian
