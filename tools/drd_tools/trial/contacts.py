"""Drives of the MuJoCo world, each with a nominal model calibrated to it."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.effects.effect import Errors
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG
from drd_tools.recordings.folder import Recording
from drd_tools.simulate.conditions import Reference
from drd_tools.trial.overlay import overlaid

STAND_S: Final = 10.0
MISSIONS: Final = ("eights", "square-cw", "square-ccw")
SLIP_M_PER_SQRT_M: Final = 2e-4  # at least
SLIP_S: Final = 1.0
KNOTS: Final = 13
STANDING: Final = 0.01  # m/s, rad/s


class Driven(NamedTuple):
    """A recording of the MuJoCo world, and its true motion in terms of the calibrated nominal model, at 100 Hz."""

    recording: Recording
    motion: Motion


def drive(mission: str, seconds: float, seed: int, friction: float, reference: Reference, name: str) -> Driven:
    """Drive, and calibrate the nominal model to this very drive, using its truth.

    Wheel radius and tread are least-squares fits. The part of each side's slip and of the lateral motion that speed,
    yaw rate, their products and derivatives explain is subtracted, as is the gyro's known drift with temperature. The
    slip noise on the datasheet is the rest, so that the data contain only the contacts' own irregularity.
    """
    from drd_tools.mujoco_world import measure, sensors, world  # noqa: PLC0415  # mujoco may be missing
    from drd_tools.mujoco_world.ground import Ground  # noqa: PLC0415
    from drd_tools.mujoco_world.vehicle import Vehicle  # noqa: PLC0415

    vehicle = Vehicle()
    m = world.drive(vehicle, Ground(friction=friction), mission, seconds, STAND_S, seed)
    readings = sensors.read_sensors(m, reference, seed)
    left, right = (np.gradient(vehicle.wheel_radius_m * angle, m.time_s) for angle in (m.left_rad, m.right_rad))
    rate = np.gradient(m.gyro_rad, m.time_s)
    gain = measure.slope(0.5 * (left + right), m.speed_m_s)
    left, right, radius_m = gain * left, gain * right, gain * vehicle.wheel_radius_m
    tread_m = measure.slope(rate, right - left)
    fog = readings.recording.fog
    assert fog is not None
    assert fog.temperature_c is not None
    temperature_c = np.interp(m.time_s, fog.time_s, fog.temperature_c)
    still_c = float(temperature_c[m.time_s <= STAND_S].mean())
    known = _known(m, rate, left, right, tread_m)
    rate, left, right = rate + known.gyro_rad_s, left + known.left_m_s, right + known.right_m_s
    motion = Motion(
        m.time_s, rate, m.speed_m_s, np.gradient(m.speed_m_s, m.time_s), m.heading_rad, left, right,
        m.left_rad, m.right_rad, temperature_c, still_c, tread_m, radius_m, float(m.time_s[-1]),
    )  # fmt: skip
    nominal = replace(
        sensors.nominal_of(vehicle, name, STAND_S),
        wheel_radius_m=radius_m,
        tread_m=tread_m,
        slip_noise_m_per_sqrt_m=_slip_m_per_sqrt_m(motion),
    )
    drift = sensors.BIAS_DEG_S_PER_C * RAD_PER_DEG * (fog.temperature_c - sensors.COLD_C)
    fog = replace(fog, rate_rad_s=fog.rate_rad_s - drift)
    recording = replace(readings.recording, folder=Path(name), nominal=nominal, fog=fog)
    return Driven(overlaid(recording, motion, [known]), motion)


def _known(m: Any, rate: Array, left: Array, right: Array, tread_m: float) -> Errors:
    """Errors that cancel, by least squares, everything that a calibration could know."""
    v, w = m.speed_m_s, np.gradient(m.heading_rad, m.time_s)
    dv, dw = np.gradient(v, m.time_s), np.gradient(w, m.time_s)
    bent = [v, w, v * np.abs(v), w * np.abs(w), v * w, v * np.abs(w)]
    changing = [dv, dw, v * dv, w * dw, v * dw, w * dv, np.gradient(dv, m.time_s), np.gradient(dw, m.time_s)]
    # A table by yaw rate as well: slip saturates as friction does.
    knots = np.linspace(w.min(), w.max(), KNOTS)
    moving = np.hypot(v, w) > STANDING
    by_rate = [np.interp(w, knots, unit) * moving for unit in np.eye(KNOTS)]
    own = np.column_stack([*bent, *changing, *by_rate])
    half = 0.5 * tread_m * w
    # A body that rolls in turns makes its gyro read less than the heading turns.
    offs = (rate - w, left - v + half, right - v - half, m.lateral_m_s)
    return Errors(*(-own @ np.linalg.lstsq(own, off, rcond=None)[0] for off in offs))


def _slip_m_per_sqrt_m(m: Motion) -> float:
    """Scatter of each wheel's travel over SLIP_S about that of the true motion, per square root of its travel."""
    half = 0.5 * m.tread_m * m.rate_rad_s
    step_s = float(m.time_s[1] - m.time_s[0])
    size = round(SLIP_S / step_s)
    n = len(half) // size

    def summed(values: Any) -> Array:
        return np.asarray(np.array(values)[:, : n * size].reshape(2, n, size).sum(axis=2) * step_s)

    off_m = summed([m.left_m_s - m.speed_m_s + half, m.right_m_s - m.speed_m_s - half])
    distance_m = summed([np.abs(m.left_m_s), np.abs(m.right_m_s)])
    return max(SLIP_M_PER_SQRT_M, math.sqrt(float(np.sum(off_m**2) / np.sum(distance_m))))
