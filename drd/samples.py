"""Data types of the daemon: readings, samples and poses. SI, radians, CLOCK_MONOTONIC ns, REP-103 axes."""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple


class FogReading(NamedTuple):
    """Content of one FOG packet, in the sensor's own axis and sign.

    `value` is rad/s, or rad since the previous reading where `is_angle`. `sequence` is the packet's own counter
    (None: the protocol has none). `temperature_c` is NaN where the packet carries none. `valid` is the sensor's
    own flag; it is no over-range detector (DSP-3000 manual 54-0215).
    """

    value: float
    is_angle: bool
    sequence: int | None
    temperature_c: float
    valid: bool

    def is_copy_of(self, before: "FogReading | None") -> bool:
        """Whether a line or adapter has delivered the packet twice: its turn must not count again."""
        return before is not None and self.sequence is not None and self[:3] == before[:3]


class GyroSample(NamedTuple):
    """Mean yaw rate, counter-clockwise positive, over the `interval_s` seconds that end at `t_ns`."""

    t_ns: int
    interval_s: float
    rate_rad_s: float
    temperature_c: float  # NaN: unknown


class CalibratedRate(NamedTuple):
    """A gyro sample after equation (6), with the standard deviation that the calibration adds beyond a bias."""

    t_ns: int
    interval_s: float
    rate_rad_s: float
    sigma_rad_s: float


class CanFrame(NamedTuple):
    """One received CAN data frame; `t_ns` is CLOCK_MONOTONIC."""

    t_ns: int
    can_id: int
    extended: bool
    data: bytes


class Side(Enum):
    """Which wheel, seen in the direction of travel."""

    LEFT = 0
    RIGHT = 1

    __hash__ = object.__hash__  # faster than Enum's own, which is not in C: sides are dictionary keys


class WheelReading(NamedTuple):
    """One side's counter as the bus gave it: counts, or m/s where the layout reports speed."""

    side: Side
    value: float


class WheelSample(NamedTuple):
    """Travel of both wheels over the `interval_s` seconds that end at `t_ns`, forward positive.

    `lost_s` is the time before that interval in which the robot's motion was not seen (start, gap, counter jump).
    `lost_m` is the travel of the robot's middle in that time if the counters went on counting, else 0.
    """

    t_ns: int
    interval_s: float
    left_m: float
    right_m: float
    lost_s: float
    lost_m: float = 0.0


class WheelTurns(NamedTuple):
    """Angle that each wheel has turned since the start, by its counts, and its rate; forward positive."""

    t_ns: int
    left_rad: float
    right_rad: float
    left_rad_s: float
    right_rad_s: float


class Validity(Enum):
    """Degree to which the pose can be trusted."""

    INITIALISING = "initialising"
    VALID = "valid"
    DEGRADED = "degraded"
    INVALID = "invalid"


class Reason(NamedTuple):
    """Why the pose is not simply valid: the input, what is wrong with it, and since when."""

    source: str
    text: str
    since_ns: int


@dataclass(slots=True)
class Pose:
    """The estimate at `t_ns`. `covariance` is the upper triangle (xx, xy, xh, yy, yh, hh) in m^2, m rad, rad^2.

    Speed and rate are means over the newest samples, with standard deviations; while a sensor is silent they are held
    and their deviations grow. `position_bound_m`: radius that contains the true position in 99 of 100 cases, if the
    noise profile holds.
    """

    t_ns: int
    sequence: int
    x_m: float
    y_m: float
    heading_rad: float  # not wrapped: whole turns are kept
    speed_m_s: float
    rate_rad_s: float
    speed_sigma_m_s: float
    rate_sigma_rad_s: float
    covariance: tuple[float, float, float, float, float, float]
    position_bound_m: float
    validity: Validity
    reasons: tuple[Reason, ...]
