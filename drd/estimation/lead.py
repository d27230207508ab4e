"""Places in the plane, and the step from the filter's to that of the newest samples."""

import cmath
import math
from typing import NamedTuple

from drd.estimation.filter import Filter

Place = tuple[float, float, float]  # x and y in m, heading in rad


def seen_from(origin: Place, place: Place) -> Place:
    """A place in the frame of another one."""
    offset = complex(place[0] - origin[0], place[1] - origin[1]) * cmath.rect(1.0, -origin[2])
    return offset.real, offset.imag, place[2] - origin[2]


def onward(origin: Place, offset: Place) -> Place:
    """The place at `offset` from `origin`: the inverse of `seen_from`."""
    step = complex(offset[0], offset[1]) * cmath.rect(1.0, origin[2])
    return origin[0] + step.real, origin[1] + step.imag, origin[2] + offset[2]


class Lead(NamedTuple):
    """The step from the filter's time to that of the newest samples: the wheels' lag, travel and turn within it. Also
    uncertainty not in P: while the steering is unknown, the standard deviation of the scale of all distances, and the
    variance of x and of y; the lag's doubt over the last seconds; the square of the comparisons' corrections of the
    heading; and for how long no gyro may have seen a turn. (18), (30), (34)
    """

    lag_s: float
    distance_m: float
    turn_rad: float
    scale: float
    wander_m2: float
    doubt_s2: float
    corrected_rad2: float
    unseen_s: float

    def onward(self, kf: Filter) -> Place:
        """The filter's pose after the step."""
        n, heading_rad = kf.nominal, kf.heading_rad
        middle = heading_rad + 0.5 * self.turn_rad
        x_m, y_m = n.x_m + self.distance_m * math.cos(middle), n.y_m + self.distance_m * math.sin(middle)
        return x_m, y_m, heading_rad + self.turn_rad
