"""What a robot's sensors say about a true motion: noise as in their data sheets, effects of the catalogue on top."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from drd.batch.logs import EncoderLog, FogLog
from drd.config.nominal import FogSheet, Nominal
from drd.effects.chain import add
from drd.effects.effect import ActsOn, Effect, Values
from drd.effects.motion import Motion
from drd.units import (
    DEG_PER_RAD,
    RAD_PER_DEG,
    RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H,
    RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H,
)
from drd_tools.recordings.folder import Recording, ReferenceLog
from drd_tools.simulate.conditions import Conditions, Ground, Random, scatter, stream, wandering
from drd_tools.simulate.route import STEP_S, Array
from drd_tools.simulate.truth import Truth

Effects = Sequence[tuple[Effect, Values]]

GYRO_HZ: Final = 10.0  # where robot.yaml does not say
ENCODERS_HZ: Final = 20.0
THERMOMETER_C: Final = 0.1
# Decimals in the files; the numbers in memory are those that a reader of the files finds.
DECIMALS: Final = 6


@dataclass(frozen=True)
class Simulated:
    """A recording as if read from a folder, and what is true: `truth` slides as the effects and the ground make it.

    `motion`: what the sensors would say without noise, at 500 Hz, shape (n,). `bias_rad_s`: the gyro's at the start.
    """

    recording: Recording
    truth: Truth
    motion: Motion
    effects: Effects
    conditions: Conditions
    seed: int
    bias_rad_s: float


def simulate(
    truth: Truth,
    nominal: Nominal,
    effects: Effects = (),
    conditions: Conditions | None = None,
    seed: int = 0,
    name: str = "simulated",
) -> Simulated:
    """Drive `truth` with the robot that `nominal` describes and with `effects` (values in SI).

    The same arguments give the same bits. Each source of noise has its own random numbers, so that with other effects
    the noise is the same. No gyro where robot.yaml has no `fog`.
    """
    conditions = conditions or Conditions()
    has_gyro = nominal.fog != FogSheet()
    motion, slide = _motion(truth, nominal, conditions.ground, seed)
    true, bias = motion, np.zeros_like(motion.time_s)
    of_body = [pair for pair in effects if pair[0].acts_on is ActsOn.BODY]
    motion, lateral = add(motion, of_body)
    if has_gyro:
        # The bias is the sensor's: a body does not slide with it, a dead band swallows it.
        bias = _bias_rad_s(motion.time_s, nominal.fog, conditions.gyro_noise, seed)
        motion = replace(motion, rate_rad_s=motion.rate_rad_s + bias)
    motion, _ = add(motion, [pair for pair in effects if pair not in of_body])
    truth = truth.sliding(slide + lateral) if np.any(slide + lateral) else truth
    recording = Recording(
        Path(name),
        nominal,
        _encoders(motion, true, nominal, conditions, seed),
        _fog(motion, nominal.fog, effects, conditions, seed) if has_gyro else None,
        _reference(truth, nominal, conditions, seed),
        {},
    )
    return Simulated(recording, truth, motion, effects, conditions, seed, float(bias[0]))


def _motion(truth: Truth, nominal: Nominal, ground: Ground, seed: int) -> tuple[Motion, Array]:
    """What perfect sensors of the nominal robot would say on this ground, and how fast the body slides sideways."""
    v, w, half_m = truth.speed_m_s, truth.rate_rad_s, 0.5 * nominal.tread_m
    left_m = right_m = np.full_like(v, half_m)
    slide = np.zeros_like(v)
    if ground.skid or ground.centre_m:
        way = np.cumsum(0.5 * (np.abs(v - half_m * w) + np.abs(v + half_m * w))) * STEP_S

        def wander(what: str) -> Array:
            return wandering(way, ground.skid_length_m, stream(seed, what))

        # Centres of rotation of the two sides (Mandow et al., IROS 2007): at y_l to the left, y_r to the right, and
        # lengthwise at x_v: v_y = -w x_v.
        left_m = half_m * (1.0 + ground.skid * wander("left centre of rotation"))
        right_m = half_m * (1.0 + ground.skid * wander("right centre of rotation"))
        slide = -w * ground.centre_m * wander("lengthwise centre of rotation")
    left, right = v - left_m * w, v + right_m * w
    standing = truth.middle_s <= max(nominal.standstill_at_start_s, STEP_S)
    motion = Motion(
        time_s=truth.middle_s,
        rate_rad_s=w,
        speed_m_s=v,
        acceleration_m_s2=np.gradient(v, STEP_S),
        heading_rad=0.5 * (truth.heading_rad[1:] + truth.heading_rad[:-1]),
        left_m_s=left,
        right_m_s=right,
        left_wheel_rad=np.cumsum(left) * STEP_S / nominal.wheel.radius_m,
        right_wheel_rad=np.cumsum(right) * STEP_S / nominal.wheel.radius_m,
        temperature_c=truth.temperature_c,
        still_c=float(truth.temperature_c[standing].mean()),
        tread_m=nominal.tread_m,
        end_s=truth.duration_s,
    )
    return motion, slide


def _bias_rad_s(time_s: Array, sheet: FogSheet, factor: float, seed: int) -> Array:
    """Bias at switch-on and its random walk, which has a corner at each sample."""
    start = factor * (sheet.bias_repeatability_deg_s or 0.0) * RAD_PER_DEG
    start *= float(stream(seed, "gyro bias").standard_normal())
    period_s = 1.0 / (sheet.rate_hz or GYRO_HZ)
    walk = sheet.bias_random_walk_deg_per_h_per_sqrt_h or 0.0
    walk *= factor * RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H * math.sqrt(period_s)
    corners = math.ceil(float(time_s[-1]) / period_s) + 1
    walked = np.cumsum(walk * stream(seed, "gyro bias walk").standard_normal(corners))
    return np.asarray(start + np.interp(time_s, period_s * np.arange(1, corners + 1), walked))


def _fog(m: Motion, sheet: FogSheet, effects: Effects, conditions: Conditions, seed: int) -> FogLog:
    """Each sample is the mean over the time since the one before."""
    at_s = _sampled_s(m, sheet.rate_hz or GYRO_HZ)
    interval_s = float(at_s[1] - at_s[0])
    rate = np.diff(_integral(m.rate_rad_s, at_s)) / interval_s
    at_s = at_s[1:]
    walk = sheet.angle_random_walk_deg_per_sqrt_h or 0.0
    walk *= conditions.gyro_noise * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H / math.sqrt(interval_s)
    rate = rate + walk * scatter(len(rate), stream(seed, "gyro white"), conditions.tails)
    for effect, values in effects:  # a limit of the output holds for the noise as well
        rate = effect.clipped(rate, values)
    rate_deg_s = rate * DEG_PER_RAD
    if sheet.range_deg_s is not None:
        rate_deg_s = np.clip(rate_deg_s, -sheet.range_deg_s, sheet.range_deg_s)
    temperature_c = np.interp(at_s, m.time_s, m.temperature_c)
    if conditions.quantise:
        rate_deg_s = _rounded(rate_deg_s, sheet.resolution_deg_s)
        temperature_c = _rounded(temperature_c, THERMOMETER_C)
    stamps_s = _stamped(at_s, conditions.jitter_s, stream(seed, "gyro stamps"))
    return FogLog(stamps_s, np.round(rate_deg_s, DECIMALS) * RAD_PER_DEG, np.round(temperature_c, DECIMALS))


def _encoders(m: Motion, true: Motion, nominal: Nominal, conditions: Conditions, seed: int) -> EncoderLog:
    """Whole counts, rounded down; where the drive reports speed only, means over the time since the row before."""
    at_s = _sampled_s(m, nominal.encoders.rate_hz or ENCODERS_HZ)
    stamps_s = _stamped(at_s, conditions.jitter_s, stream(seed, "encoder stamps"))
    travel = {
        side: _travel_m(at_s, read, way, side, nominal, conditions, seed)
        for side, read, way in (("left", m.left_m_s, true.left_m_s), ("right", m.right_m_s, true.right_m_s))
    }
    per_revolution = nominal.wheel.counts_per_revolution
    if per_revolution is None:
        left, right = (np.diff(t, prepend=t[0]) / (at_s[1] - at_s[0]) / nominal.wheel.radius_m for t in travel.values())
        return EncoderLog(stamps_s, None, None, np.round(left, DECIMALS), np.round(right, DECIMALS))
    count_m = 2.0 * math.pi * nominal.wheel.radius_m / per_revolution
    # A wheel that came back to a whole count is on it; rounding errors of sums are far below 1e-6 of a count.
    left, right = (np.floor(t / count_m + 1e-6) for t in travel.values())
    return EncoderLog(stamps_s, left, right, None, None)


def _travel_m(
    at_s: Array, read_m_s: Array, true_m_s: Array, side: str, nominal: Nominal, conditions: Conditions, seed: int
) -> Array:
    """What one counter has counted, with slip noise and bumps along the wheel's true way."""
    way, steps = np.diff(_integral(np.abs(true_m_s), at_s)), np.diff(_integral(read_m_s, at_s))
    slip = conditions.wheel_noise * (nominal.encoders.slip_noise_m_per_sqrt_m or 0.0)
    noise = slip * np.sqrt(way) * scatter(len(way), stream(seed, f"{side} slip"), conditions.tails)
    ground = conditions.ground
    if ground.bump_m:
        random = stream(seed, f"{side} bumps")
        hits = random.poisson(ground.bump_per_m * way)
        added_m = ground.bump_m * random.standard_gamma(np.maximum(hits, 1)) * (hits > 0)
        noise = noise + added_m * np.sign(np.diff(_integral(true_m_s, at_s)))
    noise[steps == 0.0] = 0.0  # a counter that stands still has no noise
    return np.concatenate(([0.0], np.cumsum(steps + noise)))


