"""Readings of a gyro and two wheel counters, sample by sample, without a time limit: for demonstrations and tests."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from drd.config.keys import Robot
from drd.units import RAD_PER_DEG
from drd_tools.emulate.fault import Fault
from drd_tools.simulate.sensors import white_rad_s
from drd_tools.simulate.temperature import warming_c
from drd_tools.simulate.truth import Place


class TruePath(Protocol):
    """A true motion."""

    def at(self, t_s: float) -> Place:
        """Place `t_s` after the start."""
        ...


@dataclass(frozen=True, kw_only=True)
class SensorErrors:
    """Errors of a gyro of the KVH RD2100's class (its datasheet, quoted as Table I of the paper), and of a robot
    measured with a tape: 0.1 to 0.2 % of radius, 2 % of effective tread.

    `clock_error_percent`: how much faster than nominal the packets come (DSP-3000 manual 54-0215: 2 to 3 % unit to
    unit). The temperature rises by `warm_up_c` with the time constant `warm_up_s`, and the bias with it. `*_error` of
    the wheels and the tread: how much the true sizes exceed what the configuration believes.
    """

    bias_deg_s: float = 0.02
    scale_error: float = 0.003
    angle_random_walk_deg_per_sqrt_h: float = 5 / 60  # 5 deg/h/sqrt(Hz)
    clock_error_percent: float = 1.0
    temperature_c: float = 22.0
    warm_up_c: float = 8.0
    warm_up_s: float = 300.0
    bias_deg_s_per_c: float = 0.0
    left_radius_error: float = 0.001
    right_radius_error: float = -0.001
    tread_error: float = 0.02
    slip_m_per_sqrt_m: float = 0.002


class Sensors:
    """Sensors of a robot whose nominal radius and tread are the configuration's. `seed` repeats the noise.

    `fault`: errors of an effect.
    """

    def __init__(self, path: TruePath, robot: Robot, errors: SensorErrors, seed: int, fault: Fault | None = None):
        self._path, self._errors, self._fault = path, errors, fault
        self._half_tread_m = robot.tread_m * (1 + errors.tread_error) / 2
        self._white, self._slip = (np.random.default_rng([seed, source]) for source in (1, 2))
        self._travel_m = self._counted_m = np.zeros(2)  # left and right: of the true wheels, and of the counters

    def rate_rad_s(self, from_s: float, to_s: float) -> float:
        """The gyro's mean yaw rate (ccw positive) from one time to a later one; each call draws new noise."""
        e, interval_s = self._errors, to_s - from_s
        turned_rad = self._path.at(to_s).heading_rad - self._path.at(from_s).heading_rad
        added_rad = 0.0 if self._fault is None else float((self._fault.by(to_s) - self._fault.by(from_s))[2])
        bias_deg_s = e.bias_deg_s + e.bias_deg_s_per_c * (self.temperature_c(to_s) - e.temperature_c)
        noise_rad_s = white_rad_s(e.angle_random_walk_deg_per_sqrt_h, interval_s) * self._white.standard_normal()
        return ((1 + e.scale_error) * turned_rad + added_rad) / interval_s + bias_deg_s * RAD_PER_DEG + noise_rad_s

    def temperature_c(self, t_s: float) -> float:
        """Temperature of the gyro."""
        e = self._errors
        return float(warming_c(np.array(max(t_s, 0.0)), e.temperature_c, e.warm_up_c, e.warm_up_s))

    def travel_m(self, t_s: float, left_slip: float = 0.0, right_slip: float = 0.0) -> tuple[float, float]:
        """Travel measured by the two counters since the start, forward positive. Call with increasing times.

        `left_slip`, `right_slip`: share of extra counts since the previous call (0.1: 10 % too much; -1: none at all).
        """
        e, place = self._errors, self._path.at(t_s)
        side_m = place.heading_rad * self._half_tread_m
        before_m, self._travel_m = self._travel_m, np.array((place.distance_m - side_m, place.distance_m + side_m))
        steps_m = self._travel_m - before_m
        noise_m = e.slip_m_per_sqrt_m * np.sqrt(np.abs(steps_m)) * self._slip.standard_normal(2)
        # A wheel larger than nominal turns less over the same distance.
        turned_m = steps_m / (1.0 + np.array((e.left_radius_error, e.right_radius_error))) + noise_m
        self._counted_m = self._counted_m + (1.0 + np.array((left_slip, right_slip))) * turned_m
        added_m = 0.0 if self._fault is None else self._fault.by(t_s)[:2]
        left_m, right_m = (self._counted_m + added_m).tolist()
        return left_m, right_m
