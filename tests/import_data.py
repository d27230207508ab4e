"""A simulated drive as recorded by other systems; every trap of an import can be set."""

from dataclasses import dataclass

import numpy as np

from drd.arrays import Array
from drd_tools.importing.examine import GyroRates, WheelTravel
from drd_tools.recordings.folder import ReferenceLog

RADIUS_M, TREAD_M = 0.1, 0.5
GRAVITY_M_S2 = 9.8


@dataclass(frozen=True)
class Traps:
    """Faults of the recording. Offsets: how much later a stream's stamps are, s."""

    axis: int = 2
    gyro_sign: float = 1.0
    gyro_factor: float = 1.0
    swapped: bool = False
    left_sign: float = 1.0
    right_sign: float = 1.0
    wheels_offset_s: float = 0.0
    reference_offset_s: float = 0.0
    has_gravity: bool = False
    turning: float = 1.0
    noise_rad_s: float = 0.01
    bias_rad_s: float = 0.003
    seconds: float = 120.0


def truth(rng: np.random.Generator, seconds: float, turning: float) -> tuple[Array, Array, Array]:
    """Times, speed and yaw rate at 200 Hz: new commands every second or so, smoothed by the robot's inertia."""
    time_s = np.arange(0.0, seconds, 0.005)
    legs = max(2, int(seconds / 1.3))
    speed, rate = rng.uniform(0.1, 0.8, legs), turning * rng.uniform(-0.8, 0.8, legs)
    which = np.minimum((time_s / 1.3).astype(int), legs - 1)
    kernel = np.exp(-np.arange(0.0, 1.0, 0.005) / 0.2)
    kernel /= kernel.sum()
    smooth = [np.convolve(values[which], kernel)[: len(time_s)] for values in (speed, rate)]
    return time_s, smooth[0], smooth[1]


def drive(seed: int, traps: Traps) -> tuple[GyroRates, WheelTravel, ReferenceLog]:
    """The three streams in SI units: gyro 100 Hz, wheels 20 Hz with counts of 0.15 mm, reference 10 Hz."""
    rng = np.random.default_rng(seed)
    time_s, speed, rate = truth(rng, traps.seconds, traps.turning)
    heading = np.cumsum(rate) * 0.005
    distance_m = np.cumsum(speed) * 0.005

    gyro_s = time_s[::2][1:]
    about = rng.normal(0.0, traps.noise_rad_s, (len(gyro_s), 3))
    about[:, traps.axis] += traps.gyro_sign * np.diff(np.interp(time_s[::2], time_s, heading)) / 0.01
    force = rng.normal(0.0, 0.5, about.shape)
    force[:, traps.axis] += traps.gyro_sign * GRAVITY_M_S2
    gyro = GyroRates(
        gyro_s,
        (about + traps.bias_rad_s) * traps.gyro_factor,
        ("x", "y", "z"),
        force if traps.has_gravity else None,
    )

    wheels_s = time_s[::10]
    sides = [np.interp(wheels_s, time_s, distance_m + s * heading * TREAD_M / 2.0) for s in (-1.0, 1.0)]
    left, right = (np.round(side / 1.5e-4) * 1.5e-4 for side in (sides[::-1] if traps.swapped else sides))
    wheels = WheelTravel(wheels_s + traps.wheels_offset_s, traps.left_sign * left, traps.right_sign * right, TREAD_M)

    at = slice(None, None, 20)
    x_m, y_m = (np.cumsum(speed * f(heading)) * 0.005 for f in (np.cos, np.sin))
    poses = [column[at] + rng.normal(0.0, sigma, len(time_s[at])) for column, sigma in
             ((x_m, 0.005), (y_m, 0.005), (heading, 0.002))]  # fmt: skip
    reference = ReferenceLog(time_s[at] + traps.reference_offset_s, *poses)
    return gyro, wheels, reference
