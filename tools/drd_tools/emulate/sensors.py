"""What a gyro and two wheel counters say about a drive: a modest error model, for demonstrations and tests."""

import math
from dataclasses import dataclass, field

import numpy as np

from drd.config.keys import Robot
from drd.units import RAD_PER_DEG, RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H
from drd_tools.emulate.drive import Drive


@dataclass(frozen=True, kw_only=True)
class GyroErrors:
    """Errors of one gyro; the defaults are of the KVH RD2100's class (its data sheet, quoted as Table I of the paper).

    `clock_error_percent`: how much faster than nominal the packets come (DSP-3000 manual 54-0215: 2 to 3 % unit to
    unit). The temperature rises by `warm_up_c` with the time constant `warm_up_s`, and the bias with it.
    """

    bias_deg_s: float = 0.02
    scale_error: float = 0.003
    angle_random_walk_deg_per_sqrt_h: float = 5 / 60  # 5 deg/h/sqrt(Hz)
    clock_error_percent: float = 1.0
    temperature_c: float = 22.0
    warm_up_c: float = 8.0
    warm_up_s: float = 300.0
    bias_deg_s_per_c: float = 0.0


@dataclass(frozen=True, kw_only=True)
class WheelErrors:
    """Errors of the wheels: how much the true sizes exceed what the configuration believes, and slip.

    The defaults are a robot that was measured with a tape: 0.1 to 0.2 % of radius, 2 % of effective tread.
    """

    left_radius_error: float = 0.001
    right_radius_error: float = -0.001
    tread_error: float = 0.02
    slip_m_per_sqrt_m: float = 0.002


@dataclass(frozen=True)
class SensorErrors:
    """The errors of both sensors."""

    gyro: GyroErrors = field(default_factory=GyroErrors)
    wheels: WheelErrors = field(default_factory=WheelErrors)

    @staticmethod
    def none() -> "SensorErrors":
        """Perfect sensors on a perfectly known robot."""
        return SensorErrors(
            GyroErrors(
                bias_deg_s=0,
                scale_error=0,
                angle_random_walk_deg_per_sqrt_h=0,
                clock_error_percent=0,
                warm_up_c=0,
            ),
            WheelErrors(left_radius_error=0, right_radius_error=0, tread_error=0, slip_m_per_sqrt_m=0),
        )


class Gyro:
    """A gyro on the robot."""

    def __init__(self, drive: Drive, errors: GyroErrors, seed: int):
        self._drive, self._errors = drive, errors
        self._random = np.random.default_rng([seed, 1])

    def mean_rate_rad_s(self, from_s: float, to_s: float) -> float:
        """Measured mean yaw rate (ccw positive) from one time to a later one; each call draws new noise."""
        e, interval_s = self._errors, to_s - from_s
        turned_rad = self._drive.at(to_s).heading_rad - self._drive.at(from_s).heading_rad
        bias_deg_s = e.bias_deg_s + e.bias_deg_s_per_c * (self.temperature_at_c(to_s) - e.temperature_c)
        walk = e.angle_random_walk_deg_per_sqrt_h * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H / math.sqrt(interval_s)
        noise_rad_s = walk * self._random.standard_normal()
        return (1 + e.scale_error) * turned_rad / interval_s + bias_deg_s * RAD_PER_DEG + noise_rad_s

    def temperature_at_c(self, t_s: float) -> float:
        """The gyro's temperature."""
        e = self._errors
        return e.temperature_c + e.warm_up_c * (1 - math.exp(-max(t_s, 0.0) / e.warm_up_s))


class Wheels:
    """Two wheels whose counters are read through the radius and tread that the configuration believes."""

    def __init__(self, drive: Drive, robot: Robot, errors: WheelErrors, seed: int):
        self._drive, self._errors = drive, errors
        self._half_tread_m = robot.tread_m * (1 + errors.tread_error) / 2
        self._random = np.random.default_rng([seed, 2])
        self._travel_m = (0.0, 0.0)  # of the true wheels, since the start
        self._counted_m = (0.0, 0.0)

    def travel_at_m(self, t_s: float, left_slip: float = 0.0, right_slip: float = 0.0) -> tuple[float, float]:
        """What left and right wheel have counted since the start, m, forward positive. Call with rising times.

        `left_slip`, `right_slip`: share of extra counts since the previous call (0.1: 10 % too much; -1: none at all).
        """
        e = self._errors
        along_m, sideways_m = self._drive.travel_m(t_s), self._drive.at(t_s).heading_rad * self._half_tread_m
        left_m, right_m = along_m - sideways_m, along_m + sideways_m
        left_step_m, right_step_m = left_m - self._travel_m[0], right_m - self._travel_m[1]
        self._travel_m = (left_m, right_m)
        self._counted_m = (
            self._counted_m[0] + self._counted_step_m(left_step_m, e.left_radius_error, left_slip),
            self._counted_m[1] + self._counted_step_m(right_step_m, e.right_radius_error, right_slip),
        )
        return self._counted_m

    def _counted_step_m(self, step_m: float, radius_error: float, slip: float) -> float:
        noise_m = self._errors.slip_m_per_sqrt_m * math.sqrt(abs(step_m)) * self._random.standard_normal()
        # A wheel that is larger than believed turns less on the same way.
        return (1 + slip) * (step_m / (1 + radius_error) + noise_m)
