"""The daemon's keys that the wheel calibration writes, with comments on their meaning."""

import math
from collections.abc import Sequence
from typing import Any, Final

from drd.config.keys import Encoders, Estimation, Fog
from drd.estimation.estimate import MEASURED_TREAD, WHEEL_SCALE
from drd_tools.calibrate.wheels.drive import Wheels
from drd_tools.calibrate.wheels.fit import WheelFit
from drd_tools.calibrate.wheels.found import Found
from drd_tools.calibrate.wheels.lag import Lag
from drd_tools.calibrate.wheels.rest import Rest

# Silence is declared no earlier than so many periods after the last sample, since one may be lost.
PERIODS: Final = 2.0
# A larger ratio of effective to measured tread indicates a skid-steer robot. (34)
SKID_TREAD_RATIO: Final = 1.15


def robot_keys(nominal: Wheels, wheels: Wheels) -> dict[str, Any]:
    """`robot`: nominal radius, scale of each wheel, tread; and the kind of drive, if the tread reveals it."""
    skids = wheels.tread_m > SKID_TREAD_RATIO * nominal.tread_m
    return ({"drive": "skid"} if skids else {}) | {
        "wheel_radius_m": nominal.left_radius_m,
        "left_scale": wheels.left_radius_m / nominal.left_radius_m,
        "right_scale": wheels.right_radius_m / nominal.right_radius_m,
        "tread_m": wheels.tread_m,
    }


def initial_keys(fit: WheelFit, apart: Sequence[float], other: WheelFit | None) -> dict[str, float]:
    """`estimation.initial` of the wheels: standard deviations for the next drive. (54)

    They combine sigma and spread between recordings; are at least the defaults for a single recording or a value that
    is not determined; and at least the deviation of `other`, a fit of the held-out recordings alone.
    """
    departs_to = fit.wheels if other is None else other.wheels
    departure = [abs(v / w - 1) for v, w in zip(departs_to, fit.wheels, strict=True)]
    sigmas = []
    for sigma, between, default in zip(fit.sigma, apart, (WHEEL_SCALE, WHEEL_SCALE, MEASURED_TREAD), strict=True):
        sigmas.append(max(sigma, default) if math.isnan(between) else math.hypot(sigma, between))
    radii = all(f is None or all(f.determined[:2]) for f in (fit, other))
    is_tread = all(f is None or f.determined[2] for f in (fit, other))
    return {
        "wheel_scale": max(*sigmas[:2], *departure[:2]) if radii else max(WHEEL_SCALE, *sigmas[:2]),
        "tread": max(sigmas[2], departure[2]) if is_tread else max(MEASURED_TREAD, sigmas[2]),
    }


def sections(found: Found) -> dict[str, Any]:
    """Sections of wheels.yaml. Keys of values that are not determined are left out, except the wheels' own."""
    initial, noise = _gyro_keys(found.rest)
    initial = initial_keys(found.fit, found.apart, found.other) | initial
    lag = found.lag if found.lag is not None and found.lag.applies else None
    late, waits = _late_sensor(lag, found) if lag is not None else ({}, {})
    if lag is not None and lag.against == "gyro":
        initial["wheel_lag_s"] = (lag.next_s, "what the lag of another drive may depart by")
    robot = robot_keys(found.drives[0].nominal, found.fit.wheels)
    return {"robot": robot, **late, "estimation": {"initial": initial, "noise": noise, **waits}}


def _late_sensor(lag: Lag, found: Found) -> tuple[dict[str, Any], dict[str, Any]]:
    """The late sensor's section, and the keys of `estimation` that go with it."""
    between = "" if math.isnan(lag.spread_s) else f", between recordings {lag.spread_s:.4f} s"
    stated = {"latency_s": (abs(lag.lag_s), f"against the {lag.against}; sigma {lag.sigma_s:.4f} s{between}")}
    if lag.lag_s >= 0.0:
        longer = _at_least("silent_after_s", lag.lag_s, found.wheels_hz, Encoders().silent_after_s)
        return {"encoders": stated | longer}, {}
    longer = _at_least("silent_after_s", -lag.lag_s, found.gyro_hz, Fog().silent_after_s)
    return {"fog": stated | longer}, _at_least("reorder_s", -lag.lag_s, found.gyro_hz, Estimation().reorder_s)


def _at_least(name: str, latency_s: float, rate_hz: float, default_s: float) -> dict[str, Any]:
    """The key, if its default is too short for samples with this latency."""
    needed_s = latency_s + PERIODS / rate_hz
    return {name: (needed_s, "longer than a sample's age")} if needed_s > default_s else {}


def _gyro_keys(rest: Rest | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """Keys of `estimation.initial` and `estimation.noise` that the gyro's standstills determine."""
    initial: dict[str, Any] = {}
    noise: dict[str, Any] = {}
    if rest is None:
        return initial, noise
    if rest.noise_deg_per_sqrt_h is not None:
        said = f"sigma {rest.noise_sigma:.2g}, {rest.standstill_s:.0f} s of standstill"
        noise["gyro_deg_per_sqrt_h"] = (rest.noise_deg_per_sqrt_h, said)
    if rest.bias_deg_s is not None:
        initial["gyro_bias_deg_s"] = (rest.bias_deg_s, "root mean square of the recordings' biases at rest")
    if rest.repeatability_deg_s is not None:
        noise["gyro_bias_repeatability_deg_s"] = (rest.repeatability_deg_s, "between recordings")
    return initial, noise
