"""The gyro's error function e(w_g, T), fitted to data sets: scaled regressors, robust weights, honest covariance.

data = data_sets_of_samples(time_s, table_rate_deg_s, rate_deg_s, temperature_c)
fitted = fit_error_function(data, Order(3, 2))
calibration = fitted.calibration(residual_deg_s, {"created": "2026-01-01"})
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from drd.arrays import Array
from drd.estimation.calibration import Calibration
from drd_tools.calibrate.gyro.data_sets import DataSets

HUBER: Final = 1.345  # 95 % efficient for normal errors, Huber (1981)
REJECT_SIGMA: Final = 6.0
MAX_ITERATIONS: Final = 50
MIN_SPARE: Final = 4  # data sets in excess of the coefficients; with fewer the scatter is a guess
MIN_WIDTH_C: Final = 1.0  # KVH's sensors report whole degrees

_PHI = math.exp(-0.5 * HUBER**2) / math.sqrt(2.0 * math.pi)
_TAIL = 0.5 * math.erfc(HUBER / math.sqrt(2.0))
# E[min(u^2, k^2)] for a standard normal u.
HUBER_MEAN_SQUARE: Final = 1.0 - 2.0 * _TAIL - 2.0 * HUBER * _PHI + 2.0 * HUBER**2 * _TAIL


class Order(NamedTuple):
    """Highest powers of the rate and of the temperature; the paper's is (3, 2)."""

    rate: int
    temperature: int

    def __str__(self) -> str:
        return f"{self.rate},{self.temperature}"

    @property
    def coefficients(self) -> int:
        """Number of coefficients."""
        return (self.rate + 1) * (self.temperature + 1)

    @property
    def fits_in_file(self) -> bool:
        """True if the calibration file, and so the daemon, can hold this order."""
        return self.rate <= FILE_ORDER.rate and self.temperature <= FILE_ORDER.temperature


FILE_ORDER: Final = Order(3, 2)


@dataclass(frozen=True)
class ErrorFunction:
    """e(w, T) = sum_ij c_ij w^i T^j with the covariance of c; w in deg/s, T in degC. (5)

    `coefficients`: raw powers, shape (rate + 1, temperature + 1); `covariance`: square, in the order of
    `coefficients.ravel()`. `scaled_*`: the same for u, v in [-1, 1], in which it is evaluated. `between_deg_s`:
    scatter between data sets beyond that of their own samples (lack of fit, temperature, the table).
    `weights`: shape (n,), one for each data set, 0 if rejected. `condition_*`: condition numbers of the regressors.
    """

    order: Order
    coefficients: Array
    covariance: Array
    scaled_coefficients: Array
    scaled_covariance: Array
    rate_range_deg_s: tuple[float, float]
    temperature_range_c: tuple[float, float]
    between_deg_s: float
    weights: Array
    condition_scaled: float
    condition_raw: float

    def error_deg_s(self, rate_deg_s: npt.ArrayLike, temperature_c: npt.ArrayLike) -> Array:
        """Evaluate e(w, T), broadcasting the two; extrapolate beyond the range. (5)"""
        regressors, shape = self._regressors(rate_deg_s, temperature_c)
        return np.asarray((regressors @ self.scaled_coefficients).reshape(shape))

    def sigma_deg_s(self, rate_deg_s: npt.ArrayLike, temperature_c: npt.ArrayLike) -> Array:
        """Standard deviation of e(w, T) from the coefficients' covariance, broadcasting the two."""
        regressors, shape = self._regressors(rate_deg_s, temperature_c)
        variance = np.einsum("ni,ij,nj->n", regressors, self.scaled_covariance, regressors)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)).reshape(shape))

    def residual_deg_s(self, data: DataSets) -> Array:
        """Errors of the data sets after the correction, shape (n,). (6)"""
        return data.error_deg_s - self.error_deg_s(data.rate_deg_s, data.temperature_c)

    def calibration(
        self, residual_deg_s: float, provenance: dict[str, str], residual_before_deg_s: float | None = None
    ) -> Calibration:
        """Make the calibration that the daemon loads. Raises ValueError if the order does not fit in its file."""
        if not self.order.fits_in_file:
            raise ValueError(f"order {self.order}: a calibration file holds up to {FILE_ORDER}")
        i, j = self.coefficients.shape
        full = np.zeros((FILE_ORDER.rate + 1, FILE_ORDER.temperature + 1))
        full[:i, :j] = self.coefficients
        covariance = np.zeros((*full.shape, *full.shape))
        covariance[:i, :j, :i, :j] = self.covariance.reshape(i, j, i, j)
        rows = [(float(b0), float(b1), float(b2)) for b0, b1, b2 in full]
        return Calibration(
            (rows[0], rows[1], rows[2], rows[3]),
            self.rate_range_deg_s,
            self.temperature_range_c,
            float(residual_deg_s),
            provenance,
            residual_before_deg_s,
            tuple(map(tuple, covariance.reshape(full.size, full.size).tolist())),
        )

    def _regressors(self, rate_deg_s: npt.ArrayLike, temperature_c: npt.ArrayLike) -> tuple[Array, tuple[int, ...]]:
        w, T = np.broadcast_arrays(np.asarray(rate_deg_s, float), np.asarray(temperature_c, float))
        u, v = _scaled(w.ravel(), self.rate_range_deg_s), _scaled(T.ravel(), self.temperature_range_c)
        return _vandermonde(u, v, self.order), w.shape


