"""Simulated drives with known wheels, as recording folders."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drd.arrays import Array
from drd_tools.recordings.folder import Recording

RADIUS_M, TREAD_M, COUNTS = 0.1, 0.5, 4000.0
STEP_S = 0.05
# (speed m/s, yaw rate rad/s, duration s)
Leg = tuple[float, float, float]
STRAIGHT: tuple[Leg, ...] = ((0.0, 0.0, 2.0), (0.5, 0.0, 20.0), (0.0, 0.0, 1.0))
SPIN: tuple[Leg, ...] = ((0.0, 0.0, 2.0), (0.0, 0.4, 16.0), (0.0, 0.0, 1.0))
CIRCLE: tuple[Leg, ...] = ((0.0, 0.0, 2.0), (0.4, 0.4, 40.0))
TOUR: tuple[Leg, ...] = (
    (0.0, 0.0, 2.0),
    *((0.5, 0.0, 6.0), (0.0, 0.5, 3.0), (0.4, 0.3, 8.0), (0.5, 0.0, 5.0), (0.4, -0.4, 8.0), (0.0, -0.5, 4.0)) * 3,
)


def later(recording: Recording, seconds: float) -> Recording:
    """The same recording with its clock shifted ahead."""
    fog, wheels, reference = recording.fog, recording.wheels, recording.reference
    assert fog is not None
    assert wheels is not None
    assert reference is not None
    return replace(
        recording,
        fog=replace(fog, time_s=fog.time_s + seconds),
        wheels=replace(wheels, time_s=wheels.time_s + seconds),
        reference=replace(reference, time_s=reference.time_s + seconds),
    )


@dataclass(frozen=True)
class Truth:
    """The simulated robot relative to its nominal values, and the quality of its reference."""

    left: float = 1.0
    right: float = 1.0
    tread: float = 1.0
    slip_m_per_sqrt_m: float = 0.0
    position_sigma_m: float = 0.0
    heading_sigma_rad: float = 0.0
    time_s: float = 0.0
    forward_m: float = 0.0
    left_m: float = 0.0


def _profile(legs: Sequence[Leg]) -> tuple[Array, Array]:
    """Speed and yaw rate of each step."""
    rows = [np.tile([v, w], (round(t / STEP_S), 1)) for v, w, t in legs]
    v, w = np.concatenate(rows).T
    return v, w


def write_drive(
    folder: Path,
    legs: Sequence[Leg],
    truth: Truth,
    seed: int = 0,
    *,
    every: int = 2,
    as_speeds: bool = False,
    tread_m: float = TREAD_M,
    jumps: int = 0,
) -> Path:
    """Write robot.yaml, encoders.csv and reference.csv, a reference row for `every` encoder rows and at the end."""
    rng = np.random.default_rng(seed)
    v, w = _profile(legs)
    angles = [np.concatenate([[0.0], np.cumsum((v + s * w * TREAD_M / 2) * STEP_S / RADIUS_M)]) for s in (-1.0, 1.0)]
    counts = [np.round(angle * COUNTS / (2.0 * math.pi)) for angle in angles]
    time_s = STEP_S * np.arange(len(v) + 1)
    travel = []
    for angle, factor in zip(angles, (truth.left, truth.right), strict=True):
        step = np.diff(angle) * RADIUS_M
        slip = rng.normal(0.0, 1.0, len(step)) * truth.slip_m_per_sqrt_m * np.sqrt(np.abs(step))
        travel.append(step * factor + slip)
    turn = (travel[1] - travel[0]) / (TREAD_M * truth.tread)
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    ahead = 0.5 * (travel[0] + travel[1])
    middle = heading[:-1] + 0.5 * turn
    x_m, y_m = (np.concatenate([[0.0], np.cumsum(ahead * f(middle))]) for f in (np.cos, np.sin))
    at_s = time_s[np.unique([*range(0, len(time_s), every), len(time_s) - 1])]
    x_m, y_m, heading = (np.interp(at_s + truth.time_s, time_s, value) for value in (x_m, y_m, heading))
    c, s = np.cos(heading), np.sin(heading)
    x_m = x_m + c * truth.forward_m - s * truth.left_m + rng.normal(0.0, truth.position_sigma_m, len(at_s))
    y_m = y_m + s * truth.forward_m + c * truth.left_m + rng.normal(0.0, truth.position_sigma_m, len(at_s))
    heading_deg = np.degrees(heading + rng.normal(0.0, truth.heading_sigma_rad, len(at_s)))
    for row in rng.integers(0, len(at_s), jumps):
        x_m[row] += 0.5
    folder.mkdir(parents=True)
    folder.joinpath("robot.yaml").write_text(
        f"# simulated\nname: simulated\nwheel: {{radius_m: {RADIUS_M}, "
        f"counts_per_revolution: {'null' if as_speeds else COUNTS}}}\ntread_m: {tread_m}\nfog: null\n"
        f"encoders: {{rate_hz: 20, slip_noise_m_per_sqrt_m: {max(truth.slip_m_per_sqrt_m, 1e-6)}}}\n"
        f"reference: {{position_sigma_m: {max(truth.position_sigma_m, 1e-4)}, "
        f"heading_sigma_deg: {max(math.degrees(truth.heading_sigma_rad), 1e-3)}}}\n"
    )
    if as_speeds:
        header = "time_s,left_rad_s,right_rad_s"
        rows = [time_s, *(np.diff(angle, prepend=0.0) / STEP_S for angle in angles)]
    else:
        header, rows = "time_s,left_counts,right_counts", [time_s, *counts]
    np.savetxt(folder / "encoders.csv", np.stack(rows, axis=1), "%.9g", ",", header=header, comments="")
    poses = np.stack([at_s, x_m, y_m, (heading_deg + 180.0) % 360.0 - 180.0], axis=1)
    np.savetxt(folder / "reference.csv", poses, "%.9g", ",", header="time_s,x_m,y_m,heading_deg", comments="")
    return folder
