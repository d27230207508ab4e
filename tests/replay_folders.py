"""Recording folders of drives without any error, for replays."""

import math
from pathlib import Path

import numpy as np
from wheel_recordings import STEP_S, TOUR, Leg, Truth, write_drive

from drd.units import DEG_PER_RAD
from drd_tools.recordings.folder import Recording, read_recording

STANDING: tuple[Leg, ...] = ((0.0, 0.0, 12.0), *TOUR)


def write_perfect(
    folder: Path,
    *,
    gyro: bool,
    as_speeds: bool = False,
    bias_deg_s: float = 0.0,
    temperature_c: float | None = None,
    legs: tuple[Leg, ...] = STANDING,
) -> Path:
    """A drive with exact wheels and reference, and a gyro at 10 Hz whose only error is a bias."""
    write_drive(folder, legs, Truth(), every=1, as_speeds=as_speeds)
    robot = folder / "robot.yaml"
    text = robot.read_text() + "standstill_at_start_s: 12\n"
    if gyro:
        text = text.replace("fog: null", "fog: {rate_hz: 10, range_deg_s: 100}")
        time_s, _, _, heading_deg = np.loadtxt(folder / "reference.csv", delimiter=",", skiprows=1)[::2].T
        heading = np.unwrap(np.radians(heading_deg))
        columns = [time_s[1:], np.diff(heading) / (2.0 * STEP_S) * DEG_PER_RAD + bias_deg_s]
        header = "time_s,rate_deg_s"
        if temperature_c is not None:
            columns, header = [*columns, np.full(len(time_s) - 1, temperature_c)], header + ",temperature_c"
        np.savetxt(folder / "fog.csv", np.stack(columns, axis=1), "%.12g", ",", header=header, comments="")
    robot.write_text(text)
    return folder


def short_drive(folder: Path) -> Recording:
    """A drive of 5 s, with gyro and temperature."""
    legs = ((0.0, 0.0, 1.0), (0.5, 0.3, 4.0))
    return read_recording(write_perfect(folder / "drive", gyro=True, temperature_c=20.0, legs=legs))


def long_drive(folder: Path) -> Recording:
    """A standstill and a tour, with a gyro that has a bias and no temperature."""
    return read_recording(write_perfect(folder / "drive", gyro=True, bias_deg_s=0.05))


def true_end(folder: Path) -> tuple[float, float, float]:
    """The reference's last pose: m, m, rad modulo a turn."""
    x_m, y_m, heading_deg = np.loadtxt(folder / "reference.csv", delimiter=",", skiprows=1)[-1, 1:].tolist()
    return x_m, y_m, math.radians(heading_deg)
