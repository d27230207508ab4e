"""The gyro's stored calibration: the temperature-varying cubic error function, its range and its provenance."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from drd.samples import CalibratedRate, GyroSample
from drd.schema import ConfigError
from drd.units import DEG_PER_RAD, RAD_PER_DEG

FORMAT = "drd-gyro-calibration/1"
Row = tuple[float, float, float]
ZERO: tuple[Row, Row, Row, Row] = ((0.0, 0.0, 0.0),) * 4


@dataclass(frozen=True, slots=True)
class Calibration:
    """e(w, T) = sum_i (b_i0 + b_i1 T + b_i2 T^2) w^i, i = 0..3, with w in deg/s and T in degC. (2), (3), (5)

    `rows` are the b of each power of w; the rate is the reading after sign and axis (counter-clockwise positive).
    """

    rows: tuple[Row, Row, Row, Row]
    rate_range_deg_s: tuple[float, float]
    temperature_range_c: tuple[float, float]
    residual_deg_s: float
    provenance: dict[str, str]

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
        """Equation (6). Outside the range the correction stays at the border's value and its sigma widens. (28)"""
        rate, temperature = sample.rate_rad_s * DEG_PER_RAD, sample.temperature_c
        (low, high), (cold, warm) = self.rate_range_deg_s, self.temperature_range_c
        w = min(max(rate, low), high)
        if math.isnan(temperature):
            T, spread_c = 0.5 * (cold + warm), 0.5 * (warm - cold)
        else:
            T = min(max(temperature, cold), warm)
            spread_c = abs(temperature - T)
        error = self.error_deg_s(w, T)
        variance = self.residual_deg_s**2
        if spread_c or w != rate:
            step_c, step_w = 0.01 * (warm - cold), 0.01 * (high - low)
            inwards_c = -step_c if T + step_c > warm else step_c
            inwards_w = -step_w if w + step_w > high else step_w
            slope_c = (self.error_deg_s(w, T + inwards_c) - error) / inwards_c
            slope_w = (self.error_deg_s(w + inwards_w, T) - error) / inwards_w
            variance += (slope_c * spread_c) ** 2 + (slope_w * (rate - w)) ** 2  # (28)
        return CalibratedRate(
            sample.t_ns, sample.interval_s, sample.rate_rad_s - error * RAD_PER_DEG, math.sqrt(variance) * RAD_PER_DEG
        )


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
    known = ("format", "error_deg_s", "rate_range_deg_s", "temperature_range_c", "residual_deg_s", "provenance")
    for name in data:
        if name not in known:
            raise ConfigError(where, str(name), f"one of {', '.join(known)}", "an unknown key")
    if data.get("format") != FORMAT:
        raise ConfigError(where, "format", repr(FORMAT), repr(data.get("format")))
    rows = data.get("error_deg_s")
    if not isinstance(rows, dict) or sorted(rows) != ["a0", "a1", "a2", "a3"]:
        raise ConfigError(where, "error_deg_s", "the keys a0, a1, a2, a3", repr(rows)[:80])
    b = [_numbers(rows[name], 3, where, f"error_deg_s.{name}") for name in ("a0", "a1", "a2", "a3")]
    residual = _numbers([data.get("residual_deg_s")], 1, where, "residual_deg_s")[0]
    if residual < 0.0:
        raise ConfigError(where, "residual_deg_s", "a number in deg/s from 0", f"{residual:g}")
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
    )


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
