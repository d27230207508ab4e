"""Simulation of a robot's sensors for a true motion, with datasheet noise and effects of the catalogue."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drd.arrays import Array
from drd.config.robot import Robot
from drd.effects.chain import add
from drd.effects.effect import ActsOn
from drd.effects.motion import Motion
from drd_tools.recordings.folder import Recording, ReferenceLog
from drd_tools.simulate.conditions import Conditions, Ground, stream, wandering
from drd_tools.simulate.route import STEP_S
from drd_tools.simulate.sensors import Effects, bias_rad_s, encoder_log, gyro_log, reference_log
from drd_tools.simulate.truth import Truth


@dataclass(frozen=True)
class Simulated:
    """A recording as if read from a folder, and its truth; `truth` includes the slide due to effects and ground.

    `motion`: noise-free readings of the sensors, at 500 Hz, shape (n,). `bias_rad_s`: the gyro's at the start.
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
    nominal: Robot,
    effects: Effects = (),
    conditions: Conditions | None = None,
    seed: int = 0,
    name: str = "simulated",
) -> Simulated:
    """Drive `truth` with the robot that `nominal` describes and with `effects` (values in SI).

    The same arguments give the same bits. Each source of noise has its own random numbers, so that the noise does not
    depend on the effects. There is no gyro if robot.yaml has no `fog`.
    """
    conditions = conditions or Conditions()
    has_gyro = nominal.has_gyro_sheet
    motion, slide = _motion(truth, nominal, conditions.ground, seed)
    true, bias = motion, np.zeros_like(motion.time_s)
    of_body = [pair for pair in effects if pair[0].acts_on is ActsOn.BODY]
    motion, lateral = add(motion, of_body)
    if has_gyro:
        # The bias is the sensor's: it does not make the body slide, but a dead band absorbs it.
        bias = bias_rad_s(motion.time_s, nominal, conditions.gyro_noise, seed)
        motion = replace(motion, rate_rad_s=motion.rate_rad_s + bias)
    motion, _ = add(motion, [pair for pair in effects if pair not in of_body])
    truth = truth.sliding(slide + lateral) if np.any(slide + lateral) else truth
    path = ReferenceLog(truth.time_s, truth.x_m, truth.y_m, truth.heading_rad)
    recording = Recording(
        Path(name),
        nominal,
        encoder_log(motion, true, nominal, conditions, seed),
        gyro_log(motion, nominal, effects, conditions, seed) if has_gyro else None,
        reference_log(path, nominal, conditions, seed),
        {},
    )
    return Simulated(recording, truth, motion, effects, conditions, seed, float(bias[0]))


def _motion(truth: Truth, nominal: Robot, ground: Ground, seed: int) -> tuple[Motion, Array]:
    """Motion as measured by perfect sensors of the nominal robot on this ground, and the body's sideways speed."""
    v, w, half_m = truth.speed_m_s, truth.rate_rad_s, 0.5 * nominal.tread_m
    left_m = right_m = np.full_like(v, half_m)
    slide = np.zeros_like(v)
    if ground.skid or ground.centre_m:
        distance = np.cumsum(0.5 * (np.abs(v - half_m * w) + np.abs(v + half_m * w))) * STEP_S

        def wander(what: str) -> Array:
            return wandering(distance, ground.skid_length_m, stream(seed, what))

        # Centres of rotation of the two sides (Mandow et al., IROS 2007): at y_l to the left, y_r to the right, and
        # lengthwise at x_v: v_y = -w x_v.
        left_m = half_m * (1.0 + ground.skid * wander("left centre of rotation"))
        right_m = half_m * (1.0 + ground.skid * wander("right centre of rotation"))
        slide = -w * ground.centre_m * wander("lengthwise centre of rotation")
    left, right = v - left_m * w, v + right_m * w
    return motion_along(
        truth, nominal.wheel_radius_m, nominal.tread_m, left, right, nominal.standstill_at_start_s
    ), slide


def motion_along(
    truth: Truth, radius_m: float, tread_m: float, left_m_s: Array, right_m_s: Array, standstill_s: float = 0.0
) -> Motion:
    """Make the motion that effects act on, from the truth and the speeds of both wheels."""
    standing = truth.middle_s <= max(standstill_s, STEP_S)
    return Motion(
        time_s=truth.middle_s,
        rate_rad_s=truth.rate_rad_s,
        speed_m_s=truth.speed_m_s,
        acceleration_m_s2=np.gradient(truth.speed_m_s, STEP_S),
        heading_rad=0.5 * (truth.heading_rad[1:] + truth.heading_rad[:-1]),
        left_m_s=left_m_s,
        right_m_s=right_m_s,
        left_wheel_rad=np.cumsum(left_m_s) * STEP_S / radius_m,
        right_wheel_rad=np.cumsum(right_m_s) * STEP_S / radius_m,
        temperature_c=truth.temperature_c,
        still_c=float(truth.temperature_c[standing].mean()),
        tread_m=tread_m,
        wheel_radius_m=radius_m,
        end_s=truth.duration_s,
    )
