"""The gyro's stored calibration: the temperature-varying cubic error function, its range and its provenance."""

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from drd.config.schema import ConfigError, load, named_by
from drd.estimation.covariance import unfit
from drd.samples import CalibratedRate, GyroSample
from drd.units import DEG_PER_RAD, RAD_PER_DEG

FORMAT = "drd-gyro-calibration/1"
Row = tuple[float, float, float]
Row12 = Annotated[tuple[float, ...], "12 finite numbers", Meta(min_length=12, max_length=12)]
Residual = Annotated[float, "deg/s", Meta(ge=0)]
# Slopes of a gyro that was calibrated at one temperature only: Table I, peak to peak over -40 to 75 degC.
BIAS_SLOPE_DEG_S_C, SCALE_SLOPE_PER_C = 0.2 / 115.0, 0.02 / 115.0
# A cubic's residual varies over an eighth of the range of rates, about the distance between its zeros. (23)
RATE_LENGTHS = 8.0


@dataclass(frozen=True)
class Calibration:
    """e(w, T) = sum_i (b_i0 + b_i1 T + b_i2 T^2) w^i, i = 0..3, with w in deg/s and T in degC. (2), (3), (5)

    `rows` are the b of each power of w; the rate is the reading after sign and axis (counter-clockwise positive).
    `residual_deg_s`, `residual_before_deg_s`: rms error of new data after and before the correction. `covariance`:
    that of the twelve b, w^0 first and within each power of w T^0 first, shape (12, 12); empty if unknown.
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
        """Whether rate and temperature lie in the range in which the calibration was measured."""
        (low, high), (cold, warm) = self.rate_range_deg_s, self.temperature_range_c
        return low <= sample.rate_rad_s * DEG_PER_RAD <= high and cold <= sample.temperature_c <= warm

    def correct(self, sample: GyroSample) -> CalibratedRate:
        """Correct a sample by (6). Outside the range the correction keeps its value at the border; sigma grows. (21)

        Sigma is that of the rate's error beyond the error at rest, which a measured bias removes. (23)
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
            variance += (v0 + (v1 + (v2 + (v3 + v4 * T) * T) * T) * T) * power  # (22)
            power *= w
        variance = max(variance, 0.0) + self.residual_deg_s**2
        lengths = RATE_LENGTHS * w / (high - low)
        variance *= -2.0 * math.expm1(-0.5 * lengths * lengths)  # (23)
        if spread_c or w != rate:
            slope_c, slope_w = self._slopes(w, T, error)
            variance += (slope_c * spread_c) ** 2 + (slope_w * (rate - w)) ** 2  # (21)
        return CalibratedRate(
            sample.t_ns, sample.interval_s, sample.rate_rad_s - error * RAD_PER_DEG, math.sqrt(variance) * RAD_PER_DEG
        )

    def _slopes(self, w: float, T: float, error: float) -> tuple[float, float]:
        """de/dT and de/dw at the border, taken inwards. (21)"""
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
        """x^T C x multiplied out once: for each power 0..6 of w the coefficients of T^0..T^4. (22)"""
        if not self.covariance:
            return ()
        rows = np.zeros((7, 5))
        for j, row in enumerate(self.covariance):
            for k, value in enumerate(row):
                rows[j // 3 + k // 3, j % 3 + k % 3] += value
        return tuple(tuple(row) for row in rows.tolist())


@dataclass(frozen=True)
class _Rows:
    """The coefficients of each power of w."""

    a0: Row
    a1: Row
    a2: Row
    a3: Row


@dataclass(frozen=True, kw_only=True)
class _File:
    """A calibration file."""

    format: Literal["drd-gyro-calibration/1"]
    error_deg_s: _Rows
    rate_range_deg_s: tuple[float, float]
    temperature_range_c: tuple[float, float]
    residual_deg_s: Residual
    provenance: dict[str, str]
    residual_before_deg_s: Residual | None = None
    covariance: Annotated[tuple[Row12, ...], "12 rows of 12 numbers", Meta(min_length=12, max_length=12)] | None = None


def load_calibration(file: Path) -> Calibration:
    """Read a calibration file. Raises ConfigError with file, line, key, expected and got."""
    with named_by("calibration.file", file):
        loaded = load(file, _File)
    f, wrong = loaded.value, list[tuple[str, str, str]]()
    for path in ("rate_range_deg_s", "temperature_range_c"):
        low, high = getattr(f, path)
        if low >= high:
            wrong.append((path, "a low and a higher number", f"{low:g} and {high:g}"))
    if not f.provenance:
        wrong.append(("provenance", "keys that state the origin of the coefficients", "none"))
    if f.covariance is not None and (found := unfit(np.array(f.covariance))) is not None:
        wrong.append(("covariance", *found))
    for path, expected, got in wrong:
        raise ConfigError(loaded.place(path), path, expected, got)
    rows = (f.error_deg_s.a0, f.error_deg_s.a1, f.error_deg_s.a2, f.error_deg_s.a3)
    ranges = f.rate_range_deg_s, f.temperature_range_c
    before, covariance = f.residual_before_deg_s, f.covariance or ()
    return Calibration(rows, *ranges, f.residual_deg_s, f.provenance, before, covariance)