def _reference(truth: Truth, nominal: Nominal, conditions: Conditions, seed: int) -> ReferenceLog | None:
    reference, sheet = conditions.reference, nominal.reference
    if not reference.is_there:
        return None
    end_s = truth.duration_s
    if reference.period_s is None:
        at_s = np.array([0.0, end_s])
    else:
        at_s = reference.period_s * np.arange(math.floor(end_s / reference.period_s + 1e-9) + 1)
    seen_s = np.maximum(at_s - reference.latency_s, 0.0)
    x, y, heading = (np.interp(seen_s, truth.time_s, a) for a in (truth.x_m, truth.y_m, truth.heading_rad))
    ahead_m, left_m = reference.lever_m
    c, s = np.cos(heading), np.sin(heading)

    def noise(what: str, sigma: float | None) -> Array:
        size = conditions.reference_noise * (sigma or 0.0)
        return size * scatter(len(at_s), stream(seed, f"reference {what}"), conditions.tails)

    heading_deg = np.round(heading * DEG_PER_RAD + noise("heading", sheet.heading_sigma_deg), DECIMALS)
    heading = heading_deg * RAD_PER_DEG
    return ReferenceLog(
        np.round(at_s, DECIMALS),
        np.round(x + ahead_m * c - left_m * s + noise("x", sheet.position_sigma_m), DECIMALS),
        np.round(y + ahead_m * s + left_m * c + noise("y", sheet.position_sigma_m), DECIMALS),
        np.unwrap(heading) if np.ptp(heading_deg) <= 360.0 else heading,  # as the folder's reader takes it
    )


def _sampled_s(m: Motion, rate_hz: float) -> Array:
    """From 0 to the end, at least two."""
    return np.arange(max(2, math.floor(m.end_s * rate_hz + 1e-9) + 1)) / rate_hz


def _integral(values: Array, at_s: Array) -> Array:
    """Of step means, from 0 to each time."""
    sums = np.concatenate(([0.0], np.cumsum(values))) * STEP_S
    return np.interp(at_s, STEP_S * np.arange(len(sums)), sums)


def _stamped(at_s: Array, jitter_s: float, random: Random) -> Array:
    """Stamps that scatter about the samples' times, and still rise."""
    if jitter_s:
        limit_s = 0.4 * float(at_s[1] - at_s[0])
        at_s = at_s + np.clip(jitter_s * random.standard_normal(len(at_s)), -limit_s, limit_s)
    return np.round(at_s, DECIMALS)


def _rounded(values: Array, resolution: float | None) -> Array:
    return resolution * np.round(values / resolution) if resolution else values
