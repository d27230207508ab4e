"""Baselines: simpler estimators on a recording, with the nominal geometry.

(a) the wheels alone; (b) the gyro's heading and the wheels' travel; (c) as (b), with the gyro's bias measured again at
every stop.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array, cumulative
from drd.batch.logs import FogLog
from drd_tools.evaluate.trajectory import Poses
from drd_tools.recordings.folder import Recording

Mask = npt.NDArray[np.bool_]

# A sample is in a stop if the wheels are at rest this long before and after it: skidding robots rock for half of it.
STOP_S: Final = 1.0
# Samples averaged before a bias is used: a second of most gyros.
LEAST_SAMPLES: Final = 20
# Largest travel of the wheels between two rows that is rounding, not motion.
NO_TRAVEL_M: Final = 1e-9

WHEELS, GYRO, STOPS = "a wheels", "b gyro", "c gyro, stops"
BASELINES: Final = (WHEELS, GYRO, STOPS)


def baselines(recording: Recording) -> dict[str, Poses]:
    """Poses of each baseline that the recording allows: without a gyro only the first."""
    time_s, left_m, right_m = travels(recording)
    tread_m = recording.nominal.tread_m
    distance_m = 0.5 * np.diff(left_m + right_m)
    turned = (right_m - left_m) / tread_m
    headings = {WHEELS: turned - turned[0]}
    if recording.fog is not None:
        fog, stopped = recording.fog, stops(recording.fog.time_s, time_s, left_m, right_m)
        bias = np.zeros(len(fog.time_s)), stop_bias(fog.rate_rad_s, stopped)
        rates = fog.rate_rad_s - bias[0], np.where(stopped, 0.0, fog.rate_rad_s - bias[1])
        for name, rate in zip((GYRO, STOPS), rates, strict=True):
            headings[name] = np.interp(time_s, fog.time_s, integral(fog, rate))
    return {name: path(name, time_s, distance_m, heading) for name, heading in headings.items()}


def travels(recording: Recording) -> tuple[Array, Array, Array]:
    """Times, and cumulative travel of the left and the right wheel with the nominal radius."""
    left, right = recording.wheel_angles_rad()
    radius_m = recording.nominal.wheel_radius_m
    return recording.encoders.time_s, radius_m * left, radius_m * right


def path(name: str, time_s: Array, distance_m: Array, heading_rad: Array) -> Poses:
    """Poses from the travel between rows, along the mean heading of each step; the path starts at the origin."""
    middle = 0.5 * (heading_rad[1:] + heading_rad[:-1])
    x_m, y_m = (cumulative(distance_m * part) for part in (np.cos(middle), np.sin(middle)))
    return Poses(name, time_s, np.column_stack([x_m, y_m, heading_rad]))


def integral(fog: FogLog, rate_rad_s: Array) -> Array:
    """Integrate rates, each the mean since the previous row, to an angle."""
    steps_s = np.diff(fog.time_s)
    first_s = float(np.median(steps_s)) if len(steps_s) else 0.0
    return np.cumsum(rate_rad_s * np.concatenate([[first_s], steps_s]))


def stops(at_s: Array, time_s: Array, left_m: Array, right_m: Array) -> Mask:
    """Whether the wheels are at rest from STOP_S before each time until STOP_S after it."""
    travel_m = np.abs(np.diff(left_m)) + np.abs(np.diff(right_m))
    moving_s = time_s[1:][travel_m > NO_TRAVEL_M]
    if not len(moving_s):
        return np.ones(len(at_s), bool)
    after = np.searchsorted(moving_s, at_s)
    before_s, after_s = (moving_s[np.clip(i, 0, len(moving_s) - 1)] for i in (after - 1, after))
    return np.asarray(np.minimum(np.abs(at_s - before_s), np.abs(after_s - at_s)) > STOP_S)


def stop_bias(rate_rad_s: Array, stopped: Mask) -> Array:
    """Bias at each sample: the mean rate of the present stop so far, or of the last one; 0 before the first."""
    bias = np.full(len(rate_rad_s), np.nan)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stopped, [False]]).astype(int)))
    for begin, end in edges.reshape(-1, 2):
        means = np.cumsum(rate_rad_s[begin:end]) / np.arange(1, end - begin + 1)
        bias[begin + LEAST_SAMPLES : end] = means[LEAST_SAMPLES:]
    known = np.maximum.accumulate(np.where(np.isfinite(bias), np.arange(len(bias)), -1))
    return np.where(known >= 0, bias[known], 0.0)