def fit_error_function(data: DataSets, order: Order | tuple[int, int] = FILE_ORDER) -> ErrorFunction:
    """Fit by iteratively reweighted least squares. (2) to (5), (47), (48)

    Each data set's variance is its own plus one between data sets, chosen so that chi-square has its expected value
    (Paule and Mandel 1982), with Huber's weights; beyond six studentised sigma it is rejected and the fit
    repeated. Raises ValueError if the data sets are too few or do not determine the coefficients.
    """
    order = Order(*order)
    _require_enough(data, order)
    kept = np.ones(len(data), dtype=bool)
    while True:
        used = data.select(kept)
        rate_range, temperature_range = _range(used.rate_deg_s, 1e-3), _range(used.temperature_c, MIN_WIDTH_C)
        u, v = _scaled(used.rate_deg_s, rate_range), _scaled(used.temperature_c, temperature_range)
        X = _vandermonde(u, v, order)  # (2) to (5)
        per_degree = 2.0 / (temperature_range[1] - temperature_range[0])
        X_T = per_degree * used.temperature_sigma_c[:, None] * _slope_in_temperature(u, v, order)
        fit = _huber_fit(X, X_T, used.error_deg_s, used.sigma_deg_s)
        good = np.abs(fit.studentised) <= REJECT_SIGMA
        if good.all() or good.sum() < order.coefficients + MIN_SPARE:
            break
        kept[kept] = good
    weights = np.zeros(len(data))
    weights[kept] = fit.weights
    raw = _vandermonde(used.rate_deg_s, used.temperature_c, order)
    to_raw = np.kron(_powers_of_scaled(rate_range, order.rate), _powers_of_scaled(temperature_range, order.temperature))
    raw_covariance = to_raw @ fit.covariance @ to_raw.T  # (47)
    return ErrorFunction(
        order,
        (to_raw @ fit.beta).reshape(order.rate + 1, order.temperature + 1),
        0.5 * (raw_covariance + raw_covariance.T),
        fit.beta,
        fit.covariance,
        rate_range,
        temperature_range,
        fit.between,
        weights,
        float(np.linalg.cond(X)),
        float(np.linalg.cond(raw)),
    )


def corner_leverage(data: DataSets, order: Order) -> tuple[float, float, float]:
    """Largest variance of e at a corner of the covered range, relative to one data set's, and that corner.

    Returns leverage, rate in deg/s, temperature in degC. Raises ValueError as `fit_error_function` does.
    """
    _require_enough(data, order)
    ranges = _range(data.rate_deg_s, 1e-3), _range(data.temperature_c, MIN_WIDTH_C)
    u, v = _scaled(data.rate_deg_s, ranges[0]), _scaled(data.temperature_c, ranges[1])
    R: Array = np.linalg.qr(_vandermonde(u, v, order))[1]
    if np.linalg.matrix_rank(R) < order.coefficients:
        raise ValueError(f"the data sets do not determine the {order.coefficients} coefficients of order {order}")
    used = [float(v.min()), float(v.max())] if order.temperature else [0.0]
    corners = np.array([(a, b) for a in (-1.0, 1.0) for b in used])
    leverage = (np.linalg.solve(R.T, _vandermonde(corners[:, 0], corners[:, 1], order).T) ** 2).sum(0)
    worst = int(np.argmax(leverage))
    rate, temperature = (
        0.5 * (low + high) + 0.5 * (high - low) * float(x)
        for (low, high), x in zip(ranges, corners[worst], strict=True)
    )
    return float(leverage[worst]), rate, temperature


def _require_enough(data: DataSets, order: Order) -> None:
    least = order.coefficients + MIN_SPARE
    if len(data) < least:
        raise ValueError(
            f"order {order} has {order.coefficients} coefficients and needs {least} data sets, there are {len(data)}"
        )


class _Fit(NamedTuple):
    beta: Array
    covariance: Array
    between: float
    weights: Array
    studentised: Array


