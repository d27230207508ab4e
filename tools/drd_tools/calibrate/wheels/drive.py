"""A recording prepared for the wheel calibration: wheel angles, reference, windows, and residuals of a model."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.arrays import Array, cumulative
from drd.config.keys import Noise
from drd.config.schema import ConfigError
from drd.units import RAD_PER_DEG
from drd_tools.evaluate.metrics import turned
from drd_tools.recordings.folder import Recording

Rows = npt.NDArray[np.intp]

WINDOW_TREADS: Final = 10.0  # travel of the faster wheel in one window, in treads
MIN_WINDOWS: Final = 6
MIN_TRAVEL_TREADS: Final = 0.1
SWEEP_DEG: Final = 5.0
ALIGNMENT_STEPS: Final = 4
MOST_LAG_S: Final = 1.0  # of a reference, which shows a gap of the wheels later: real ones are up to 0.5 s late
# Defaults if robot.yaml does not state the reference's noise and the wheels' slip.
POSITION_SIGMA_M: Final = 0.01
HEADING_SIGMA_RAD: Final = 0.2 * RAD_PER_DEG
SLIP_M_PER_SQRT_M: Final = Noise().wheel_m_per_sqrt_m


class Wheels(NamedTuple):
    """The geometry that turns wheel angles into motion."""

    left_radius_m: float
    right_radius_m: float
    tread_m: float


@dataclass(frozen=True)
class Mounting:
    """Mounting of the reference on the robot: nuisances of the calibration.

    It shows the wheels' motion at a time `time_s` later, at a point (`forward_m`, `left_m`) from the middle of the
    axle, with `heading_rad` added.
    """

    time_s: float = 0.0
    forward_m: float = 0.0
    left_m: float = 0.0
    heading_rad: float = 0.0


@dataclass(frozen=True)
class Drive:
    """One recording: wheel angles, the reference's rows within the wheels' time, and datasheet noise.

    `gaps_s` (k, 2): spans of time without counts, with the reference's largest lag.
    """

    name: str
    nominal: Wheels
    counts_per_revolution: float | None
    time_s: Array
    left_rad: Array
    right_rad: Array
    reference_s: Array
    reference_xy_m: Array
    reference_heading_rad: Array
    position_sigma_m: float
    heading_sigma_rad: float
    slip_m_per_sqrt_m: float
    counted_by_m: float  # tread with which whole turns between sparse rows were counted
    gaps_s: Array

    @cached_property
    def travel_m(self) -> Array:
        """Travel of the faster wheel up to each row of the reference, with the nominal wheels."""
        r = self.nominal
        left, right = r.left_radius_m * np.diff(self.left_rad), r.right_radius_m * np.diff(self.right_rad)
        travel = cumulative(np.maximum(np.abs(left), np.abs(right)))
        return np.asarray(np.interp(self.reference_s, self.time_s, travel))

    @cached_property
    def windows(self) -> tuple[Rows, Rows]:
        """Rows of the reference, window by window, and the index where each window begins. Windows share end rows.

        Those with a gap are left out, unless all have one.
        """
        total = np.ptp(self.travel_m)
        count = max(MIN_WINDOWS, round(total / (WINDOW_TREADS * self.nominal.tread_m)))
        edges = np.searchsorted(self.travel_m, self.travel_m[0] + total * np.arange(count + 1) / count)
        edges[-1] = len(self.travel_m) - 1
        edges = np.unique(edges)
        spans_s = [(self.reference_s[a], self.reference_s[b]) for a, b in pairwise(edges)]
        whole = [not any(a < end and begin < b for begin, end in self.gaps_s) for a, b in spans_s]
        pieces = [np.arange(a, b + 1) for a, b in pairwise(edges)]
        if any(whole):
            pieces = [piece for piece, is_whole in zip(pieces, whole, strict=True) if is_whole]
        return np.concatenate(pieces), np.cumsum([0, *(len(piece) for piece in pieces[:-1])])

    @property
    def path_m(self) -> float:
        """Length of the path with the nominal wheels, during the reference."""
        angles = (np.interp(self.reference_s, self.time_s, rad) for rad in (self.left_rad, self.right_rad))
        return float(np.abs(0.5 * self.nominal.left_radius_m * np.diff(sum(angles))).sum())

    @property
    def spot_share(self) -> float:
        """Share of the turning with the wheels running in opposite directions (on the spot); 0 to 1."""
        left, right = np.diff(self.left_rad), np.diff(self.right_rad)
        turn = np.abs(right - left)
        return float(turn[left * right < 0].sum() / max(float(turn.sum()), 1e-12))

    @property
    def turns_rad(self) -> tuple[float, float]:
        """Angles turned to the left and to the right according to the reference, in sweeps of SWEEP_DEG or more."""
        sweep = SWEEP_DEG * RAD_PER_DEG
        kept = [float(self.reference_heading_rad[0])]
        for value in self.reference_heading_rad:
            if abs(value - kept[-1]) >= sweep:
                kept.append(float(value))
        steps = np.diff(kept)
        return float(steps[steps > 0].sum()), float(-steps[steps < 0].sum())


def make_drive(recording: Recording) -> Drive:
    """Make a drive of `recording`. Raises ConfigError if it has no usable reference or does not move."""
    sheet, log = recording.nominal, recording.reference
    if log is None:
        raise ConfigError(
            str(recording.folder), "reference.csv", "this file: the wheels are compared with it", "a recording without"
        )
    left_rad, right_rad = recording.wheel_angles_rad()
    time_s = recording.encoders.time_s
    inside = (log.time_s >= time_s[0]) & (log.time_s <= time_s[-1])
    if inside.sum() < 2:
        expected = f"two rows or more within the encoders' time, {time_s[0]:.12g} to {time_s[-1]:.12g} s"
        raise ConfigError(str(recording.folder / "reference.csv"), "time_s", expected, str(inside.sum()))
    nominal = Wheels(sheet.wheel_radius_m, sheet.wheel_radius_m, sheet.tread_m)
    drive = Drive(
        recording.name,
        nominal,
        sheet.counts_per_revolution,
        time_s,
        left_rad,
        right_rad,
        log.time_s[inside],
        np.stack([log.x_m[inside], log.y_m[inside]], axis=1),
        log.heading_rad[inside],
        sheet.reference_position_sigma_m or POSITION_SIGMA_M,
        (sheet.reference_heading_sigma_deg or 0.0) * RAD_PER_DEG or HEADING_SIGMA_RAD,
        SLIP_M_PER_SQRT_M if sheet.slip_noise_m_per_sqrt_m is None else sheet.slip_noise_m_per_sqrt_m,
        nominal.tread_m,
        _gaps_s(recording),
    )
    travel_m = float(np.ptp(drive.travel_m))
    if travel_m < MIN_TRAVEL_TREADS * nominal.tread_m:
        file = str(recording.folder / "encoders.csv")
        raise ConfigError(file, "", "wheels that move while the reference is there", f"{travel_m:.3g} m of travel")
    return counted(drive, nominal.tread_m)


def _gaps_s(recording: Recording) -> Array:
    time_s, gaps = recording.encoders.time_s, recording.wheel_gaps()
    return np.column_stack([time_s[:-1][gaps], time_s[1:][gaps] + MOST_LAG_S])


def counted(drive: Drive, tread_m: float) -> Drive:
    """Count whole turns between rows of the reference by the wheels, with the given tread: between sparse rows nothing
    else determines their number.
    """
    heading = drive.reference_heading_rad
    turn_m = drive.nominal.left_radius_m * (drive.right_rad - drive.left_rad)
    turn = np.interp(drive.reference_s, drive.time_s, turn_m / tread_m)
    excess = np.round((np.diff(turn) - np.diff(heading)) / (2.0 * math.pi))
    heading = heading + 2.0 * math.pi * cumulative(excess)
    return replace(drive, reference_heading_rad=heading, counted_by_m=tread_m)


def cut_drive(drive: Drive, start: float, end: float) -> Drive | None:
    """Cut out the part of a drive between two fractions of its travel; None if it has fewer than two rows."""
    share = (drive.travel_m - drive.travel_m[0]) / np.ptp(drive.travel_m)
    kept = (share >= start) & (share <= end)
    if kept.sum() < 2:
        return None
    return replace(
        drive,
        reference_s=drive.reference_s[kept],
        reference_xy_m=drive.reference_xy_m[kept],
        reference_heading_rad=drive.reference_heading_rad[kept],
    )


def odometry(drive: Drive, wheels: Wheels, at_s: Array) -> tuple[Array, Array]:
    """Path of the axle's middle, shape (n, 2), and heading, shape (n,), at the times `at_s`, starting at the origin.

    Each step is an arc, which is exact if the ratio of the wheels' speeds is constant within it.
    """
    left_m = wheels.left_radius_m * np.diff(drive.left_rad)
    right_m = wheels.right_radius_m * np.diff(drive.right_rad)
    turn = (right_m - left_m) / wheels.tread_m
    heading = cumulative(turn)
    middle = heading[:-1] + 0.5 * turn
    chord_m = 0.5 * (right_m + left_m) * np.sinc(0.5 * turn / math.pi)
    x_m = cumulative(chord_m * np.cos(middle))
    y_m = cumulative(chord_m * np.sin(middle))
    xy_m = np.stack([np.interp(at_s, drive.time_s, x_m), np.interp(at_s, drive.time_s, y_m)], axis=1)
    return xy_m, np.interp(at_s, drive.time_s, heading)


def seen_by_reference(drive: Drive, wheels: Wheels, mounting: Mounting) -> tuple[Array, Array]:
    """Predict the reference at its rows: path, shape (n, 2), and heading, shape (n,)."""
    xy_m, heading = odometry(drive, wheels, drive.reference_s + mounting.time_s)
    lever_m = turned(np.array([[mounting.forward_m, mounting.left_m]]), heading)
    return xy_m + lever_m, heading + mounting.heading_rad


def residuals(drive: Drive, wheels: Wheels, mounting: Mounting, weights: Array) -> Array:
    """Reference minus model at the rows of `drive.windows`, shape (n, 3): x, y in m, heading in rad. (53)

    Each window has its own start pose, which is solved for here. `weights`, shape (n, 2): inverse variances of
    each coordinate and of the heading.
    """
    xy_m, heading = seen_by_reference(drive, wheels, mounting)
    rows, starts = drive.windows
    window = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(rows)))
    model, seen = xy_m[rows], drive.reference_xy_m[rows]
    ahead = drive.reference_heading_rad[rows] - heading[rows]

    def total(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, starts, axis=0))

    w_xy, w_heading = weights[:, 0], weights[:, 1]
    model = model - (total(w_xy[:, None] * model) / total(w_xy)[:, None])[window]
    seen = seen - (total(w_xy[:, None] * seen) / total(w_xy)[:, None])[window]
    along = total(w_xy * (model * seen).sum(axis=1))
    across = total(w_xy * (model[:, 0] * seen[:, 1] - model[:, 1] * seen[:, 0]))
    weight = total(w_heading)
    mean = total(w_heading * ahead) / weight
    turn = mean.copy()
    for _ in range(ALIGNMENT_STEPS):  # Newton's method for the window's start heading
        slope = along * np.sin(turn) - across * np.cos(turn) + weight * (turn - mean)
        curve = np.maximum(along * np.cos(turn) + across * np.sin(turn), 0.0) + weight
        turn = turn - slope / curve
    return np.column_stack([seen - turned(model, turn[window]), ahead - turn[window]])
