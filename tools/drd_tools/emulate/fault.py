"""An effect of the catalogue that starts at some time on an emulated robot."""

from typing import Self

import numpy as np

from drd.arrays import Array
from drd.effects.effect import Errors
from drd.effects.motion import Motion


class Fault:
    """Accumulated errors of an effect over time: in both wheels' travel, m, and in the gyro's angle, rad."""

    def __init__(self, time_s: Array, added: Array):
        """Set the errors: `time_s` (n,); `added` (3, n): left, right, gyro at these times."""
        self._time_s, self._added = time_s, added

    @classmethod
    def of(cls, errors: Errors, motion: Motion) -> Self:
        """Integrate an effect's errors along a motion."""
        step_s = np.diff(motion.time_s, prepend=0.0)
        rates = (errors.left_m_s, errors.right_m_s, errors.gyro_rad_s)
        return cls(motion.time_s, np.stack([np.cumsum((np.zeros_like(step_s) + r) * step_s) for r in rates]))

    def by(self, t_s: float) -> Array:
        """Accumulated errors at a time, shape (3,): left, right, gyro."""
        return np.array([np.interp(t_s, self._time_s, row) for row in self._added])
