"""UMBmark: tread and wheel diameters from the return positions of squares driven both ways.

J. Borenstein and L. Feng, "Measurement and Correction of Systematic Odometry Errors in Mobile Robots", IEEE Trans.
Robotics and Automation 12(6), 1996. The signs are derived anew in REP-103 axes, see (55).
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtri, stdtrit  # importing scipy.stats takes 0.4 s

from drd.arrays import Array
from drd_tools.recordings.folder import read_table

HEADER: Final = ("direction", "x_m", "y_m")
CONFIDENCE: Final = 0.95
RUNS: Final = 5  # in each direction, as Borenstein and Feng have it
# Usual resolutions of a tape measure, coarsest first; the last is the least uncertainty of a return.
READ_TO_M: Final = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)


@dataclass(frozen=True)
class Returns:
    """Return-position errors, true position minus that by odometry, m, shape (n, 2) each."""

    cw_m: Array
    ccw_m: Array


@dataclass(frozen=True)
class Estimate:
    """A value and its standard deviation, of which 1.96 cover 95 %; nan if a single run leaves it unknown."""

    value: float
    sigma: float


@dataclass(frozen=True)
class Umbmark:
    """Result of the squares.

    `alpha_rad`: how far each true turn exceeds 90 deg (type A, tread). `beta_rad`: how far each straight leg bends to
    the left (type B, unequal wheels). `significant`: of the two, whether they differ from 0 with 95 % confidence.
    `misfit_m`: centroids less the model, cw and ccw, shape (2, 2).
    """

    alpha_rad: Estimate
    beta_rad: Estimate
    E_b: Estimate
    E_d: Estimate
    c_l: Estimate
    c_r: Estimate
    tread_m: Estimate
    significant: tuple[bool, bool]
    e_max_before_m: Estimate
    e_max_after_m: Estimate
    misfit_m: Array


def read_returns(file: Path) -> Returns:
    """Read direction (cw or ccw), x_m, y_m. Raises ConfigError with file, line and column."""
    ways, x_m, y_m = read_table(file, (HEADER,), cells={"direction": _way}, rising=None).values.T
    cw, ccw = (np.column_stack([x_m, y_m])[ways == way] for way in (-1.0, 1.0))
    return Returns(cw, ccw)


def _way(cell: str) -> float:
    """+1 is counter-clockwise."""
    if cell.strip() not in ("cw", "ccw"):
        raise ValueError("cw or ccw")
    return 1.0 if cell.strip() == "ccw" else -1.0


def square_return_m(alpha_rad: float, beta_rad: float, side_m: float, direction: int) -> Array:
    """Position where a robot ends that drives a square by odometry; direction +1 is ccw. Shape (2,). (55)

    Each leg is an arc that bends by beta to the left; each turn overshoots 90 deg by alpha in its own direction.
    """
    x_m = y_m = heading = 0.0
    chord_m = side_m * math.sin(0.5 * beta_rad) / (0.5 * beta_rad) if beta_rad else side_m
    for _ in range(4):
        x_m += chord_m * math.cos(heading + 0.5 * beta_rad)
        y_m += chord_m * math.sin(heading + 0.5 * beta_rad)
        heading += beta_rad + direction * (0.5 * math.pi + alpha_rad)
    return np.array([x_m, y_m])


def predict_m(alpha_rad: float, beta_rad: float, side_m: float) -> Array:
    """Return positions cw and ccw, shape (2, 2)."""
    return np.stack([square_return_m(alpha_rad, beta_rad, side_m, way) for way in (-1, 1)])


def one_way_rad(returns_m: Array, side_m: float, direction: int) -> float:
    """Angle measured in one direction: alpha + beta from ccw runs, alpha - beta from cw runs, to first order. (55)"""
    x_m, y_m = returns_m.mean(axis=0)
    return float((x_m - direction * y_m) / (4.0 * side_m))


def _solve(cw_m: Array, ccw_m: Array, side_m: float) -> Array:
    """Alpha and beta from the two centroids, by least squares over their four coordinates."""
    cw, ccw = one_way_rad(cw_m, side_m, -1), one_way_rad(ccw_m, side_m, 1)
    seen = np.stack([cw_m.mean(axis=0), ccw_m.mean(axis=0)])
    start = (0.5 * (ccw + cw), 0.5 * (ccw - cw))
    return np.asarray(least_squares(lambda p: (predict_m(p[0], p[1], side_m) - seen).ravel(), start, xtol=1e-12).x)


def diameters_ratio(beta_rad: float, side_m: float, tread_m: float) -> float:
    """E_d, right over left diameter, from the bend of a leg: the centre circle's radius is side / beta."""
    return (side_m + 0.5 * beta_rad * tread_m) / (side_m - 0.5 * beta_rad * tread_m)


