"""Readings of the robot's sensors and the tracker: the sensor models of drd_tools.simulate on MuJoCo's motion."""

from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from drd.config.robot import Robot
from drd.effects.motion import Motion as Felt
from drd.units import DEG_PER_RAD, RAD_PER_DEG
from drd_tools.mujoco_world.vehicle import Vehicle
from drd_tools.mujoco_world.world import ROW_HZ, Motion, random_of
from drd_tools.recordings.folder import Recording, ReferenceLog
from drd_tools.simulate import conditions, sensors
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.temperature import warming_c

COUNTS_PER_REVOLUTION: Final = 8192
# Warm-up of the gyro: T = COLD + WARMER (1 - exp(-t / WARMING)); its bias follows T.
COLD_C: Final = 20.0
WARMER_C: Final = 8.0
WARMING_S: Final = 600.0
BIAS_DEG_S_PER_C: Final = 0.0003


class Readings(NamedTuple):
    """A recording as if read from a folder, and the gyro's bias at switch-on."""

    recording: Recording
    bias_deg_s: float


def nominal_of(vehicle: Vehicle, name: str, stand_s: float) -> Robot:
    """Nominal robot, with track and radius from the drawing and noise from datasheets."""
    return replace(
        DEFAULT,  # for the datasheet values of gyro and reference
        name=name,
        wheel_radius_m=vehicle.wheel_radius_m,
        counts_per_revolution=float(COUNTS_PER_REVOLUTION),
        tread_m=vehicle.track_m,
        gyro_kind="KVH RD2100",
        standstill_at_start_s=stand_s,
    )


def read_sensors(motion: Motion, reference: conditions.Reference, seed: int, nominal: Robot | None = None) -> Readings:
    """Sample the motion. The same arguments give the same bits. The wheels already slip, so no noise is added."""
    nominal = nominal or nominal_of(Vehicle(), "mujoco", 0.0)
    seen = conditions.Conditions(wheel_noise=0.0, reference=reference)
    felt = _felt(motion, nominal)
    bias = sensors.bias_rad_s(felt.time_s, nominal, 1.0, seed)
    felt.rate_rad_s = felt.rate_rad_s + bias + BIAS_DEG_S_PER_C * RAD_PER_DEG * (felt.temperature_c - COLD_C)
    left, right = random_of(seed, 13).random(2).tolist()  # initial fraction of a count, by wheel
    fog = sensors.gyro_log(felt, nominal, (), seen, seed)
    encoders = sensors.encoder_log(felt, felt, nominal, seen, seed, (left, right))
    true = ReferenceLog(motion.time_s, motion.x_m, motion.y_m, motion.heading_rad)
    poses = sensors.reference_log(true, nominal, seen, seed)
    return Readings(Recording(Path(nominal.name), nominal, encoders, fog, poses, {}), float(bias[0]) * DEG_PER_RAD)


def _felt(m: Motion, nominal: Robot) -> Felt:
    """Motion as measured by perfect sensors, in means over the rows' intervals."""
    middle_s = 0.5 * (m.time_s[1:] + m.time_s[:-1])
    gyro, left, right = (np.diff(angle) * ROW_HZ for angle in (m.gyro_rad, m.left_rad, m.right_rad))
    return Felt(
        time_s=middle_s,
        rate_rad_s=gyro,
        speed_m_s=m.speed_m_s[1:],
        acceleration_m_s2=np.diff(m.speed_m_s) * ROW_HZ,
        heading_rad=m.heading_rad[1:],
        left_m_s=nominal.wheel_radius_m * left,
        right_m_s=nominal.wheel_radius_m * right,
        left_wheel_rad=m.left_rad[1:],
        right_wheel_rad=m.right_rad[1:],
        temperature_c=warming_c(middle_s, COLD_C, WARMER_C, WARMING_S),
        still_c=COLD_C,
        tread_m=nominal.tread_m,
        wheel_radius_m=nominal.wheel_radius_m,
        end_s=float(m.time_s[-1]),
    )


def gyro_truth(readings: Readings) -> dict[str, float]:
    """True values of the gyro that robot.yaml lacks; its bias is that at switch-on + slope (T - COLD_C)."""
    return {
        "bias_at_switch_on_deg_s": round(readings.bias_deg_s, 9),
        "bias_temperature_deg_s_per_c": BIAS_DEG_S_PER_C,
        "switch_on_c": COLD_C,
    }
