"""Several effects acting together, for the simulator and for an effect that follows others."""

from collections.abc import Iterable
from copy import copy
from dataclasses import replace

import numpy as np

from drd.arrays import Array
from drd.effects.catalogue import acting_order
from drd.effects.effect import ActsOn, Effect, Values
from drd.effects.motion import Motion


def add(motion: Motion, effects: Iterable[tuple[Effect, Values]]) -> tuple[Motion, Array]:
    """Readings of gyro and wheels, and sideways speed of the body (m/s, left positive, shape (n,)), with these effects.

    Values are SI. Effects act in the catalogue's order, whatever the order given (the same effect twice: as given).
    Each acts on the gyro's rate and the wheels' speeds that those before it produced: a limit clips their sum, a
    latency delays it. Time, temperature, and the body's speed, heading and acceleration remain the true ones.
    A wheel turns as its counter reports, apart from the counter's unevenness: a larger wheel turns less.
    Effects of the body act first, so they see the true rate. The motion given is not changed.
    """
    lateral_m_s: Array = np.zeros_like(motion.time_s)
    for effect, values in sorted(effects, key=lambda pair: acting_order(pair[0])):
        error = effect.error(motion, values)
        left_m_s, right_m_s = motion.left_m_s + error.left_m_s, motion.right_m_s + error.right_m_s
        if effect.acts_on is ActsOn.WHEELS and not effect.uneven:
            motion = motion.turning(left_m_s, right_m_s)
        motion = replace(
            motion, rate_rad_s=motion.rate_rad_s + error.gyro_rad_s, left_m_s=left_m_s, right_m_s=right_m_s
        )
        lateral_m_s = lateral_m_s + error.lateral_m_s
    return motion, lateral_m_s


def geometry(motion: Motion, effects: Iterable[tuple[Effect, Values]]) -> Array:
    """Speeds that the counters of left and right wheel report, (2, 2), of unit speeds of each wheel.

    `effects`: of geometry, which is linear in both speeds, in the order in which they act. The motion given is not
    changed.
    """
    unit = copy(motion)
    unit.left_m_s, unit.right_m_s = np.eye(2)
    for effect, values in effects:
        error = effect.error(unit, values)
        unit.left_m_s, unit.right_m_s = unit.left_m_s + error.left_m_s, unit.right_m_s + error.right_m_s
    return np.stack([unit.left_m_s, unit.right_m_s])
