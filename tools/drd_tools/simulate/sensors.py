"""Simulated readings of gyro, wheel counters and reference, for trajectories from any simulation.

The noise is that of the datasheets in robot.yaml. Each source of noise has its own random numbers.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from drd.arrays import Array, cumulative
from drd.batch.logs import EncoderLog, FogLog
from drd.config.robot import Robot
from drd.effects.effect import Effect, Values
from drd.effects.motion import Motion
from drd.units import (
    DEG_PER_RAD,
    RAD_PER_DEG,
    RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H,
    RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H,
)
from drd_tools.recordings.folder import ReferenceLog, continuous_rad
from drd_tools.simulate.conditions import Conditions, Random, scatter, stream

Effects = Sequence[tuple[Effect, Values]]

GYRO_HZ: Final = 10.0  # default if robot.yaml does not state it
ENCODERS_HZ: Final = 20.0
THERMOMETER_C: Final = 0.1
# Decimals in the files; numbers in memory are rounded alike.
DECIMALS: Final = 6


def bias_rad_s(time_s: Array, nominal: Robot, factor: float, seed: int) -> Array:
    """Bias at switch-on and its random walk, linear between samples; shape (n,)."""
    start = factor * (nominal.gyro_bias_repeatability_deg_s or 0.0) * RAD_PER_DEG
    start *= float(stream(seed, "gyro bias").standard_normal())
    period_s = 1.0 / (nominal.gyro_rate_hz or GYRO_HZ)
    walk = nominal.gyro_bias_random_walk_deg_per_h_per_sqrt_h or 0.0
    walk *= factor * RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H * math.sqrt(period_s)
    corners = math.ceil(float(time_s[-1]) / period_s) + 1
    walked = np.cumsum(walk * stream(seed, "gyro bias walk").standard_normal(corners))
    return np.asarray(start + np.interp(time_s, period_s * np.arange(1, corners + 1), walked))


def gyro_log(m: Motion, nominal: Robot, effects: Effects, conditions: Conditions, seed: int) -> FogLog:
    """Make a gyro's rows, each the mean since the row before, from a motion that includes its bias and effects."""
    at_s = _sampled_s(m, nominal.gyro_rate_hz or GYRO_HZ)
    interval_s = float(at_s[1] - at_s[0])
    rate = np.diff(_integral(m, m.rate_rad_s, at_s)) / interval_s
    at_s = at_s[1:]
    rate_deg_s = readings_deg_s(rate, interval_s, nominal, conditions, stream(seed, "gyro white"), effects)
    temperature_c = np.interp(at_s, m.time_s, m.temperature_c)
    if conditions.quantise:
        temperature_c = _rounded(temperature_c, THERMOMETER_C)
    stamps_s = _stamped(at_s, conditions.jitter_s, stream(seed, "gyro stamps"))
    return FogLog(stamps_s, np.round(rate_deg_s, DECIMALS) * RAD_PER_DEG, np.round(temperature_c, DECIMALS))


def readings_deg_s(
    rate_rad_s: Array, interval_s: float, nominal: Robot, conditions: Conditions, random: Random, effects: Effects = ()
) -> Array:
    """Convert mean rates, shape (n,), to a gyro's output: add white noise, apply limits and resolution."""
    white = conditions.gyro_noise * white_rad_s(nominal.gyro_angle_random_walk_deg_per_sqrt_h or 0.0, interval_s)
    rate = rate_rad_s + white * scatter(len(rate_rad_s), random, conditions.tails)
    for effect, values in effects:  # a limit of the output applies to the noise too
        rate = effect.clipped(rate, values)
    rate_deg_s = rate * DEG_PER_RAD
    if nominal.gyro_range_deg_s is not None:
        rate_deg_s = np.clip(rate_deg_s, -nominal.gyro_range_deg_s, nominal.gyro_range_deg_s)
    return _rounded(rate_deg_s, nominal.gyro_resolution_deg_s) if conditions.quantise else rate_deg_s


def white_rad_s(walk_deg_per_sqrt_h: float, interval_s: float) -> float:
    """Standard deviation of the mean rate over an interval, from the angle random walk."""
    return walk_deg_per_sqrt_h * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H / math.sqrt(interval_s)


