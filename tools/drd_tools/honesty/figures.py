"""Figures of merit of one estimate of one drive."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd_tools.evaluate.alignment import align
from drd_tools.evaluate.consistency import nees
from drd_tools.evaluate.lag import lag_of, shifted
from drd_tools.evaluate.metrics import absolute_error, kitti_drift
from drd_tools.evaluate.trajectory import Poses, Reference, associate
from drd_tools.recordings.folder import wrapped

Mask = npt.NDArray[np.bool_]

# Poses come every 0.05 to 0.1 s: none is missing while the estimator runs.
MAX_GAP_S: Final = 1.0
# Faster than a robot at rest seems to turn by the noise of any of the references: 0.1 deg at 20 Hz.
TURNING_RAD_S: Final = 0.06
# On a shorter path a drift in per cent of it is meaningless.
DRIFT_FROM_M: Final = 1.0


@dataclass(frozen=True)
class Estimated:
    """Poses, and whether the estimator declares each valid (None: it does not say)."""

    poses: Poses
    is_valid: Mask | None = None


@dataclass(frozen=True)
class Yardstick:
    """Reference for an estimate, and how to compare the two.

    `is_true`: simulated, so the poses are compared as they are. A real reference has an unknown lag, which is
    estimated, and an arbitrary start, so the estimate is aligned with its first row; `allowed_m` allows for its errors.
    Rows faster than `moving_m_s` or TURNING_RAD_S count as moving: rows at rest would flatter the bound.
    """

    reference: Reference
    is_true: bool
    allowed_m: float = 0.0
    moving_m_s: float = 0.01


@dataclass(frozen=True)
class Figures:
    """Root mean squares and drift over all rows; figures of the bound over the moving ones (None: no bound).

    `inside`: share of the moving and valid rows whose error is inside the bound. `bound_ratio`: median bound over
    median error. `lag_s`: lag of the reference behind the estimate.
    """

    position_rms_m: float
    heading_rms_deg: float
    drift_percent: float | None
    inside: float | None = None
    bound_m: float | None = None
    bound_ratio: float | None = None
    valid: float | None = None
    lag_s: float = 0.0


def figures_of(estimated: Estimated, yardstick: Yardstick) -> Figures:
    """Compute all figures. Raises ConfigError if estimate and reference have too little in common."""
    lag_s = 0.0 if yardstick.is_true else lag_of(estimated.poses, yardstick.reference).value_s
    pairs = associate(estimated.poses, shifted(yardstick.reference, lag_s), MAX_GAP_S)
    aligned = align(pairs, "none" if yardstick.is_true else "start")[0]
    absolute, drift = absolute_error(aligned), kitti_drift(pairs)[0]
    inside = bound_m = ratio = valid = None
    if aligned.bound_m is not None:
        error_m = np.hypot(*(aligned.estimate - aligned.reference)[:, :2].T)
        moving = is_moving(aligned.time_s, aligned.reference, yardstick.moving_m_s)
        good = _valid_at(estimated, aligned.time_s)
        inside = _mean((error_m <= aligned.bound_m + yardstick.allowed_m)[moving & good])
        if moving.any():
            bound_m = float(np.median(aligned.bound_m[moving]))
            middle_m = float(np.median(error_m[moving]))
            ratio = bound_m / middle_m if middle_m > 0.0 else None
        valid = float(good.mean())
    return Figures(
        absolute.position_rmse_m,
        absolute.heading_rmse_deg,
        None if drift is None or pairs.travelled_m[-1] < DRIFT_FROM_M else drift.percent,
        inside,
        bound_m,
        ratio,
        valid,
        lag_s,
    )


def is_moving(time_s: Array, pose: Array, from_m_s: float) -> Mask:
    """Whether the robot drives or turns at each row, from its neighbours."""
    x, y, heading = (np.gradient(column, time_s) for column in pose.T)
    return np.asarray((np.hypot(x, y) > from_m_s) | (np.abs(heading) > TURNING_RAD_S))


def _valid_at(estimated: Estimated, time_s: Array) -> Mask:
    """Whether the newest pose at each time is valid."""
    if estimated.is_valid is None:
        return np.ones(len(time_s), bool)
    newest = np.searchsorted(estimated.poses.time_s, time_s, side="right") - 1
    return np.asarray(estimated.is_valid[np.maximum(newest, 0)])


def _mean(values: Mask) -> float | None:
    return float(values.mean()) if values.size else None


def nees_at_end(poses: Poses, true: Reference) -> float:
    """Normalised error squared of x, y and heading at the last pose; the poses have covariances."""
    assert poses.covariance is not None
    at_s = poses.time_s[-1]
    pose = np.array([np.interp(at_s, true.time_s, column) for column in true.pose.T])
    error = poses.pose[-1] - pose
    error[2] = wrapped(error[2:])[0]
    return nees("pose", error[None], poses.covariance[-1:]).average
