"""Regression of the wheels' turn and travel on the gyro's turn: the sign of each side, and the ratio."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from drd.arrays import Array

# Ratios to the configured tread that tyres and ground can cause, with margin; and the largest one that is searched.
LEAST_RATIO: Final = 1.0 / 3.0
PLAUSIBLE_RATIO: Final = 3.0
LARGEST_RATIO: Final = 1000.0
ENOUGH_RAD: Final = 1.0
UNEXPLAINED: Final = 0.1
# A side that counts seven times the other has an asymmetry of 0.75.
LARGEST_ASYMMETRY: Final = 0.75
ASYMMETRY_PRIOR: Final = 0.3
# With a larger sigma the asymmetry is unknown; the wheels may then differ by a tenth.
KNOWN: Final = 0.05
UNKNOWN_ASYMMETRY: Final = 0.05
# Least share of the travel's square that is independent of the turn; not needed if (turn/travel)^2 is below the second.
INDEPENDENT: Final = 0.1
ALMOST_STRAIGHT: Final = 0.01
# The prior's weight depends on the residual, which the asymmetry itself reduces.
PASSES: Final = 4
# Neighbouring windows share slip and ground: so many form a block for the uncertainty.
BLOCK: Final = 5


@dataclass(frozen=True)
class Fit:
    """`turn = ratio gyro + asymmetry travel`: the values, their sigmas, and the sum of the squared residuals, rad^2."""

    ratio: float
    ratio_sigma: float
    asymmetry: float
    asymmetry_sigma: float
    cost: float


def fit(turn: Array, travel: Array, gyro: Array, low: float, high: float) -> Fit:
    """Least squares with the gyro as regressor, since it is far more accurate than the wheels.  # (43), (44)

    Angles, shape (n,) each: (right - left)/tread, (right + left)/tread and the gyro's. The ratio is held between
    `low` and `high`. The asymmetry has a weak prior, for drives in which travel and turn are correlated.
    """
    gg, gs, ss = float(gyro @ gyro) + 1e-12, float(gyro @ travel), float(travel @ travel) + 1e-12
    ratio, asymmetry = min(max(float(gyro @ turn) / gg, low), high), 0.0
    for _ in range(PASSES):
        residual = turn - ratio * gyro - asymmetry * travel
        prior = float(np.mean(residual**2)) / ASYMMETRY_PRIOR**2 + 1e-12
        matrix = np.array([[gg, gs], [gs, ss + prior]])
        asymmetry = float(np.linalg.solve(matrix, [gyro @ turn, travel @ turn])[1])
        asymmetry = min(max(asymmetry, -LARGEST_ASYMMETRY), LARGEST_ASYMMETRY)
        ratio = min(max(float(gyro @ (turn - asymmetry * travel)) / gg, low), high)
    residual = turn - ratio * gyro - asymmetry * travel
    sigmas = _sigmas(np.column_stack([gyro, travel]), residual)
    # On a single arc, turning and distance affect the wheels' turn alike, apart from timing errors.
    if ss - gs**2 / gg < INDEPENDENT * ss and gg > ALMOST_STRAIGHT * ss:
        sigmas[1] = math.inf
    if sigmas[1] > KNOWN:  # then the sides are assumed equal
        ratio, asymmetry = min(max(float(gyro @ turn) / gg, low), high), 0.0
        residual = turn - ratio * gyro
        sigmas[0] = math.hypot(_sigmas(gyro[:, None], residual)[0], UNKNOWN_ASYMMETRY * gs / gg)
    return Fit(ratio, float(sigmas[0]), asymmetry, float(sigmas[1]), float(residual @ residual))


def _sigmas(regressors: Array, residual: Array) -> Array:
    """Standard deviations: the larger of the ordinary and the block-robust (sandwich) estimate."""
    n, m = regressors.shape
    if n <= m:
        return np.full(m, math.inf)
    information = regressors.T @ regressors
    # A regressor without excitation has no information: its sigma becomes huge instead of infinite.
    inverse = np.linalg.inv(information + (1e-9 * np.trace(information) + 1e-30) * np.eye(m))
    plain = np.diag(inverse) * float(residual @ residual) / (n - m)
    scores = regressors * residual[:, None]
    size = BLOCK if n >= 6 * BLOCK else 1
    blocks = np.array([scores[k : k + size].sum(axis=0) for k in range(0, n, size)])
    robust = np.diag(inverse @ (blocks.T @ blocks) @ inverse) * n / (n - m)
    return np.asarray(np.sqrt(np.maximum(np.maximum(plain, robust), 0.0)), dtype=np.float64)


def goes_with(turn: Array, gyro: Array) -> bool:
    """Whether the wheels' turn is proportional to the gyro's, at any ratio."""
    free = float(gyro @ turn) / (float(gyro @ gyro) + 1e-12)
    residual = float(turn @ turn) - free**2 * float(gyro @ gyro)
    return float(np.abs(turn).sum()) > ENOUGH_RAD and residual < UNEXPLAINED * float(turn @ turn)


def fit_senses(turn: Array, travel: Array, gyro: Array) -> dict[tuple[bool, bool], Fit]:
    """Fits of the four ways in which wheels and gyro may be related, by (one side inverted, opposite sense).

    With one side inverted, turn and travel change places. As configured, the ratio may be large (wrong counts). It may
    be small (wrong unit of the gyro) only if the wheels' turn follows the gyro's and their travel does not: otherwise a
    robot with an inverted side that drives almost straight looks the same.
    """
    inverted = {
        (True, False): fit(travel, turn, gyro, LEAST_RATIO, PLAUSIBLE_RATIO),
        (True, True): fit(travel, turn, gyro, -PLAUSIBLE_RATIO, -LEAST_RATIO),
    }
    is_inverted = min(f.cost for f in inverted.values()) < UNEXPLAINED * float(travel @ travel)
    free = abs(float(gyro @ turn)) / (float(gyro @ gyro) + 1e-12)
    least = min(LEAST_RATIO, 0.5 * free) if goes_with(turn, gyro) and not is_inverted else LEAST_RATIO
    configured = {
        (False, False): fit(turn, travel, gyro, least, LARGEST_RATIO),
        (False, True): fit(turn, travel, gyro, -LARGEST_RATIO, -least),
    }
    return configured | inverted
