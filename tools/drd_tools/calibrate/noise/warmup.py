"""Warm-up of a gyro at standstill: how its bias settles after power-on, and how long to wait for it."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import solve_triangular, toeplitz
from scipy.optimize import minimize_scalar
from scipy.stats import linregress

from drd.arrays import Array
from drd_tools.calibrate.noise.allan import TINY, B, K, N, Q, allan_curve, fit, shapes
from drd_tools.calibrate.noise.intervals import flicker_density
from drd_tools.calibrate.noise.static_log import StaticLog

BLOCKS: Final = 120
SHORTEST_BLOCK_S: Final = 2.0
# Least improvement of the exponential over a constant, as a drop in chi-square. Of simulated logs with flicker and
# random walk but no warm-up, about 1 in 100 exceeds it.
DISTINCT: Final = 20.0
# Longest time constant, as a fraction of the log: a slower one cannot be distinguished from a ramp.
SLOWEST_PART: Final = 0.5
DRIFT_WINDOW_S: Final = 600.0
# A smaller change of temperature does not reveal its effect.
LEAST_CHANGE_C: Final = 1.0
# The part left out ends when the remaining warm-up is below this fraction of the bias instability.
LEFT_OVER: Final = 0.25
MOST_LEFT_OUT: Final = 0.5


@dataclass(frozen=True)
class WarmUp:
    """b(t) = bias + change exp(-t / time_constant), rad/s and s, t since the log's start. (51)"""

    bias_rad_s: float
    change_rad_s: float
    time_constant_s: float

    def at(self, time_s: Array) -> Array:
        """The fitted bias, rad/s, shape as `time_s`."""
        return self.bias_rad_s + self.change_rad_s * np.exp(-time_s / self.time_constant_s)

    def wait_s(self, drift_rad_s: float, window_s: float = DRIFT_WINDOW_S) -> float:
        """Time from which the bias changes by less than `drift_rad_s` within the following window. (51)"""
        first_rad_s = abs(self.change_rad_s) * -math.expm1(-window_s / self.time_constant_s)
        return self.time_constant_s * math.log(first_rad_s / drift_rad_s) if first_rad_s > drift_rad_s else 0.0

    def settled_s(self, rest_rad_s: float) -> float:
        """Time from which less than `rest_rad_s` of the change remains."""
        return self.wait_s(rest_rad_s, math.inf)


@dataclass(frozen=True)
class Slope:
    """Linear dependence of the bias on temperature over the log, with its standard error and correlation."""

    rad_s_per_c: float
    sigma_rad_s_per_c: float
    correlation: float
    range_c: tuple[float, float]


def block_means(log: StaticLog) -> tuple[Array, Array, Array | None]:
    """Middle time (s), mean rate (rad/s) and mean temperature of up to BLOCKS equal blocks, shape (b,) each."""
    size = max(round(SHORTEST_BLOCK_S / log.interval_s), len(log.rate_rad_s) // BLOCKS, 1)
    count = len(log.rate_rad_s) // size

    def means(values: Array) -> Array:
        return np.asarray(values[: count * size].reshape(count, size).mean(axis=1))

    temperature_c = None if log.temperature_c is None else means(log.temperature_c)
    return means(log.time_s), means(log.rate_rad_s), temperature_c


def fit_warm_up(log: StaticLog) -> WarmUp | None:
    """Fit an exponential to the log's blocks; None if it is not distinct from noise.

    The least squares are weighted with the noise of the log's second half: otherwise a random walk would bias the
    fit, or be mistaken for a warm-up.
    """
    time_s, rate_rad_s, _ = block_means(log)
    root = np.linalg.cholesky(_block_covariance(log, time_s))

    def whitened(values: Array) -> Array:
        return np.asarray(solve_triangular(root, values, lower=True))

    y, one = whitened(rate_rad_s), np.ones_like(time_s)

    def solve(log_constant: float) -> tuple[float, Array]:
        design = whitened(np.stack([one, np.exp(-time_s / math.exp(log_constant))], axis=1))
        found, *_ = np.linalg.lstsq(design, y, rcond=None)
        return float(((y - design @ found) ** 2).sum()), np.asarray(found, np.float64)

    # The sum of squares may have several minima in the time constant: search a grid, then refine.
    grid = np.log(np.geomspace(2.0 * (time_s[1] - time_s[0]), SLOWEST_PART * log.duration_s, 40))
    best = int(np.argmin([solve(value)[0] for value in grid]))
    bounds = (grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
    constant = float(minimize_scalar(lambda value: solve(value)[0], bounds=bounds, method="bounded").x)
    rest, (bias, change) = solve(constant)
    flat = whitened(one)
    without = float(((y - flat * (flat @ y) / (flat @ flat)) ** 2).sum())
    is_distinct = (without - rest) * (len(y) - 3) > DISTINCT * rest
    return WarmUp(float(bias), float(change), math.exp(constant)) if is_distinct else None


def _block_covariance(log: StaticLog, time_s: Array) -> Array:
    """Covariance of the block means under white, flicker and random-walk noise, as in the log's second half."""
    half = log.after(0.5 * log.duration_s)
    curve = allan_curve(half.rate_rad_s, half.interval_s)
    squares = fit(shapes(curve.tau_s), curve.deviation**2, curve.edf, (Q, N, B, K)).squares
    count, block_s = len(time_s), time_s[1] - time_s[0]
    white = float(shapes(np.array([block_s]))[0, [Q, N]] @ squares[[Q, N]])
    flicker = np.fft.irfft(flicker_density(4 * count), 4 * count)[:count] * squares[B]
    walk = squares[K] * np.minimum.outer(time_s, time_s)
    return np.asarray(max(white, TINY) * np.eye(count) + toeplitz(flicker) + walk)


def temperature_slope(log: StaticLog) -> Slope | None:
    """Regress the block means on temperature; None without temperature, or if it hardly changed.

    The standard error assumes independent blocks: it is too small if the bias wanders for other reasons.
    """
    _, rate_rad_s, temperature_c = block_means(log)
    if temperature_c is None or np.ptp(temperature_c) < LEAST_CHANGE_C:
        return None
    line = linregress(temperature_c, rate_rad_s)
    low, high = float(temperature_c.min()), float(temperature_c.max())
    return Slope(float(line.slope), float(line.stderr), float(line.rvalue), (low, high))


def left_out_s(warm_up: WarmUp, instability_rad_s: float, duration_s: float) -> float:
    """Time that the Allan deviation leaves out at the log's start: until warm-up ends, at most half of the log."""
    settled_s = warm_up.settled_s(LEFT_OVER * instability_rad_s)
    return min(settled_s, MOST_LEFT_OUT * duration_s)
