"""A robot's constants, which hold until somebody works on it, and how well they are known. (97)

Columns of the rows: TURN, tread times gyro scale less 1; TRAVEL, the left radius less the right one, relative; CHANGE,
the wheels' delay, in 10 ms.
"""

import math
from typing import Final

from msgspec import Struct

from drd.config.keys import Config
from drd.estimation.estimate import MEASURED_TREAD, WHEEL_SCALE
from drd.monitor.library import CHANGE, TRAVEL, TURN

CHANGE_S: Final = 0.01  # a unit of CHANGE
# Change of a known robot from day to day: load, tyre pressure and temperature, clocks.
KNOWN_SIGMAS: Final = {TURN: 0.003, TRAVEL: 0.0003, CHANGE: 0.2}


class Constants(Struct, frozen=True):
    """Means and standard deviations by column, before a drive begins."""

    means: dict[int, float]
    sigmas: dict[int, float]


def stated_constants(config: Config) -> Constants:
    """Constants known no better than the configuration says: by tape measure, unless stated."""
    initial = config.estimation.initial
    wheel_scale = WHEEL_SCALE if initial.wheel_scale is None else initial.wheel_scale
    tread = MEASURED_TREAD if initial.tread is None else initial.tread
    sigmas = {
        TURN: math.hypot(tread, initial.gyro_scale),
        TRAVEL: math.sqrt(2.0) * wheel_scale,
        CHANGE: config.estimation.noise.timing_s / CHANGE_S,
    }
    return Constants(dict.fromkeys(sigmas, 0.0), sigmas)
