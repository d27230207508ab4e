"""An effect of the catalogue on an emulated robot, from some time on."""

from typing import Self

import numpy as np

from drd.arrays import Array
from drd.config.keys import Robot
from drd.effects.effect import Errors
from drd.effects.motion import Motion
from drd_tools.simulate.truth import Truth


def motion_of(truth: Truth, robot: Robot) -> Motion:
    """The drive as effects see it: perfect wheels and tread."""
    v, w, half_m = truth.speed_m_s, truth.rate_rad_s, 0.5 * robot.tread_m
    step_s = float(truth.duration_s) / len(v)
    left, right = v - half_m * w, v + half_m * w
    return Motion(
        time_s=truth.middle_s,
        rate_rad_s=w,
        speed_m_s=v,
        acceleration_m_s2=np.gradient(v, step_s),
        heading_rad=0.5 * (truth.heading_rad[1:] + truth.heading_rad[:-1]),
        left_m_s=left,
        right_m_s=right,
        left_wheel_rad=np.cumsum(left) * step_s / robot.wheel_radius_m,
        right_wheel_rad=np.cumsum(right) * step_s / robot.wheel_radius_m,
        temperature_c=truth.temperature_c,
        still_c=float(truth.temperature_c[0]),
        tread_m=robot.tread_m,
        end_s=truth.duration_s,
    )


class Fault:
    """What an effect has added to both wheels' ways, m, and to the gyro's angle, rad, by a time since the start."""

    def __init__(self, time_s: Array, added: Array):
        """`time_s` (n,); `added` (3, n): left, right, gyro by these times."""
        self._time_s, self._added = time_s, added

    @classmethod
    def of(cls, errors: Errors, motion: Motion) -> Self:
        """Of an effect's errors along a motion."""
        step_s = np.diff(motion.time_s, prepend=0.0)
        rates = (errors.left_m_s, errors.right_m_s, errors.gyro_rad_s)
        return cls(motion.time_s, np.stack([np.cumsum((np.zeros_like(step_s) + r) * step_s) for r in rates]))

    def by(self, t_s: float) -> Array:
        """Shape (3,): left, right, gyro."""
        return np.array([np.interp(t_s, self._time_s, row) for row in self._added])
