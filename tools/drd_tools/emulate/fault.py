"""An effect of the catalogue on an emulated robot, from some time on."""

from typing import Self

import numpy as np

from drd.arrays import Array
from drd.effects.effect import Errors
from drd.effects.motion import Motion


class Fault:
    """What an effect has added to both wheels' ways, m, and to the gyro's angle, rad, by a time since the start."""

    def __init__(self, time_s: Array, added: Array):
        """`time_s` (n,); `added` (3, n): left, right, gyro by these times."""
        self._time_s, self._added = time_s, added

    @classmethod
    def of(cls, errors: Errors, motion: Motion) -> Self:
        """Integrate an effect's errors along a motion."""
        step_s = np.diff(motion.time_s, prepend=0.0)
        rates = (errors.left_m_s, errors.right_m_s, errors.gyro_rad_s)
        return cls(motion.time_s, np.stack([np.cumsum((np.zeros_like(step_s) + r) * step_s) for r in rates]))

    def by(self, t_s: float) -> Array:
        """What was added by a time, shape (3,): left, right, gyro."""
        return np.array([np.interp(t_s, self._time_s, row) for row in self._added])
