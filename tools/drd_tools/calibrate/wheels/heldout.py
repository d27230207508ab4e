"""Performance of a calibration on held-out drives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from tqdm import tqdm

from drd.arrays import Array
from drd_tools.calibrate.wheels.drive import Drive, Mounting, Wheels, cut_drive, seen_by_reference
from drd_tools.calibrate.wheels.fit import WheelFit, fit_wheels
from drd_tools.evaluate.metrics import rms, turned

START_TREADS: Final = 0.1  # over this travel, path and reference are aligned at the start
BLOCKS: Final = 5


@dataclass(frozen=True)
class Error:
    """Error of one drive's odometry, started from the reference's pose: at the end, and rms along the way."""

    end_m: float
    rms_m: float
    end_heading_rad: float


@dataclass(frozen=True)
class HeldOut:
    """One drive with the nominal wheels, and with wheels that were fitted without it."""

    drive: Drive
    fit: WheelFit
    nominal: Error
    calibrated: Error


def aligned_path(drive: Drive, wheels: Wheels, mounting: Mounting) -> tuple[Array, Array]:
    """Odometry at the reference's place on the robot, shape (n, 2) and heading (n,), aligned with it at the start."""
    xy_m, heading = seen_by_reference(drive, wheels, mounting)
    first = drive.travel_m <= drive.travel_m[0] + START_TREADS * drive.nominal.tread_m
    turn = float(np.mean((drive.reference_heading_rad - heading)[first]))
    xy_m = turned(xy_m, turn)
    return xy_m + (drive.reference_xy_m - xy_m)[first].mean(axis=0), heading + turn


def error_of(drive: Drive, wheels: Wheels, mounting: Mounting) -> Error:
    """Error of the odometry with `wheels`."""
    xy_m, heading = aligned_path(drive, wheels, mounting)
    distance_m = np.hypot(*(xy_m - drive.reference_xy_m).T)
    return Error(float(distance_m[-1]), rms(distance_m), float(heading[-1] - drive.reference_heading_rad[-1]))


def compare(drive: Drive, fit: WheelFit) -> HeldOut:
    """Compare nominal and fitted wheels on a drive that is not in `fit`. Both use the fit's mounting."""
    nominal, calibrated = (error_of(drive, wheels, fit.mounting) for wheels in (drive.nominal, fit.wheels))
    return HeldOut(drive, fit, nominal, calibrated)


def leave_one_out(drives: Sequence[Drive], fit: WheelFit) -> list[HeldOut]:
    """Test each drive with a fit of all the others, or each fifth of a single drive with a fit of the rest."""
    if len(drives) > 1:
        groups = [([d for d in drives if d is not drive], drive) for drive in drives]
    else:
        parts = [cut_drive(drives[0], k / BLOCKS, (k + 1) / BLOCKS) for k in range(BLOCKS)]
        named = [replace(p, name=f"{p.name}, part {k} of {BLOCKS}") for k, p in enumerate(parts, 1) if p is not None]
        groups = [([n for n in named if n is not part], part) for part in named] if len(named) > 1 else []
    progress = tqdm(groups, desc="held out", disable=None, leave=False)
    return [compare(drive, fit_wheels(others, fit)) for others, drive in progress]
