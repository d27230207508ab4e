"""Learned values for the health report: value, standard deviation, and whether the drive made them observable."""

import math
from typing import Any, Final

from drd.config.keys import Config
from drd.estimation.estimator import Estimator
from drd.estimation.learning import Drive
from drd.estimation.state import GYRO_BIAS, GYRO_SCALE, SCALE_L, SCALE_R, TREAD, WHEEL_LAG
from drd.estimation.steering import TAPE_PART

# A value counts as learned if its standard deviation is at most this share of the initial one.
LEARNED_PART: Final = 0.5
# A learned value this many standard deviations from its initial value is outside its prior.
OUTSIDE_SIGMAS: Final = 3.0
LEARNED, NOT_YET, OUTSIDE = "learned", "not observable yet", "outside its prior"


def learned_values(estimator: Estimator, config: Config) -> dict[str, dict[str, Any]]:
    """`value`, `sigma` and `verdict` by name; SI. The verdict of a noise is that of its measurement."""
    kf, start = estimator.filter, estimator.sigmas
    n, tread_m = kf.nominal, config.robot.tread_m
    tape_m = min(start.tread_m, TAPE_PART * tread_m)
    scale = math.hypot(start.wheel_scale, 0.5 * start.scale_difference)
    states = {
        "gyro_bias_rad_s": (-n.gyro_bias_rad_s, GYRO_BIAS, 0.0, start.gyro_bias_rad_s, start.gyro_bias_rad_s),
        "gyro_scale": (n.gyro_scale, GYRO_SCALE, 1.0, start.gyro_scale, start.gyro_scale),
        "left_wheel_scale_error": (n.scale_left, SCALE_L, 0.0, scale, start.wheel_scale),
        "right_wheel_scale_error": (n.scale_right, SCALE_R, 0.0, scale, start.wheel_scale),
        "tread_m": (n.tread_m, TREAD, tread_m, start.tread_m, tape_m),
        "wheel_lag_s": (n.wheel_lag_s, WHEEL_LAG, 0.0, start.wheel_lag_s, start.wheel_lag_s),
    }
    told = {}
    for name, (value, state, believed, at_start, prior) in states.items():
        sigma = kf.sigma(state)
        verdict = NOT_YET if sigma > LEARNED_PART * at_start or not at_start else LEARNED
        if verdict is LEARNED and abs(value - believed) > OUTSIDE_SIGMAS * math.hypot(sigma, prior):
            verdict = OUTSIDE
        told[name] = {"value": value, "sigma": sigma, "verdict": verdict}
    return told | _noise(estimator)


def _noise(estimator: Estimator) -> dict[str, dict[str, Any]]:
    rest, k = estimator.knowledge.rest_noise, estimator.filter.noise
    gyro = math.sqrt(rest.variance_rad2_per_s)
    sigma = gyro * rest.relative_sigma if rest.differences else None
    is_outside = rest.variance_rad2_per_s > rest.stated_rad2_per_s
    wheels = LEARNED if estimator.knowledge.wheel_noise.is_known else NOT_YET
    return {
        "gyro_noise_rad_per_sqrt_s": {
            "value": gyro,
            "sigma": sigma,
            "verdict": NOT_YET if sigma is None or not rest.known else OUTSIDE if is_outside else LEARNED,
        },
        "wheel_noise_m_per_sqrt_m": {"value": math.sqrt(k.wheel_m2_per_m), "sigma": None, "verdict": wheels},
        "turn_noise_rad_per_sqrt_rad": {"value": math.sqrt(k.turn_rad2_per_rad), "sigma": None, "verdict": wheels},
        "wheel_jitter_s": {"value": math.sqrt(k.jitter_s2), "sigma": None, "verdict": wheels},
    }


def steering_text(drive: Drive) -> str:
    """The kind of steering, in words."""
    return {
        Drive.UNKNOWN: "unknown: no turns so far",
        Drive.DIFFERENTIAL: "differential",
        Drive.SKID: "skid: the wheels slip sideways in each turn, so their yaw rate is trusted less",
    }[drive]
