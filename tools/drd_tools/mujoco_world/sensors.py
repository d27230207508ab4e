"""What the robot's sensors and the tracker make of the motion."""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from drd.units import (
    DEG_PER_RAD,
    RAD_PER_DEG,
    RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H,
    RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H,
)
from drd_tools.mujoco_world.ground import Array
from drd_tools.mujoco_world.vehicle import Vehicle
from drd_tools.mujoco_world.world import ROW_HZ, Motion, random_of

FOG_HZ: Final = 10
ENCODERS_HZ: Final = 20
COUNTS_PER_REVOLUTION: Final = 8192
# KVH RD2100, Table I of the paper; the bias walk is an assumption.
RANGE_DEG_S: Final = 100.0
ANGLE_WALK_DEG_PER_SQRT_H: Final = 0.0833
REPEATABILITY_DEG_S: Final = 0.02
BIAS_WALK_DEG_PER_H_PER_SQRT_H: Final = 3.7
RESOLUTION_DEG_S: Final = 0.004
POSITION_SIGMA_M: Final = 0.01
HEADING_SIGMA_DEG: Final = 0.15
# The gyro warms itself up: T = COLD + WARMER (1 - exp(-t / WARMING)), and its bias follows T.
COLD_C: Final = 20.0
WARMER_C: Final = 8.0
WARMING_S: Final = 600.0
BIAS_DEG_S_PER_C: Final = 0.0003
THERMOMETER_C: Final = 0.1


@dataclass(frozen=True)
class Reference:
    """Poses every `period_s`, at the two ends only (None), or none at all."""

    period_s: float | None = 0.1
    is_there: bool = True


@dataclass(frozen=True)
class Readings:
    """Rows of the three files, shape (n, columns), in their units; and the gyro's bias at switch-on."""

    fog: Array
    encoders: Array
    reference: Array | None
    bias_deg_s: float


def read_sensors(motion: Motion, reference: Reference, seed: int) -> Readings:
    """Sample the motion. The same arguments give the same bits."""
    bias_deg_s = REPEATABILITY_DEG_S * float(random_of(seed, 10).standard_normal())
    return Readings(
        _fog(motion, bias_deg_s, seed), _encoders(motion, seed), _poses(motion, reference, seed), bias_deg_s
    )


def robot_yaml(vehicle: Vehicle, name: str, stand_s: float) -> dict[str, Any]:
    """What the robot's engineers believe: the drawing's track and radius, the data sheets' noise."""
    return {
        "name": name,
        "wheel": {"radius_m": vehicle.wheel_radius_m, "counts_per_revolution": COUNTS_PER_REVOLUTION},
        "tread_m": vehicle.track_m,
        "fog": {
            "kind": "KVH RD2100",
            "rate_hz": FOG_HZ,
            "range_deg_s": RANGE_DEG_S,
            "angle_random_walk_deg_per_sqrt_h": ANGLE_WALK_DEG_PER_SQRT_H,
            "bias_repeatability_deg_s": REPEATABILITY_DEG_S,
            "bias_random_walk_deg_per_h_per_sqrt_h": BIAS_WALK_DEG_PER_H_PER_SQRT_H,
            "resolution_deg_s": RESOLUTION_DEG_S,
        },
        "encoders": {"rate_hz": ENCODERS_HZ, "slip_noise_m_per_sqrt_m": 0.002},
        "reference": {"position_sigma_m": POSITION_SIGMA_M, "heading_sigma_deg": HEADING_SIGMA_DEG},
        "standstill_at_start_s": stand_s,
    }


def gyro_truth(readings: Readings) -> dict[str, float]:
    """What robot.yaml does not know of the gyro; its bias is that at switch-on + slope (T - COLD_C)."""
    return {
        "bias_at_switch_on_deg_s": round(readings.bias_deg_s, 9),
        "bias_temperature_deg_s_per_c": BIAS_DEG_S_PER_C,
        "switch_on_c": COLD_C,
    }


def _fog(motion: Motion, bias_deg_s: float, seed: int) -> Array:
    """Each row: mean of the rate over the interval that ends there."""
    every, interval_s = ROW_HZ // FOG_HZ, 1.0 / FOG_HZ
    time_s = motion.time_s[::every][1:]
    n = len(time_s)
    temperature_c = COLD_C + WARMER_C * (1.0 - np.exp(-time_s / WARMING_S))
    white = ANGLE_WALK_DEG_PER_SQRT_H * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H / math.sqrt(interval_s)
    walk = BIAS_WALK_DEG_PER_H_PER_SQRT_H * RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H * math.sqrt(interval_s)
    bias = bias_deg_s * RAD_PER_DEG + np.cumsum(walk * random_of(seed, 12).standard_normal(n))
    bias += BIAS_DEG_S_PER_C * RAD_PER_DEG * (temperature_c - COLD_C)
    rate = np.diff(motion.gyro_rad[::every]) / interval_s + bias + white * random_of(seed, 11).standard_normal(n)
    rate_deg_s = np.clip(_rounded(rate * DEG_PER_RAD, RESOLUTION_DEG_S), -RANGE_DEG_S, RANGE_DEG_S)
    return np.column_stack((time_s, rate_deg_s, _rounded(temperature_c, THERMOMETER_C)))


def _encoders(motion: Motion, seed: int) -> Array:
    every = ROW_HZ // ENCODERS_HZ
    per_rad = COUNTS_PER_REVOLUTION / (2.0 * math.pi)
    start = random_of(seed, 13).random(2)  # where between two counts a wheel stands at first
    counts = [
        np.floor(angle[::every] * per_rad + at)
        for angle, at in zip((motion.left_rad, motion.right_rad), start, strict=True)
    ]
    return np.column_stack((motion.time_s[::every], *counts))


def _poses(motion: Motion, reference: Reference, seed: int) -> Array | None:
    if not reference.is_there:
        return None
    last = len(motion.time_s) - 1
    every = last if reference.period_s is None else max(1, round(reference.period_s * ROW_HZ))
    at = np.arange(0, last + 1, every)
    noise = random_of(seed, 14).standard_normal((3, len(motion.time_s)))[:, at]
    return np.column_stack((
        motion.time_s[at],
        motion.x_m[at] + POSITION_SIGMA_M * noise[0],
        motion.y_m[at] + POSITION_SIGMA_M * noise[1],
        motion.heading_rad[at] * DEG_PER_RAD + HEADING_SIGMA_DEG * noise[2],
    ))  # fmt: skip


def _rounded(values: Array, unit: float) -> Array:
    return np.round(values / unit) * unit