def encoder_log(
    m: Motion, true: Motion, nominal: Robot, conditions: Conditions, seed: int, begin: tuple[float, float] = (0.0, 0.0)
) -> EncoderLog:
    """Make rows of whole counts, rounded down; or of mean speeds since the row before, if the drive has no counts.

    `m`: motion seen by the counters, `true`: true motion of the wheels. `begin`: initial fraction of a count, by wheel.
    """
    at_s = _sampled_s(m, nominal.encoders_rate_hz or ENCODERS_HZ)
    stamps_s = _stamped(at_s, conditions.jitter_s, stream(seed, "encoder stamps"))
    travel = {
        side: _travel_m(at_s, m, read, truth, side, nominal, conditions, seed)
        for side, read, truth in (("left", m.left_m_s, true.left_m_s), ("right", m.right_m_s, true.right_m_s))
    }
    per_revolution = nominal.counts_per_revolution
    if per_revolution is None:
        left, right = (np.diff(t, prepend=t[0]) / (at_s[1] - at_s[0]) / nominal.wheel_radius_m for t in travel.values())
        return EncoderLog(stamps_s, None, None, np.round(left, DECIMALS), np.round(right, DECIMALS))
    count_m = 2.0 * math.pi * nominal.wheel_radius_m / per_revolution
    # A wheel that returns to a whole count must read it; rounding errors of sums are far below 1e-6 of a count.
    left, right = (np.floor(t / count_m + part + 1e-6) for t, part in zip(travel.values(), begin, strict=True))
    return EncoderLog(stamps_s, left, right, None, None)


def _travel_m(
    at_s: Array,
    m: Motion,
    read_m_s: Array,
    true_m_s: Array,
    side: str,
    nominal: Robot,
    conditions: Conditions,
    seed: int,
) -> Array:
    """Travel measured by one counter, with slip noise and bumps along the wheel's true distance."""
    distance, steps = np.diff(_integral(m, np.abs(true_m_s), at_s)), np.diff(_integral(m, read_m_s, at_s))
    slip = conditions.wheel_noise * (nominal.slip_noise_m_per_sqrt_m or 0.0)
    noise = slip * np.sqrt(distance) * scatter(len(distance), stream(seed, f"{side} slip"), conditions.tails)
    ground = conditions.ground
    if ground.bump_m:
        random = stream(seed, f"{side} bumps")
        hits = random.poisson(ground.bump_per_m * distance)
        added_m = ground.bump_m * random.standard_gamma(np.maximum(hits, 1)) * (hits > 0)
        noise = noise + added_m * np.sign(np.diff(_integral(m, true_m_s, at_s)))
    noise[steps == 0.0] = 0.0  # a counter at rest has no noise
    return cumulative(steps + noise)


def reference_log(true: ReferenceLog, nominal: Robot, conditions: Conditions, seed: int) -> ReferenceLog | None:
    """The reference's measurements of the true poses, from 0 to the end; None without a reference."""
    reference = conditions.reference
    if not reference.is_there:
        return None
    end_s = float(true.time_s[-1])
    if reference.period_s is None:
        at_s = np.array([0.0, end_s])
    else:
        at_s = reference.period_s * np.arange(math.floor(end_s / reference.period_s + 1e-9) + 1)
    seen_s = np.maximum(at_s - reference.latency_s, 0.0)
    x, y, heading = (np.interp(seen_s, true.time_s, a) for a in (true.x_m, true.y_m, true.heading_rad))
    ahead_m, left_m = reference.lever_m
    sigma_m, sigma_deg = nominal.reference_position_sigma_m, nominal.reference_heading_sigma_deg
    c, s = np.cos(heading), np.sin(heading)

    def noise(what: str, sigma: float | None) -> Array:
        size = conditions.reference_noise * (sigma or 0.0)
        return size * scatter(len(at_s), stream(seed, f"reference {what}"), conditions.tails)

    return ReferenceLog(
        np.round(at_s, DECIMALS),
        np.round(x + ahead_m * c - left_m * s + noise("x", sigma_m), DECIMALS),
        np.round(y + ahead_m * s + left_m * c + noise("y", sigma_m), DECIMALS),
        continuous_rad(np.round(heading * DEG_PER_RAD + noise("heading", sigma_deg), DECIMALS)),
    )


def _sampled_s(m: Motion, rate_hz: float) -> Array:
    """Times of the samples, from 0 to the end, at least two."""
    return np.arange(max(2, math.floor(m.end_s * rate_hz + 1e-9) + 1)) / rate_hz


def _integral(m: Motion, values: Array, at_s: Array) -> Array:
    """Integrate means over the motion's steps, whose times are their middles, from 0 to each given time."""
    step_s = 2.0 * float(m.time_s[0])
    sums = cumulative(values) * step_s
    return np.asarray(np.interp(at_s, step_s * np.arange(len(sums)), sums))


def _stamped(at_s: Array, jitter_s: float, random: Random) -> Array:
    """Make stamps that scatter about the samples' times, but still increase."""
    if jitter_s:
        limit_s = 0.4 * float(at_s[1] - at_s[0])
        at_s = at_s + np.clip(jitter_s * random.standard_normal(len(at_s)), -limit_s, limit_s)
    return np.round(at_s, DECIMALS)


def _rounded(values: Array, resolution: float | None) -> Array:
    return resolution * np.round(values / resolution) if resolution else values
