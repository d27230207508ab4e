"""Noise profiles: how the process noise Q grows per metre, radian and second, and the comparison's variance R."""

from dataclasses import dataclass, replace

from drd.config.keys import Noise
from drd.units import (
    RAD_PER_DEG,
    RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H,
    RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H,
    S_PER_H,
)

# A drive's hold of its speeds beats against the bus: 8 ms after a minute.
WHEEL_LAG_S_PER_SQRT_S = 0.001
# Skid-steer: four to six wheels of a Husky or Warthog against lidar, 1 to 10 s windows, on grass and asphalt.
SKID_WHEEL_M_PER_SQRT_M = 0.01
SKID_LATERAL_M_PER_SQRT_M = 0.02
SKID_TURN_M_PER_SQRT_RAD = 0.05
SKID_TURN_RAD_PER_SQRT_RAD = 0.05
SKID_TREAD_PER_SQRT_RAD = 0.01


@dataclass(slots=True, kw_only=True)
class NoiseProfile:
    """Variance that each cause adds, per metre travelled, radian turned and second passed. (24)

    A step of any length gets its share, so the filter's growth does not depend on the rate of the sensors.
    """

    wheel_m2_per_m: float = 0.0  # each wheel's travel; moves position and heading together
    lateral_m2_per_m: float = 0.0
    position_m2_per_rad: float = 0.0
    position_m2_per_s: float = 0.0
    turn_rad2_per_rad: float = 0.0
    turn_rad2_per_s: float = 0.0
    wheel_scale_per_m: float = 0.0  # (10)
    wheel_scale_per_s: float = 0.0
    tread_m2_per_rad: float = 0.0
    tread_m2_per_s: float = 0.0
    gyro_rad2_per_s: float = 0.0
    gyro_scale_per_s: float = 0.0
    gyro_bias_rad2_s2_per_s: float = 0.0
    wheel_lag_s2_per_s: float = 0.0
    gyro_bias_restart_rad2_s2: float = 0.0  # once, when the gyro comes back after a silence
    count_m2: float = 0.0  # quantisation of one reading
    comparison_rad2: float  # R = this + (rate * timing)^2  (25)
    timing_s2: float = 0.0
    jitter_s2: float = 0.0  # of the wheels' time, from one change of speed to the next  (25)


def physical(noise: Noise, tread_m: float, resolution_m: float = 0.0, interval_s: float = 0.0) -> NoiseProfile:
    """The profile of datasheet numbers; `resolution_m` is one encoder count, `interval_s` the time between
    readings of the encoders, in which the speed is assumed constant. (24), (25)
    """
    return NoiseProfile(
        wheel_m2_per_m=noise.wheel_m_per_sqrt_m**2,
        lateral_m2_per_m=noise.lateral_m_per_sqrt_m**2,
        position_m2_per_rad=noise.turn_m_per_sqrt_rad**2,
        turn_rad2_per_rad=noise.turn_rad_per_sqrt_rad**2,
        wheel_scale_per_m=noise.wheel_scale_per_sqrt_m**2,
        tread_m2_per_rad=(noise.tread_per_sqrt_rad * tread_m) ** 2,
        gyro_rad2_per_s=(noise.gyro_deg_per_sqrt_h * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H) ** 2,
        gyro_scale_per_s=noise.gyro_scale_per_sqrt_h**2 / S_PER_H,
        gyro_bias_rad2_s2_per_s=(noise.gyro_bias_deg_h_per_sqrt_h * RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H) ** 2,
        gyro_bias_restart_rad2_s2=(noise.gyro_bias_repeatability_deg_s * RAD_PER_DEG) ** 2,
        comparison_rad2=(noise.comparison_deg * RAD_PER_DEG) ** 2 + resolution_m**2 / 6.0 / tread_m**2,
        count_m2=resolution_m**2 / 12.0,
        timing_s2=noise.timing_s**2,
        jitter_s2=noise.timing_s**2 + interval_s**2 / 120.0,
        wheel_lag_s2_per_s=WHEEL_LAG_S_PER_SQRT_S**2,
    )


def paper() -> NoiseProfile:
    """The printed Q and R of the paper's section 3.3, per odometry step of 50 ms and gyro step of 100 ms. (27)

    EQUATIONS.md says how ten printed values map to nine states.
    """
    odometry_steps_per_s, gyro_steps_per_s = 20.0, 10.0
    return NoiseProfile(
        position_m2_per_s=0.1**2 * odometry_steps_per_s,
        turn_rad2_per_s=(0.7 * RAD_PER_DEG) ** 2 * odometry_steps_per_s,
        wheel_scale_per_s=2e-5**2 * odometry_steps_per_s,
        tread_m2_per_s=2e-5**2 * odometry_steps_per_s,
        gyro_rad2_per_s=(1e-4 * RAD_PER_DEG) ** 2 * gyro_steps_per_s,
        gyro_scale_per_s=3e-5**2 * gyro_steps_per_s,
        gyro_bias_rad2_s2_per_s=(1e-5 * RAD_PER_DEG) ** 2 * gyro_steps_per_s,
        comparison_rad2=(0.02 * RAD_PER_DEG) ** 2,
    )


def make_noise(
    profile: str, noise: Noise, tread_m: float, resolution_m: float = 0.0, interval_s: float = 0.0
) -> NoiseProfile:
    """The profile that the configuration names: "physical" or "paper"."""
    return paper() if profile == "paper" else physical(noise, tread_m, resolution_m, interval_s)


def skid_steer(noise: NoiseProfile, tread_m: float) -> NoiseProfile:
    """The profile with at least the noise of wheels that must slip sideways in each turn. (33)"""
    least = NoiseProfile(
        comparison_rad2=0.0,
        wheel_m2_per_m=SKID_WHEEL_M_PER_SQRT_M**2,
        lateral_m2_per_m=SKID_LATERAL_M_PER_SQRT_M**2,
        position_m2_per_rad=SKID_TURN_M_PER_SQRT_RAD**2,
        turn_rad2_per_rad=SKID_TURN_RAD_PER_SQRT_RAD**2,
        tread_m2_per_rad=(SKID_TREAD_PER_SQRT_RAD * tread_m) ** 2,
    )
    names = ("wheel_m2_per_m", "lateral_m2_per_m", "position_m2_per_rad", "turn_rad2_per_rad", "tread_m2_per_rad")
    return replace(noise, **{name: max(getattr(noise, name), getattr(least, name)) for name in names})
