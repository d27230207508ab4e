"""Simulated logs of gyros at standstill, for the tests of `drd calibrate noise`."""

from pathlib import Path

import numpy as np

from drd.arrays import Array
from drd.units import DEG_PER_RAD, RAD_PER_DEG
from drd_tools.calibrate.noise.intervals import unit_rates
from drd_tools.calibrate.noise.static_log import StaticLog

DEG_H = RAD_PER_DEG / 3600.0
DEG_ROOT_H = RAD_PER_DEG / 60.0
DEG_H_ROOT_H = DEG_H / 60.0


def rates(count: int, interval_s: float, coefficients: dict[str, float], seed: int) -> Array:
    """Noise of the five-term model, rad/s; coefficients in SI by their letter."""
    powers = {"Q": -1.0, "N": -0.5, "B": 0.0, "K": 0.5, "R": 1.0}
    unit = unit_rates(count, np.random.default_rng(seed))
    return np.asarray(
        sum(
            coefficients.get(name, 0.0) * interval_s**p * row
            for (name, p), row in zip(powers.items(), unit, strict=True)
        )
    )


def static_log(
    seconds: float = 1200.0, rate_hz: float = 10.0, seed: int = 1, bias_deg_h: float = 20.0, **coefficients: float
) -> StaticLog:
    """A log in memory; angle random walk of the RD2100's class unless N is given."""
    count = round(seconds * rate_hz)
    noise = rates(count, 1.0 / rate_hz, {"N": 0.083 * DEG_ROOT_H, **coefficients}, seed)
    return StaticLog("log.csv", "0" * 64, 1.0 / rate_hz, noise + bias_deg_h * DEG_H, None, 0.0)


def write_log(file: Path, log: StaticLog, temperature_c: Array | None = None) -> Path:
    """The same as a file."""
    columns = [log.time_s, log.rate_rad_s * DEG_PER_RAD] + ([] if temperature_c is None else [temperature_c])
    header = "time_s,rate_deg_s" + ("" if temperature_c is None else ",temperature_c")
    np.savetxt(file, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.9g")
    return file
