"""The first turns show a lag too large for straight lines, and a robot whose wheels slip in each turn. (99)"""

from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.monitor.rows import ROW_S

LATEST_ROWS, EARLIEST_ROWS = 6, -3  # in which it is looked for
ENOUGH_RAD: Final = 6.0  # turned: a lag of a tenth of a second shows well
ENOUGH_TURNS: Final = 4  # beginnings or ends of turns: a rate that is constant tells no lag
MOST_ROWS: Final = 1200  # two minutes; then it is looked for no more
ALIKE: Final = 0.8  # least correlation
LARGE_S: Final = 0.04  # less is told by its sensitivity
CURVES_RAD_S: Final = 0.15


class Turns(NamedTuple):
    """How late the wheels are, s (0: not so that it matters), and the effective tread over the nominal one."""

    lag_s: float
    tread: float


class FirstTurns:
    """Feed it rows until it has seen enough turns."""

    def __init__(self) -> None:
        self._wheels: list[float] = []
        self._gyro: list[float] = []
        self.is_over = False

    def add(self, wheels_rad_s: Array, gyro_rad_s: Array) -> Turns | None:
        """Rates of a block's rows (n,), in order of time. Returns what they show, once."""
        if self.is_over:
            return None
        self._wheels += wheels_rad_s.tolist()
        self._gyro += gyro_rad_s.tolist()
        gyro, wheels = np.array(self._gyro), np.array(self._wheels)
        if len(gyro) > MOST_ROWS:
            self._end()
            return None
        turns = np.diff((np.abs(gyro) > CURVES_RAD_S).astype(int))
        if np.abs(gyro).sum() * ROW_S < ENOUGH_RAD or np.abs(turns).sum() < ENOUGH_TURNS:
            return None
        shifts = np.arange(EARLIEST_ROWS, LATEST_ROWS + 1)
        inner = slice(-EARLIEST_ROWS, len(gyro) - LATEST_ROWS)
        alike = np.array([np.corrcoef(gyro[inner], np.roll(wheels, -k)[inner])[0, 1] for k in shifts])
        best = int(alike.argmax())
        self._end()
        if alike[best] < ALIKE:
            return None
        moved = np.roll(wheels, -int(shifts[best]))[inner]
        tread = float(moved @ gyro[inner] / (gyro[inner] @ gyro[inner]))
        if not 0 < best < len(shifts) - 1:
            return Turns(0.0, tread)
        before, at, after = alike[best - 1 : best + 2]
        lag_s = float(ROW_S * (shifts[best] + 0.5 * (before - after) / (before - 2.0 * at + after)))
        return Turns(lag_s if abs(lag_s) > LARGE_S else 0.0, tread)

    def _end(self) -> None:
        self.is_over = True
        self._wheels.clear()
        self._gyro.clear()
