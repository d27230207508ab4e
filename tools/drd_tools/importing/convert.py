"""Conversion from a source's units, axes and sides to those of the recording folder."""

import math
from dataclasses import dataclass, replace

import numpy as np

from drd.arrays import Array
from drd.config.robot import Robot
from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD, NS_PER_S, RAD_PER_DEG, S_PER_NS
from drd_tools.importing.examine import GyroRates, WheelTravel
from drd_tools.importing.streams import Gyro, Reference, Times, Wheels
from drd_tools.recordings.folder import ReferenceLog, continuous_rad

RAD_S_PER_RPM = 2.0 * math.pi / 60.0


@dataclass(frozen=True)
class EncoderRows:
    """Rows of encoders.csv, shape (n,) each: cumulative counts, or mean speeds in rad/s since the row before."""

    time_ns: Times
    left: Array
    right: Array
    are_counts: bool

    def angles_rad(self, counts_per_revolution: float | None) -> tuple[Array, Array]:
        """Angles of the sides since the first row."""
        if self.are_counts:
            assert counts_per_revolution is not None
            factor = 2.0 * math.pi / counts_per_revolution
            return (self.left - self.left[0]) * factor, (self.right - self.right[0]) * factor
        step_s = steps_s(self.time_ns)
        return np.cumsum(self.left * step_s), np.cumsum(self.right * step_s)

    def changed(self, *, swap: bool, reverse: str | None) -> "EncoderRows":
        """Exchange the sides if `swap`, then invert the signs of `reverse` (left, right or both)."""
        left, right = (self.right, self.left) if swap else (self.left, self.right)
        left = -left if reverse in ("left", "both") else left
        right = -right if reverse in ("right", "both") else right
        # Avoid -0.0.
        return replace(self, left=left + 0.0, right=right + 0.0)


def steps_s(time_ns: Times) -> Array:
    """Time since the row before, 0 for the first, shape (n,)."""
    return np.diff(time_ns, prepend=time_ns[0]) * S_PER_NS


def gyro_rad_s(gyro: Gyro, unit: str) -> Array:
    """Rates in rad/s, shape (n, k). For angles, the first row uses the typical interval, as it has none."""
    value = gyro.value * (RAD_PER_DEG if unit in ("deg_s", "deg") else 1.0)
    if unit in ("rad_s", "deg_s"):
        return value
    step_s = steps_s(gyro.time_ns)
    typical_s = float(np.median(step_s[1:])) if len(step_s) > 1 else 1.0
    step_s[0] = typical_s
    # After a gap the angle is still that of one sample.
    return np.asarray(value / np.where(step_s > 1.5 * typical_s, typical_s, step_s)[:, None])


def encoder_rows(wheels: Wheels, nominal: Robot) -> EncoderRows:
    """Make rows of encoders.csv. Cumulative angles and travels become mean speeds, without loss."""
    left, right, radius_m = wheels.left, wheels.right, nominal.wheel_radius_m
    if wheels.unit == "counts":
        return EncoderRows(wheels.time_ns, _unwrapped(left, wheels), _unwrapped(right, wheels), are_counts=True)
    if wheels.unit in ("rad", "m"):
        left, right = (_mean_speed(side, wheels.time_ns) for side in (left, right))
    elif wheels.unit == "twist":
        half_m_s = right * nominal.tread_m / 2.0
        left, right = left - half_m_s, left + half_m_s
    factor = {"rad": 1.0, "rad_s": 1.0, "rpm": RAD_S_PER_RPM}.get(wheels.unit, 1.0 / radius_m)
    return EncoderRows(wheels.time_ns, left * factor, right * factor, are_counts=False)


def _unwrapped(counts: Array, wheels: Wheels) -> Array:
    broken = np.flatnonzero(counts != np.round(counts))
    if broken.size:
        expected = "whole numbers of counts (rad or m for angles and travels)"
        raise ConfigError("--wheels-unit", "counts", expected, f"{counts[broken[0]]:.12g}")
    if wheels.modulus_counts is None:
        return counts
    modulus = float(wheels.modulus_counts)
    steps = np.diff(counts, prepend=counts[0])
    return np.asarray(counts[0] + np.cumsum((steps + modulus / 2.0) % modulus - modulus / 2.0))


def _mean_speed(cumulative: Array, time_ns: Times) -> Array:
    step_s = steps_s(time_ns)
    step_s[0] = 1.0
    return np.asarray(np.diff(cumulative, prepend=cumulative[0]) / step_s)


def seconds(time_ns: Times, zero_ns: int) -> Array:
    """Times since `zero_ns`, in s."""
    return np.asarray((time_ns - zero_ns) / NS_PER_S)


def for_checks(
    gyro: Gyro | None, gyro_unit: str, rows: EncoderRows | None, nominal: Robot | None, reference: Reference | None,
    zero_ns: int,
) -> tuple[GyroRates | None, WheelTravel | None, ReferenceLog | None]:  # fmt: skip
    """Make the three streams in SI units on one clock, with signs and sides as imported."""
    rates = travel = poses = None
    if gyro is not None:
        rates = GyroRates(
            seconds(gyro.time_ns, zero_ns), gyro_rad_s(gyro, gyro_unit), gyro.axes, gyro.acceleration_m_s2
        )
    if rows is not None and nominal is not None:
        radius_m = nominal.wheel_radius_m
        left, right = (radius_m * side for side in rows.angles_rad(nominal.counts_per_revolution))
        travel = WheelTravel(seconds(rows.time_ns, zero_ns), left, right, nominal.tread_m)
    if reference is not None:
        heading = continuous_rad(reference.heading_rad * DEG_PER_RAD)
        poses = ReferenceLog(seconds(reference.time_ns, zero_ns), reference.x_m, reference.y_m, heading)
    return rates, travel, poses
