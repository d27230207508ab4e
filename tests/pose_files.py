"""Simulated drives with known errors: estimates, references and pose files."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from drd.arrays import Array
from drd.estimation.covariance import UPPER
from drd_tools.evaluate.trajectory import Poses, Reference
from drd_tools.recordings.folder import COVARIANCE, POSES

STEP_S = 0.1


def drive(seconds: float = 120.0, rate_rad_s: float = 0.15, speed_m_s: float = 0.8) -> Reference:
    """A winding path without noise."""
    time_s = np.arange(0.0, seconds + 0.5 * STEP_S, STEP_S)
    heading = np.cumsum(rate_rad_s * np.sin(time_s / 7.0) * STEP_S)
    return Reference("drive", time_s, np.column_stack([integrate(time_s, heading, speed_m_s), heading]))


def integrate(time_s: Array, heading: Array, speed_m_s: Array | float) -> Array:
    """The path (n, 2) from the origin; each heading holds over the step that ends at its row."""
    step_m = np.diff(time_s, prepend=time_s[0]) * speed_m_s
    return np.column_stack([np.cumsum(step_m * np.cos(heading)), np.cumsum(step_m * np.sin(heading))])


def estimate_of(reference: Reference, **changes: object) -> Poses:
    """The reference itself as an estimate."""
    return replace(Poses("estimate", reference.time_s, reference.pose.copy()), **changes)  # type: ignore[arg-type]


def moved(poses: Array, x_m: float, y_m: float, turn_rad: float) -> Array:
    """Poses (n, 3) turned about the origin, then shifted."""
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    x, y, h = poses.T
    return np.column_stack([x_m + c * x - s * y, y_m + s * x + c * y, h + turn_rad])


def dead_reckoned(rng: np.random.Generator, claim: float = 1.0, rows: int = 600) -> tuple[Poses, Reference]:
    """An estimate whose errors add up as its covariance says, times `claim`, against a noisy reference of 10 Hz."""
    truth = drive(rows * STEP_S)
    n = len(truth.time_s)
    sigma_h, sigma_s, position_sigma_m, heading_sigma_rad = 0.002, 0.004, 0.01, 0.003
    steps = np.column_stack([np.diff(truth.pose[:, :2], axis=0, prepend=0.0)])
    error_h = np.cumsum(np.concatenate(([0.0], rng.normal(0.0, sigma_h, n - 1))))
    slip = np.concatenate(([0.0], rng.normal(0.0, sigma_s, n - 1)))
    along = np.column_stack([np.cos(truth.pose[:, 2]), np.sin(truth.pose[:, 2])])
    xy, P, covariance = np.zeros((n, 2)), np.zeros((3, 3)), np.zeros((n, 3, 3))
    for k in range(1, n):
        c, s = math.cos(error_h[k - 1]), math.sin(error_h[k - 1])
        xy[k] = xy[k - 1] + np.array([[c, -s], [s, c]]) @ (steps[k] + slip[k] * along[k])
        F = np.array([[1.0, 0.0, -steps[k, 1]], [0.0, 1.0, steps[k, 0]], [0.0, 0.0, 1.0]])
        u = np.append(along[k], 0.0)
        P = F @ P @ F.T + sigma_s**2 * np.outer(u, u) + np.diag([0.0, 0.0, sigma_h**2])
        covariance[k] = P
    estimate = np.column_stack([xy, truth.pose[:, 2] + error_h])
    noise = rng.normal(0.0, 1.0, (n, 3)) * (position_sigma_m, position_sigma_m, heading_sigma_rad)
    reference = replace(
        truth, pose=truth.pose + noise, position_sigma_m=position_sigma_m, heading_sigma_rad=heading_sigma_rad
    )
    return Poses("estimate", truth.time_s, estimate, claim**2 * covariance), reference


def write_poses(file: Path, time_s: Array, pose: Array, covariance: Array | None = None) -> Path:
    """Write a pose file, or a reference if there is no covariance."""
    columns = [time_s, pose[:, 0], pose[:, 1], np.degrees(pose[:, 2])]
    header = list(POSES)
    if covariance is not None:
        columns += list(covariance[:, *UPPER].T)
        header += COVARIANCE
    np.savetxt(file, np.column_stack(columns), "%.15g", ",", header=",".join(header), comments="")
    return file
