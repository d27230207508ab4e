"""A robot drawn at random from the filter's prior, and its true path."""

import math

import numpy as np
import numpy.typing as npt

from drd.estimation.filter import Filter
from drd.estimation.noise import NoiseProfile
from drd.estimation.state import N, Sigmas

TREAD_M = 0.588
STEP_S = 0.05


class Truth:
    """A robot drawn from the prior and driven with the process noise of the model; errors are computed minus true."""

    def __init__(self, rng: np.random.Generator, kf: Filter, s: Sigmas, k: NoiseProfile):
        self.rng, self.k, self.kf = rng, k, kf
        draw = rng.normal(size=N - 1)
        self.x, self.y, self.heading = -s.position_m * draw[0], -s.position_m * draw[1], -s.heading_rad * draw[2]
        self.scale_right, self.scale_left = s.wheel_scale * draw[3], s.wheel_scale * draw[4]
        self.tread = TREAD_M - s.tread_m * draw[5]
        self.gyro_scale, self.bias = 1.0 - s.gyro_scale * draw[6], -s.gyro_bias_rad_s * draw[7]
        self.gyro_walk = -s.heading_rad * draw[2] - self.heading

    def drive(self, t_s: float) -> tuple[float, float, float]:
        """Move one step; return the readings of encoders and gyro (left, right, rate)."""
        k, rng = self.k, self.rng
        speed, rate = 1.0, 0.5 * math.sin(0.35 * t_s) + 0.2
        right, left = (speed + 0.5 * rate * self.tread) * STEP_S, (speed - 0.5 * rate * self.tread) * STEP_S
        turn = rate * STEP_S
        slip_r, slip_l = (math.sqrt(k.wheel_m2_per_m * u) * rng.normal() for u in (right, left))
        middle = self.heading + 0.5 * turn
        side = math.sqrt(k.lateral_m2_per_m * 0.5 * (right + left)) * rng.normal()
        self.x += speed * STEP_S * math.cos(middle) - side * math.sin(middle)
        self.y += speed * STEP_S * math.sin(middle) + side * math.cos(middle)
        self.x += math.sqrt(k.position_m2_per_rad * abs(turn)) * rng.normal()
        self.y += math.sqrt(k.position_m2_per_rad * abs(turn)) * rng.normal()
        self.heading += turn
        skid = math.sqrt(k.turn_rad2_per_rad * abs(turn)) * rng.normal() * 0.5 * self.tread
        read_right, read_left = right + slip_r + skid, left + slip_l - skid
        gyro = turn + math.sqrt(k.gyro_rad2_per_s * STEP_S) * rng.normal()
        reading = (gyro / STEP_S - self.bias) / self.gyro_scale
        self.scale_right += math.sqrt(k.wheel_scale_per_m * right) * rng.normal()
        self.scale_left += math.sqrt(k.wheel_scale_per_m * left) * rng.normal()
        self.tread += math.sqrt(k.tread_m2_per_rad * abs(turn)) * rng.normal()
        self.bias += math.sqrt(k.gyro_bias_rad2_s2_per_s * STEP_S) * rng.normal()
        return read_left / (1.0 - self.scale_left), read_right / (1.0 - self.scale_right), reading

    def error(self) -> npt.NDArray[np.float64]:
        """The error state without the gyro's heading: the eight states with a true value."""
        n = self.kf.nominal
        return np.array(
            [
                n.x_m - self.x,
                n.y_m - self.y,
                n.heading_rad - self.heading,
                self.scale_right - n.scale_right,
                self.scale_left - n.scale_left,
                n.tread_m - self.tread,
                n.gyro_scale - self.gyro_scale,
                n.gyro_bias_rad_s - self.bias,
            ]
        )


STATES = [0, 1, 2, 3, 4, 5, 7, 8]
