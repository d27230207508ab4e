"""Length of a path whose positions are noisy."""

import math
from typing import Final

import numpy as np

from drd.arrays import Array, cumulative

VERTEX_SIGMAS: Final = 10.0
MEDIAN_PER_SIGMA: Final = math.sqrt(2.0 * math.log(2.0))  # for the length of a Gaussian vector in the plane


def path_length_m(xy_m: Array, sigma_m: float) -> Array:
    """Length of the path up to each row of `xy_m` (n, 2), shape (n,).

    Noise of the rows would lengthen the path, without limit at standstill. So it is measured along chords of at least
    ten sigma (at most 1 % too long), and distributed evenly over the rows in between. Sigma is estimated from second
    differences (variance 6 sigma^2), but is at most `sigma_m`, which may include an offset common to all rows.
    """
    second_m = np.hypot(*np.diff(xy_m, n=2, axis=0).T)
    if sigma_m > 0.0 and second_m.size:
        sigma_m = min(sigma_m, float(np.median(second_m)) / MEDIAN_PER_SIGMA / math.sqrt(6.0))
    if sigma_m <= 0.0:
        return cumulative(np.hypot(*np.diff(xy_m, axis=0).T))
    vertices, lengths = [0], [0.0]
    for k in range(1, len(xy_m)):
        chord_m = math.dist(xy_m[k], xy_m[vertices[-1]])
        if chord_m >= VERTEX_SIGMAS * sigma_m:
            vertices.append(k)
            lengths.append(lengths[-1] + chord_m)
    return np.asarray(np.interp(np.arange(len(xy_m), dtype=float), vertices, lengths))
