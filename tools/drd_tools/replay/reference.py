"""Comparison of the estimate with the recording's own reference: aligned at the start, error at the end."""

import math
from typing import Any, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd_tools.recordings.folder import Recording
from drd_tools.recordings.path_length import path_length_m
from drd_tools.replay.result import Replayed, Start, table


class EndError(NamedTuple):
    """Estimate minus reference at `time_s`, with the estimate aligned with the reference's pose at `start_s`."""

    start_s: float
    time_s: float
    position_m: float
    heading_rad: float
    reference_m: float  # length of the reference's path in between


def start_on_reference(replayed: Replayed, recording: Recording) -> Start:
    """Find the start from which the estimate passes through the reference's first row. Raises ConfigError."""
    overlap = _overlap(replayed, recording)
    if overlap is None:
        expected = "a reference that overlaps the poses in time"
        raise ConfigError(str(recording.folder), "reference.csv", expected, "none")
    (x, y, heading), (reference_x, reference_y, reference_heading) = (pose[0] for pose in overlap[1:])
    turned = reference_heading - heading
    c, s = math.cos(turned), math.sin(turned)
    return Start(reference_x - c * x + s * y, reference_y - s * x - c * y, turned)


def end_error(replayed: Replayed, recording: Recording) -> EndError | None:
    """Error at the end; None if there is no reference, or none that overlaps the poses."""
    overlap = _overlap(replayed, recording)
    if overlap is None or recording.reference is None:
        return None
    (start_s, end_s), estimate, reference = overlap
    turned = reference[0, 2] - estimate[0, 2]
    c, s = math.cos(turned), math.sin(turned)
    dx, dy, dh = estimate[1] - estimate[0]
    off_x, off_y, off_h = np.array([c * dx - s * dy, s * dx + c * dy, dh]) - (reference[1] - reference[0])
    log = recording.reference
    inside = (log.time_s > start_s) & (log.time_s < end_s)
    between = np.column_stack((log.x_m[inside], log.y_m[inside]))
    path = np.vstack((reference[0, :2], between, reference[1, :2]))
    distance_m = float(path_length_m(path, recording.nominal.reference_position_sigma_m or 0.0)[-1])
    return EndError(start_s, end_s, math.hypot(off_x, off_y), math.remainder(off_h, 2.0 * math.pi), distance_m)


def _overlap(replayed: Replayed, recording: Recording) -> tuple[tuple[float, float], Array, Array] | None:
    """First and last common time, and the poses of estimate and reference there, shape (2, 3) each: x, y, heading."""
    log, rows = recording.reference, table(replayed)
    if log is None or not len(rows):
        return None
    start_s, end_s = max(rows[0, 0], log.time_s[0]), min(rows[-1, 0], log.time_s[-1])
    if not start_s < end_s:
        return None
    at = np.array([start_s, end_s])
    return (
        (float(start_s), float(end_s)),
        _at(at, rows[:, 0], rows[:, 1:4].T),
        _at(at, log.time_s, (log.x_m, log.y_m, log.heading_rad)),
    )


def _at(at_s: Array, time_s: Array, columns: Any) -> Array:
    return np.stack([np.interp(at_s, time_s, column) for column in columns], axis=1)
