"""Causes of the pose error that the filter models, in groups, and how to reduce each."""

from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array


class Cause(NamedTuple):
    """One source of variance: its group, and its part of it."""

    group: str
    part: str


CAUSES: Final = (
    Cause("gyro noise", "angle random walk"),
    Cause("gyro bias", "at the start, or as measured at rest"),
    Cause("gyro bias", "walk"),
    Cause("gyro bias", "after a silence of the gyro"),
    Cause("gyro scale", "at the start"),
    Cause("gyro scale", "walk"),
    Cause("calibration", "what it leaves of the rate's error"),
    Cause("wheel scales", "at the start"),
    Cause("wheel scales", "walk"),
    Cause("wheel scales", "skid steering"),
    Cause("tread", "at the start"),
    Cause("tread", "walk"),
    Cause("wheel lag", "at the start"),
    Cause("wheel lag", "walk"),
    Cause("slip noise", "each wheel's travel"),
    Cause("slip noise", "heading, in turns"),
    Cause("slip noise", "position, in turns"),
    Cause("slip noise", "sideways"),
    Cause("slip noise", "wheels and gyro disagreed"),
    Cause("sideways slip", "in proportion to speed and yaw rate"),
    Cause("latency", "the sensors' times against each other"),
    Cause("latency", "the wheels' time, at changes of speed"),
    Cause("quantisation", "floor of the comparison of the headings"),
    Cause("quantisation", "encoder counts"),
    Cause("motion not seen", "silent sensors"),
    Cause("start pose", "as configured or set"),
    Cause("before a restart", "all that was known then"),
)
(
    GYRO_NOISE, BIAS_START, BIAS_WALK, BIAS_SILENCE, GYRO_SCALE_START, GYRO_SCALE_WALK, CALIBRATION,
    WHEEL_SCALE_START, WHEEL_SCALE_WALK, SKID_SCALE, TREAD_START, TREAD_WALK, LAG_START, LAG_WALK,
    SLIP_TRAVEL, SLIP_HEADING, SLIP_POSITION, SLIP_SIDEWAYS, SLIP_FOUND, SIDEWAYS_SLIP, TIMING, JITTER, COMPARISON,
    COUNTS, NOT_SEEN, START_POSE, HANDED_OVER,
) = range(len(CAUSES))  # fmt: skip
GROUPS: Final = tuple(dict.fromkeys(cause.group for cause in CAUSES))

HELP: Final = {
    "gyro noise": "a gyro with a smaller angle random walk; `drd calibrate noise` measures it, if the datasheet's is "
    "only a limit",
    "gyro bias": "a longer standstill before the mission (estimation.static_bias.duration_s), or drd/calibrate_bias at "
    "stops; `drd calibrate noise` measures the walk",
    "gyro scale": "`drd calibrate gyro`, on a rate table",
    "calibration": "more rates and temperatures in `drd calibrate gyro`, and temperatures inside its range",
    "wheel scales": "`drd calibrate wheels`, which gives the scales and how well they are known",
    "tread": "`drd calibrate wheels` with turns to both sides, on the ground where the robot drives",
    "wheel lag": "turns with quick changes of rate, which show it; or the drive's lag, where it is known, as a latency "
    "with a smaller estimation.initial.wheel_lag_s",
    "slip noise": "no calibration: gentler turns and accelerations, better ground; or, if the robot slips less than "
    "estimation.noise says, a smaller number there",
    "sideways slip": "no sensor tells it: gentler turns; or estimation.initial.slip_s, once a reference has shown it",
    "latency": "time stamps nearer to the measurement: a low-latency serial port (udev rule), a smaller "
    "estimation.noise.timing_s once it is measured",
    "quantisation": "encoders with more counts, a gyro with a finer resolution (estimation.noise.comparison_deg)",
    "motion not seen": "sensors that are not silent: see the reasons in `drd replay` and the health",
    "start pose": "a start pose that is better known (estimation.initial, or the sigmas of drd/set_pose)",
    "before a restart": "drd/set_pose at a place that is known",
}
# In place of those above, if the robot has no gyro.
HELP_WITHOUT_GYRO: Final = {
    "latency": "counters that are sent more often and sampled at one time; a smaller estimation.noise.timing_s once it "
    "is measured",
    "quantisation": "encoders with more counts",
}


def by_group(values: Array) -> Array:
    """Sum over the causes of each group: shape (causes, ...) to (groups, ...)."""
    summed = np.zeros((len(GROUPS), *values.shape[1:]))
    for cause, part in zip(CAUSES, values, strict=True):
        summed[GROUPS.index(cause.group)] += part
    return summed