def _huber_fit(X: Array, X_T: Array, e: Array, sigma: Array) -> _Fit:
    """Compute Huber's M-estimate, with the variance between data sets as its scale ("proposal 2", Huber 1981). (48)

    `X_T @ beta` is the error caused by one standard deviation of the temperature.
    """
    n, p = X.shape
    weights: Array = np.ones(n)
    beta: Array = np.zeros(p)
    variance, between = sigma**2, 0.0
    for _ in range(MAX_ITERATIONS):
        root = np.sqrt(weights / variance)
        solution, _, rank, _ = np.linalg.lstsq(X * root[:, None], e * root, rcond=None)
        solved = np.asarray(solution, dtype=np.float64)
        if rank < p:
            raise ValueError(f"the data sets determine {rank} of {p} coefficients")
        residual = e - X @ solved
        own = sigma**2 + (X_T @ solved) ** 2
        between = _between_variance(residual, own, p)
        variance = own + between
        u = residual / np.sqrt(variance)
        weights[:] = np.clip(HUBER / np.maximum(np.abs(u), 1e-12), 0.0, 1.0)
        moved, beta = np.max(np.abs(X @ (solved - beta)) / np.sqrt(variance)), solved
        if moved < 1e-4:
            break
    Q, R = np.linalg.qr(X / np.sqrt(variance)[:, None])
    inverse = np.linalg.solve(R, np.eye(p))
    # Huber (1981), 7.6: covariance of the M-estimate. The data sets' own scatter is its lower limit.
    inlying = float(np.mean(np.abs(u) <= HUBER))
    psi_square = max(float(np.sum(np.minimum(u**2, HUBER**2))) / (n - p), HUBER_MEAN_SQUARE)
    if between > 0.0:  # the scale comes from only n - p residuals: the variance of Student's t
        psi_square *= (n - p) / (n - p - 2)
    factor = (1.0 + p / n * (1.0 - inlying) / inlying) ** 2 * psi_square / inlying**2
    leverage = np.einsum("ij,ij->i", Q, Q)
    studentised = u / np.sqrt(np.maximum(1.0 - leverage, 0.05))
    covariance = factor * inverse @ inverse.T
    return _Fit(beta, covariance, math.sqrt(between), weights, studentised)


def _between_variance(residual: Array, own: Array, p: int) -> float:
    """Variance between data sets that, added to their own, explains the residuals; 0 if none is needed."""
    target = HUBER_MEAN_SQUARE * (len(residual) - p)
    square = residual**2

    def excess(variance: float) -> float:
        return float(np.minimum(square / (own + variance), HUBER**2).sum()) - target

    if excess(0.0) <= 0.0:
        return 0.0
    high = float(square.sum()) / target
    return float(brentq(excess, 0.0, high, xtol=1e-9 * high, rtol=1e-6))


def _vandermonde(u: Array, v: Array, order: Order) -> Array:
    """Columns u^i v^j, i = 0..order.rate, within each j = 0..order.temperature; shape (n, coefficients). (5)"""
    powers = np.vander(u, order.rate + 1, True)[:, :, None] * np.vander(v, order.temperature + 1, True)[:, None, :]
    return powers.reshape(len(u), -1)


def _slope_in_temperature(u: Array, v: Array, order: Order) -> Array:
    """Derivative of `_vandermonde` with respect to v, the same shape."""
    j = np.arange(order.temperature + 1)
    slopes = j * np.vander(v, order.temperature + 1, True)[:, np.maximum(j - 1, 0)]
    powers = np.vander(u, order.rate + 1, True)[:, :, None] * slopes[:, None, :]
    return powers.reshape(len(u), -1)


def _range(values: Array, least: float) -> tuple[float, float]:
    """Range of the values, widened to `least` where it is narrower."""
    low, high = float(values.min()), float(values.max())
    missing = max(0.0, least - (high - low)) / 2.0
    return low - missing, high + missing


def _scaled(values: Array, limits: tuple[float, float]) -> Array:
    """Map the values so that the limits become -1 and 1."""
    low, high = limits
    return (2.0 * values - (low + high)) / (high - low)


def _powers_of_scaled(limits: tuple[float, float], order: int) -> Array:
    """Matrix that converts coefficients of powers of the scaled variable to those of the raw one, exactly."""
    low, high = limits
    slope, start = 2.0 / (high - low), -(low + high) / (high - low)
    matrix = np.zeros((order + 1, order + 1))
    for power in range(order + 1):  # (start + slope x)^power
        for k in range(power + 1):
            matrix[k, power] = math.comb(power, k) * slope**k * start ** (power - k)
    return matrix