def evaluate(returns: Returns, side_m: float, tread_m: float) -> Umbmark:
    """Compute E_d, E_b and the corrections, from at least one return in each direction (ValueError otherwise).

    `tread_m` is the nominal tread, with which the squares were driven.
    """
    if not len(returns.cw_m) or not len(returns.ccw_m):
        raise ValueError("returns of both directions are needed")
    alpha, beta = (float(value) for value in _solve(returns.cw_m, returns.ccw_m, side_m))
    # To first order alpha and beta are half the sum and half the difference of the two directions' angles.
    step_m = _read_to_m(returns)
    variances = [_variance_of_mean(m, way, side_m, step_m) for m, way in ((returns.cw_m, -1), (returns.ccw_m, 1))]
    freedom = max(len(returns.cw_m) + len(returns.ccw_m) - 2, 1)
    limit = float(stdtrit(freedom, 0.5 + 0.5 * CONFIDENCE)) * 0.5 * math.sqrt(sum(variances))
    sigma = limit / float(ndtri(0.5 + 0.5 * CONFIDENCE))  # few runs may agree by chance
    E_b = 0.5 * math.pi / (0.5 * math.pi + alpha)
    E_d = diameters_ratio(beta, side_m, E_b * tread_m)
    sigma_b, sigma_d = sigma * E_b**2 / (0.5 * math.pi), sigma * tread_m / side_m
    seen = np.stack([returns.cw_m.mean(axis=0), returns.ccw_m.mean(axis=0)])
    misfit = seen - predict_m(alpha, beta, side_m)
    return Umbmark(
        Estimate(alpha, sigma),
        Estimate(beta, sigma),
        Estimate(E_b, sigma_b),
        Estimate(E_d, sigma_d),
        Estimate(2.0 / (E_d + 1.0), 0.5 * sigma_d),
        Estimate(2.0 / (1.0 / E_d + 1.0), 0.5 * sigma_d),
        Estimate(E_b * tread_m, sigma_b * tread_m),
        (abs(alpha) > limit, abs(beta) > limit),
        _largest(seen, returns),
        _largest(misfit, returns),
        misfit,
    )


def _variance_of_mean(returns_m: Array, direction: int, side_m: float, step_m: float) -> float:
    """Variance of `one_way_rad` for coordinates of resolution `step_m`; nan for a single run.

    Runs that scatter by less than the resolution are all rounded alike, which averaging does not reduce.
    """
    if len(returns_m) < 2:
        return math.nan
    each = (returns_m[:, 0] - direction * returns_m[:, 1]) / (4.0 * side_m)
    return max(float(np.var(each, ddof=1)) / len(each), step_m**2 / 6.0 / (4.0 * side_m) ** 2)


def _read_to_m(returns: Returns) -> float:
    """Coarsest of the usual steps of which all coordinates are multiples; otherwise the finest."""
    read_m = np.concatenate([returns.cw_m, returns.ccw_m])
    fits = (step_m for step_m in READ_TO_M if np.abs(read_m - step_m * np.round(read_m / step_m)).max() < 1e-6)
    return next(fits, READ_TO_M[-1])


def _largest(centroids_m: Array, returns: Returns) -> Estimate:
    """E_max,syst: the larger distance of the two centroids from the origin, and its standard deviation."""
    distance_m = np.hypot(*centroids_m.T)
    worst = int(distance_m.argmax())
    runs = (returns.cw_m, returns.ccw_m)[worst]
    if len(runs) < 2:
        return Estimate(float(distance_m[worst]), math.nan)
    along = centroids_m[worst] / max(float(distance_m[worst]), 1e-12)
    sigma = math.sqrt(float(np.var(runs @ along, ddof=1)) / len(runs))
    return Estimate(float(distance_m[worst]), sigma)


def leave_one_pair_out(returns: Returns, side_m: float) -> tuple[Array, Array]:
    """Distances of each left-out pair from the origin, before and after, shape (pairs, 2) each: cw, ccw.

    Pair k, the k-th cw and the k-th ccw run, is corrected with the result of all other runs.
    """
    pairs = min(len(returns.cw_m), len(returns.ccw_m))
    pairs = pairs if pairs > 1 else 0  # with one pair, no runs are left to correct it
    before, after = np.zeros((pairs, 2)), np.zeros((pairs, 2))
    for k in range(pairs):
        alpha, beta = _solve(np.delete(returns.cw_m, k, 0), np.delete(returns.ccw_m, k, 0), side_m)
        seen = np.stack([returns.cw_m[k], returns.ccw_m[k]])
        before[k] = np.hypot(*seen.T)
        after[k] = np.hypot(*(seen - predict_m(alpha, beta, side_m)).T)
    return before, after


def runs_problem(returns: Returns) -> str:
    """A sentence if there are fewer runs than UMBmark requires; empty otherwise."""
    cw, ccw = len(returns.cw_m), len(returns.ccw_m)
    if min(cw, ccw) >= RUNS:
        return ""
    return f"UMBmark asks for {RUNS} runs in each direction; here are {cw} cw and {ccw} ccw."
