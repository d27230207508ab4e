"""Detection of a stuck gyro, which repeats itself while the wheels move: it counts as silent. (18)"""

import math
from typing import Final

# A working gyro does not repeat a reading this often: its noise is about its last digit, or more.
STUCK_READINGS: Final = 10


class Stuck:
    """`repeats`: how often the last reading was repeated. `found`: the gyro is stuck, until its reading changes."""

    def __init__(self) -> None:
        self._rate_rad_s = self._angle_rad = math.nan
        self.repeats, self.found = 0, False

    def take(self, rate_rad_s: float, interval_s: float, disagrees: bool) -> bool:
        """Take a reading, and whether wheels and gyro disagree. True if it shows the gyro to be stuck."""
        # The gyro reports rates or angles; the converted quantity varies with the interval's length.
        angle_rad = rate_rad_s * interval_s
        again = _is_same(rate_rad_s, self._rate_rad_s) or _is_same(angle_rad, self._angle_rad)
        self._rate_rad_s, self._angle_rad = rate_rad_s, angle_rad
        before, self.repeats = self.found, self.repeats + 1 if again else 0
        self.found = again and (before or (self.repeats >= STUCK_READINGS and disagrees))
        return self.found and not before


def _is_same(reading: float, before: float) -> bool:
    """Whether two readings have the same digits."""
    return math.isclose(reading, before, rel_tol=1e-9)
