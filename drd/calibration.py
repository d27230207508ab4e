"""The gyro's stored calibration: the temperature-varying cubic error function, its range and its provenance."""

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drd.samples import CalibratedRate, GyroSample
from drd.schema import ConfigError
from drd.units import DEG_PER_RAD, RAD_PER_DEG

FORMAT = "drd-gyro-calibration/1"
Row = tuple[float, float, float]
ZERO: tuple[Row, Row, Row, Row] = ((0.0, 0.0, 0.0),) * 4
KEYS = (
    "format", "error_deg_s", "rate_range_deg_s", "temperature_range_c", "residual_deg_s", "provenance",
    "residual_before_deg_s", "covariance",
)  # fmt: skip
COEFFICIENTS = 12
# Of a gyro that was calibrated at one temperature only: Table I, peak to peak over -40 to 75 degC.
BIAS_SLOPE_DEG_S_C, SCALE_SLOPE_PER_C = 0.2 / 115.0, 0.02 / 115.0
# What a cubic leaves changes over an eighth of the range of rates, about the distance between its zeros. (42)
RATE_LENGTHS = 8.0
# Correlations that were rounded when they were written down make a matrix a little indefinite.
INDEFINITE = 1e-6


@dataclass(frozen=True)
class Calibration:
    """e(w, T) = sum_i (b_i0 + b_i1 T + b_i2 T^2) w^i, i = 0..3, with w in deg/s and T in degC. (2), (3), (5)

    `rows` are the b of each power of w; the rate is the reading after sign and axis (counter-clockwise positive).
    `residual_deg_s`, `residual_before_deg_s`: rms error of new data after and before the correction. `covariance`:
    of the twelve b, those of w^0 first and within them that of T^0 first, shape (12, 12); empty where not known.
    """

    rows: tuple[Row, Row, Row, Row]
    rate_range_deg_s: tuple[float, float]
    temperature_range_c: tuple[float, float]
    residual_deg_s: float
    provenance: dict[str, str]
    residual_before_deg_s: float | None = None
    covariance: tuple[tuple[float, ...], ...] = ()

    def error_deg_s(self, rate_deg_s: float, temperature_c: float) -> float:
        """The error function at one point, deg/s. (5)"""
        total, power = 0.0, 1.0
        for b0, b1, b2 in self.rows:
            total += (b0 + (b1 + b2 * temperature_c) * temperature_c) * power
            power *= rate_deg_s
        return total

    def is_inside(self, sample: GyroSample) -> bool:
        """True where rate and temperature lie in the range in which the calibration was measured."""
        (low, high), (cold, warm) = self.rate_range_deg_s, self.temperature_range_c
        return low <= sample.rate_rad_s * DEG_PER_RAD <= high and cold <= sample.temperature_c <= warm

    def correct(self, sample: GyroSample) -> CalibratedRate:
        """Equation (6). Outside the range the correction stays at the border's value and its sigma widens. (28)

        Sigma is of the rate's error beyond the error at rest, which a measured bias takes off. (42)
        """
        rate, temperature = sample.rate_rad_s * DEG_PER_RAD, sample.temperature_c
        (low, high), (cold, warm) = self.rate_range_deg_s, self.temperature_range_c
        w = min(max(rate, low), high)
        if math.isnan(temperature):
            T, spread_c = 0.5 * (cold + warm), 0.5 * (warm - cold)
        else:
            T = min(max(temperature, cold), warm)
            spread_c = abs(temperature - T)
        error = self.error_deg_s(w, T)
        variance, power = 0.0, 1.0
        for v0, v1, v2, v3, v4 in self._variance_rows:
            variance += (v0 + (v1 + (v2 + (v3 + v4 * T) * T) * T) * T) * power  # (31)
            power *= w
        variance = max(variance, 0.0) + self.residual_deg_s**2
        lengths = RATE_LENGTHS * w / (high - low)
        variance *= -2.0 * math.expm1(-0.5 * lengths * lengths)  # (42)
        if spread_c or w != rate:
            slope_c, slope_w = self._slopes(w, T, error)
            variance += (slope_c * spread_c) ** 2 + (slope_w * (rate - w)) ** 2  # (28)
        return CalibratedRate(
            sample.t_ns, sample.interval_s, sample.rate_rad_s - error * RAD_PER_DEG, math.sqrt(variance) * RAD_PER_DEG
        )

    def _slopes(self, w: float, T: float, error: float) -> tuple[float, float]:
        """de/dT and de/dw at the border, taken inwards. (28)"""
        (low, high), (cold, warm) = self.rate_range_deg_s, self.temperature_range_c
        step_c, step_w = 0.01 * (warm - cold), 0.01 * (high - low)
        inwards_c = -step_c if T + step_c > warm else step_c
        inwards_w = -step_w if w + step_w > high else step_w
        slope_w = (self.error_deg_s(w + inwards_w, T) - error) / inwards_w
        if not any(b1 or b2 for _, b1, b2 in self.rows):
            return math.hypot(BIAS_SLOPE_DEG_S_C, SCALE_SLOPE_PER_C * w), slope_w
        return (self.error_deg_s(w, T + inwards_c) - error) / inwards_c, slope_w

    @functools.cached_property
    def _variance_rows(self) -> tuple[tuple[float, ...], ...]:
        """x^T C x multiplied out once: for each power 0..6 of w the coefficients of T^0..T^4. (31)"""
        if not self.covariance:
            return ()
        rows = np.zeros((7, 5))
        for j, row in enumerate(self.covariance):
            for k, value in enumerate(row):
                rows[j // 3 + k // 3, j % 3 + k % 3] += value
        return tuple(tuple(row) for row in rows.tolist())


def load_calibration(file: Path) -> Calibration:
    """Read a calibration file. Raises ConfigError with file, key, expected and got."""
    where = str(file)
    try:
        data = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
        raise ConfigError(where, "calibration.file", "a readable YAML file", f"{where}: {reason}") from error
    if not isinstance(data, dict):
        raise ConfigError(where, "", "a section of keys", type(data).__name__)
    for name in data:
        if name not in KEYS:
            raise ConfigError(where, str(name), f"one of {', '.join(KEYS)}", "an unknown key")
    if data.get("format") != FORMAT:
        raise ConfigError(where, "format", repr(FORMAT), repr(data.get("format")))
    rows = data.get("error_deg_s")
    if not isinstance(rows, dict) or sorted(rows) != ["a0", "a1", "a2", "a3"]:
        raise ConfigError(where, "error_deg_s", "the keys a0, a1, a2, a3", repr(rows)[:80])
    b = [_numbers(rows[name], 3, where, f"error_deg_s.{name}") for name in ("a0", "a1", "a2", "a3")]
    residual = _residual(data.get("residual_deg_s"), where, "residual_deg_s")
    before = data.get("residual_before_deg_s")
    before = None if before is None else _residual(before, where, "residual_before_deg_s")
    provenance = data.get("provenance")
    if not isinstance(provenance, dict) or not provenance:
        raise ConfigError(where, "provenance", "keys that say where the coefficients come from", repr(provenance)[:80])
    rate_range = _range(data.get("rate_range_deg_s"), where, "rate_range_deg_s")
    temperature_range = _range(data.get("temperature_range_c"), where, "temperature_range_c")
    return Calibration(
        (
            (b[0][0], b[0][1], b[0][2]),
            (b[1][0], b[1][1], b[1][2]),
            (b[2][0], b[2][1], b[2][2]),
            (b[3][0], b[3][1], b[3][2]),
        ),
        rate_range,
        temperature_range,
        residual,
        {str(k): str(v) for k, v in provenance.items()},
        before,
        _covariance(data.get("covariance"), where),
    )


def _residual(value: Any, where: str, path: str) -> float:
    residual = _numbers([value], 1, where, path)[0]
    if residual < 0.0:
        raise ConfigError(where, path, "a number in deg/s from 0", f"{residual:g}")
    return residual


def _covariance(value: Any, where: str) -> tuple[tuple[float, ...], ...]:
    """Checked: 12 rows of 12, symmetric, positive semidefinite; empty where the file has none."""
    if value is None:
        return ()
    path, expected = "covariance", f"{COEFFICIENTS} rows of {COEFFICIENTS} numbers"
    if not isinstance(value, list) or len(value) != COEFFICIENTS:
        got = f"{len(value)} rows" if isinstance(value, list) else repr(value)[:80]
        raise ConfigError(where, path, expected, got)
    rows = [_numbers(row, COEFFICIENTS, where, f"{path}, row {i + 1}") for i, row in enumerate(value)]
    matrix = np.array(rows)
    variances = np.diag(matrix)
    if variances.min() < 0.0:
        raise ConfigError(where, path, "variances from 0 on the diagonal", f"{variances.min():g}")
    if matrix[variances == 0.0].any():
        raise ConfigError(where, path, "no covariance where the variance is 0", "one")
    sigma = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    with np.errstate(all="ignore"):  # of numbers near the largest
        correlation = matrix / np.outer(sigma, sigma)
        skew = float(np.abs(correlation - correlation.T).max())
    if not skew < INDEFINITE:
        raise ConfigError(where, path, "a symmetric matrix", f"correlations that differ by {skew:.2g}")
    lowest = float(np.linalg.eigvalsh(correlation)[0])
    if lowest < -INDEFINITE:
        raise ConfigError(
            where, path, "a positive semidefinite matrix", f"an eigenvalue of {lowest:.2g} of the correlation"
        )
    return tuple(tuple(row) for row in rows)


def _numbers(value: Any, count: int, where: str, path: str) -> list[float]:
    expected = f"{count} finite numbers" if count > 1 else "a finite number"
    if not isinstance(value, list) or len(value) != count:
        raise ConfigError(where, path, expected, repr(value)[:80])
    try:
        # PyYAML takes 2e-5 for a string (YAML 1.1 wants 2.0e-5); a number is meant.
        numbers = [float(v) for v in value if not isinstance(v, bool)]
    except (TypeError, ValueError, OverflowError):
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ConfigError(where, path, expected, repr(value)[:80])
    return numbers


def _range(value: Any, where: str, path: str) -> tuple[float, float]:
    low, high = _numbers(value, 2, where, path)
    if low >= high:
        raise ConfigError(where, path, "a low and a higher number", repr(value))
    return low, high
