"""Evidence that the tread wanders, as that of wheels that slip sideways in each turn does. (98)"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.monitor.library import TURN
from drd.monitor.sums import Sums

# Share of robots with such wheels among those whose first turns show the stated tread.
SKIDDERS: Final = 0.03
# Standard deviations of the tread: 1.4 % on simulated asphalt. A Warthog's is 11 % and more, but its first turns show
# that it skids: the larger, the less likely here.
SIZES: Final = 0.01 * 2.0 ** np.arange(0.0, 4.5, 0.5)
LIKELY: Final = (1.0 + (SIZES / 0.02) ** 2) ** -4.0
# Correlation distances of the tread, equally likely. A Warthog's changes over 0.25 to 2 m.
LENGTHS_M: Final = (0.25, 0.5, 1.0)
LEAST: Final = 1e-2  # of a segment's information times the largest size squared: segments below are ignored


def nats(sums: Sums, told: Callable[[Array], Array]) -> float:
    """Log odds that the tread wanders, against a constant one: Gauss-Markov over the wheels' distance."""
    inside = -np.diff(sums.beside[:, :, TURN], axis=1)
    each = sums.each[:, TURN]
    tells = np.flatnonzero(each[:, TURN] * SIZES[-1] ** 2 > LEAST)
    if not len(tells):
        return math.log(SKIDDERS / (1.0 - SKIDDERS))
    v = sums.whitened(inside[:, tells])
    information = np.diag(each[tells, TURN]) - v.T @ v
    score = each[tells, -1] - v.T @ sums.vy
    apart_m = np.abs(sums.rolled_m[tells, None] - sums.rolled_m[tells])
    found = [_nats(information, score, apart_m, sums.turning_m[tells], length_m, told) for length_m in LENGTHS_M]
    prior = np.log(LIKELY / LIKELY.sum() / len(LENGTHS_M))
    return math.log(SKIDDERS / (1.0 - SKIDDERS)) + float(np.logaddexp.reduce(found + prior, None))


def _nats(
    information: Array, score: Array, apart_m: Array, turning_m: Array, length_m: float, told: Callable[[Array], Array]
) -> Array:
    """Log odds of each size, without its prior, (sizes,)."""
    w = np.maximum(turning_m / length_m, 1e-6)
    mean = np.sqrt(2.0 * (w + np.expm1(-w)) / w**2)  # deviation of the mean over the distance in turns
    root = np.linalg.cholesky(np.exp(-apart_m / length_m) * mean * mean[:, None] + 1e-9 * np.eye(len(w)))
    values, vectors = np.linalg.eigh(root.T @ information @ root)
    z = (score @ root) @ vectors
    variances = SIZES[:, None] ** 2
    inflated = 1.0 + variances * np.maximum(values, 0.0)
    gain = 0.5 * (z**2 * variances / inflated).sum(1)
    return np.asarray(told(gain) - 0.5 * np.log(inflated).sum(1))
