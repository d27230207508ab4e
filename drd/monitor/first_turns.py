"""The first turns show a lag too large for straight lines, and a robot whose wheels slip in each turn. (99)"""

import math
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.monitor.evidence import HAZARD_PER_S, START_S
from drd.monitor.rows import ROW_S

LATEST_ROWS, EARLIEST_ROWS = 6, -3  # range of the lag that is searched
ENOUGH_RAD: Final = 6.0  # total turn: a lag of a tenth of a second shows well
ENOUGH_TURNS: Final = 4  # beginnings or ends of turns
MOST_ROWS: Final = 1200  # two minutes; then the search ends
ALIKE: Final = 0.8  # least correlation
LARGE_S: Final = 0.04  # a smaller one is found by its sensitivity
CURVES_RAD_S: Final = 0.15
# Evidence required of a lag: odds as for any name, and a prior shared by all lags.
LAG_NATS: Final = math.log(20.0 * (LATEST_ROWS - EARLIEST_ROWS) / (HAZARD_PER_S * START_S))
COLOURED_ROWS: Final = 5  # over which errors of rows are correlated


class Turns(NamedTuple):
    """Delay of the wheels, s (0: negligible), and ratio of the effective tread to the nominal one."""

    lag_s: float
    tread: float


class FirstTurns:
    """Estimates lag and tread from rows, once it has seen enough turns."""

    def __init__(self) -> None:
        self._wheels: list[float] = []
        self._gyro: list[float] = []
        self.is_over = False

    def add(self, wheels_rad_s: Array, gyro_rad_s: Array) -> Turns | None:
        """Add the rates of a block's rows (n,), in order of time. Returns the result, once."""
        if self.is_over:
            return None
        self._wheels += wheels_rad_s.tolist()
        self._gyro += gyro_rad_s.tolist()
        gyro, wheels = np.array(self._gyro), np.array(self._wheels)
        turns = np.diff((np.abs(gyro) > CURVES_RAD_S).astype(int))
        few = np.abs(gyro).sum() * ROW_S < ENOUGH_RAD or np.abs(turns).sum() < ENOUGH_TURNS
        if few and len(gyro) <= MOST_ROWS:
            return None
        shifts = np.arange(EARLIEST_ROWS, LATEST_ROWS + 1)
        inner = slice(-EARLIEST_ROWS, len(gyro) - LATEST_ROWS)
        with np.errstate(invalid="ignore"):  # if the robot has not moved
            alike = np.array([np.corrcoef(gyro[inner], np.roll(wheels, -k)[inner])[0, 1] for k in shifts])
        best = int(alike.argmax())
        if not alike[best] >= ALIKE:
            self._end()
            return None
        moved = np.roll(wheels, -int(shifts[best]))[inner]
        tread = float(moved @ gyro[inner] / (gyro[inner] @ gyro[inner]))
        lag_s = 0.0
        if 0 < best < len(shifts) - 1:
            before, at, after = alike[best - 1 : best + 2]
            lag_s = float(ROW_S * (shifts[best] + 0.5 * (before - after) / (before - 2.0 * at + after)))
        is_late = abs(lag_s) > LARGE_S
        if is_late and _nats(moved - tread * gyro[inner], (wheels - tread * gyro)[inner]) < LAG_NATS:
            if len(gyro) <= MOST_ROWS:
                return None  # slow changes of the rate show no lag; other turns may come
            is_late = False
        self._end()
        return Turns(lag_s if is_late else 0.0, tread)

    def _end(self) -> None:
        self.is_over = True
        self._wheels.clear()
        self._gyro.clear()


def _nats(rest: Array, rest_without: Array) -> float:
    """Evidence for a lag, from the residuals of the wheels' rates with it and without, (n,) each. (99)"""
    rest, rest_without = rest - rest.mean(), rest_without - rest_without.mean()
    square = float(rest @ rest) + 1e-30
    together = sum(max(0.0, float(rest[k:] @ rest[:-k]) / square) for k in range(1, COLOURED_ROWS + 1))
    independent = len(rest) / (1.0 + 2.0 * together)
    return 0.5 * independent * math.log((float(rest_without @ rest_without) + 1e-30) / square)
