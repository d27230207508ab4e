"""Arrays of numbers, and their sums."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def cumulative(steps: npt.ArrayLike) -> Array:
    """Sums of steps (n,) from the start to each of their edges, (n + 1,): the first is 0."""
    return np.concatenate([[0.0], np.cumsum(steps)])
