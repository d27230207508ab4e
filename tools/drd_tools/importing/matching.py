"""Delay, gain and correlation between two measurements of the same rotation, with their uncertainties."""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d

from drd.arrays import Array

# Shortest cell over which rates are averaged before comparison, against encoder steps and vibration.
CELL_S: Final = 0.05
# Width of the smoothing of both angles, in intervals of the coarser stream.
SMOOTHING: Final = 1.5
WIDER: Final = (1, 4, 16)
# The jackknife leaves out one block at a time; shorter blocks are not independent of their neighbours.
BLOCK_S: Final = 2.0
BLOCKS: Final = (5, 20)
# Two unrelated slow motions reach half of this by chance; wheels and gyro of one robot far exceed it.
LEAST_CORRELATION: Final = 0.6
# Least uncertainty of a delay, in cells: interpolation between samples shifts the peak by as much.
LAG_FLOOR: Final = 0.05


@dataclass(frozen=True)
class Turning:
    """An angle about the vertical over time, shape (n,) each."""

    time_s: Array
    angle_rad: Array


@dataclass(frozen=True)
class Match:
    """b(t) = gain a(t - lag) + constant, where |correlation| is largest; sigmas by the block jackknife.

    `lag_s`: delay of b behind a. `gain` is a regression on a, whose noise makes it too small: it distinguishes units
    but is no scale factor. `at_edge`: the largest correlation is at the end of the lags tried.
    """

    lag_s: float
    lag_sigma_s: float
    gain: float
    gain_sigma: float
    correlation: float
    correlation_sigma: float
    at_edge: bool
    seconds: float

    @property
    def is_clear(self) -> bool:
        """Whether the two clearly show the same motion."""
        r, sigma = abs(self.correlation), self.correlation_sigma
        return not self.at_edge and r >= LEAST_CORRELATION and r - 3.0 * sigma > 0.5 * LEAST_CORRELATION

    @property
    def sign(self) -> int:
        """+1 if both turn the same way, otherwise -1."""
        return 1 if self.gain > 0.0 else -1


def angle_of(time_s: Array, rate_rad_s: Array) -> Array:
    """Angle at each time, shape (n,); each rate is the mean over the interval that ends there."""
    return np.cumsum(rate_rad_s * np.diff(time_s, prepend=time_s[0]))


def match(a: Turning | None, b: Turning | None, max_lag_s: float) -> Match | None:
    """Compare the rates of `b` with those of `a` at lags of up to +-`max_lag_s`.

    None if one of them is missing, or if they overlap too briefly. Times must increase. Constant parts of the rates,
    such as a gyro's bias, are ignored. Rates are averaged over the shortest cells that give a clear match: short cells
    resolve the lag best, longer ones average out more noise.
    """
    if a is None or b is None or min(len(a.time_s), len(b.time_s)) < 3:
        return None
    coarse_s = max(float(np.median(np.diff(one.time_s))) for one in (a, b))
    a, b = _smooth(a, coarse_s), _smooth(b, coarse_s)
    cell_s = max(CELL_S, coarse_s)
    best: Match | None = None
    for factor in WIDER:
        found = _match(a, b, max_lag_s, factor * cell_s)
        if found is not None and (best is None or found.is_clear):
            best = found
        if found is None or found.is_clear:
            break
    return best


def _smooth(one: Turning, coarse_s: float) -> Turning:
    """Smooth an angle with the common Gaussian, so that interpolation between samples no longer reduces its noise.

    Otherwise the lags at which it reduces noise the most, half samples, would look best.
    """
    sigma = SMOOTHING * coarse_s / float(np.median(np.diff(one.time_s)))
    reach = min(len(one.angle_rad) - 1, math.ceil(4.0 * sigma))
    longer = np.pad(one.angle_rad, reach, mode="reflect", reflect_type="odd")
    return replace(one, angle_rad=gaussian_filter1d(longer, sigma, truncate=4.0)[reach : reach + len(one.angle_rad)])


def _match(one: Turning, other: Turning, max_lag_s: float, cell_s: float) -> Match | None:
    start_s = max(one.time_s[0] + max_lag_s, other.time_s[0])
    cells = math.floor((min(one.time_s[-1] - max_lag_s, other.time_s[-1]) - start_s) / cell_s)
    blocks = min(int(cells * cell_s / max(BLOCK_S, 4.0 * cell_s)), BLOCKS[1])
    if blocks < BLOCKS[0]:
        return None
    edges_s = start_s + cell_s * np.arange(cells + 1)
    most = math.floor(2.0 * max_lag_s / cell_s)
    lags_s: Array = 0.5 * cell_s * np.arange(-most, most + 1, dtype=np.float64)
    b = np.diff(np.interp(edges_s, other.time_s, other.angle_rad)) / cell_s
    at_lags = (np.diff(np.interp(edges_s - lag_s, one.time_s, one.angle_rad)) / cell_s for lag_s in lags_s)
    begins = np.linspace(0, cells, blocks, endpoint=False).astype(int)
    sums = np.array([_sums(a, b, begins) for a in at_lags])
    best = _best(sums.sum(axis=2), lags_s)
    if best is None:
        return None
    left_out = [_best(sums.sum(axis=2) - sums[:, :, k], lags_s) for k in range(blocks)]
    known = np.array([found[:3] for found in left_out if found is not None])
    # Block jackknife (Kuensch 1989): the noise of both sensors may be correlated within a block.
    sigma = np.sqrt((blocks - 1) / blocks * ((known - known.mean(axis=0)) ** 2).sum(axis=0))
    lag_s, gain, correlation, at_edge = best
    lag_sigma_s = math.hypot(float(sigma[0]), LAG_FLOOR * cell_s)
    r_sigma, seconds = float(sigma[2]), cells * cell_s
    return Match(lag_s, lag_sigma_s, gain, float(sigma[1]), correlation, r_sigma, at_edge, seconds)


def _sums(a: Array, b: Array, begins: npt.NDArray[np.int_]) -> Array:
    """Count, sums and sums of products of each block, shape (6, blocks)."""
    return np.array([np.add.reduceat(column, begins) for column in (np.ones_like(a), a, b, a * a, b * b, a * b)])


def _best(sums: Array, lags_s: Array) -> tuple[float, float, float, bool] | None:
    """Lag, gain and correlation at the peak, and whether it is at an end, from sums of shape (lags, 6)."""
    n, a, b, aa, bb, ab = sums.T
    var_a, var_b, cov = aa / n - (a / n) ** 2, bb / n - (b / n) ** 2, ab / n - a * b / n**2
    # Rounding errors of a constant rate are no motion.
    if not (var_a.max() > 1e-18 and var_b.max() > 1e-18):
        return None
    r = cov / np.sqrt(np.maximum(var_a * var_b, 1e-300))
    k = int(np.argmax(np.abs(r)))
    at_edge = k in (0, len(r) - 1)
    lag_s = float(lags_s[k])
    if not at_edge:
        # Parabola through the peak and its neighbours (textbook).
        before, peak, after = np.abs(r[k - 1 : k + 2])
        bend = before - 2.0 * peak + after
        lag_s += 0.5 * float((before - after) / bend) * float(lags_s[1] - lags_s[0]) if bend < 0.0 else 0.0
    return lag_s, float(cov[k] / var_a[k]) if var_a[k] > 0.0 else 0.0, float(r[k]), at_edge
