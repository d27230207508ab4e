"""Errors of effects along the readings that other effects make. (73)"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drd.effects.catalogue import catalogue
from drd.effects.effect import ActsOn, Begins, Delays, Effect, Errors
from drd.effects.motion import Motion
from drd_tools.diagnose.error_model.sensitivities import Sensitivities
from drd_tools.diagnose.results import Array
from drd_tools.diagnose.selected import BIAS, SCALE, Selected, Values


def chain_of(selection: Sequence[Selected]) -> tuple[Selected, ...]:
    """The selected effects on whose outcome others act, in the order in which they act: geometry, and delays."""
    order = list(catalogue())
    chained = (c for c in selection if c.effect.geometry or _is_delay(c.effect))
    return tuple(sorted(chained, key=lambda c: order.index(c.id)))


def _is_delay(effect: Effect) -> bool:
    return effect.acts_on is ActsOn.TIMING and effect.channel == "wheels"


def has_clock(chain: Sequence[Selected]) -> bool:
    """Whether a clock of the wheels is among the effects of a chain."""
    return any(_is_delay(c.effect) and c.effect.begins is Begins.GROWING for c in chain)


def errors_of(sensitivities: Sensitivities, chain: Sequence[Selected], effect: Effect, values: Values) -> Errors:
    """Errors of an effect: along the readings that those of the chain make which come before it."""
    motion = sensitivities.motion
    if effect.channel == "wheels":
        order = list(catalogue())
        motion = with_chain(motion, [c for c in chain if order.index(c.id) < order.index(effect.id)])
    if effect.acts_on is ActsOn.READOUT:
        motion = replace(motion, rate_rad_s=sensitivities.calm_rate_rad_s + float(values.get(BIAS.name, 0.0)))
    errors = effect.error(motion, values)
    if SCALE.name in values:
        other = beside(effect, motion, float(values[SCALE.name]))
        errors = errors._replace(gyro_rad_s=errors.gyro_rad_s + other.gyro_rad_s)
    return errors


def delays_s(selection: Sequence[Selected], at_s: Array) -> tuple[Array, Array]:
    """How late the gyro and the wheels are at these times, (n,) each: clocks drift along a line."""
    ends_s = at_s[[0, -1]]
    of_ends = [[c.effect.delays(float(t), c.values) for c in selection] for t in ends_s]
    gyro, wheels = ([sum(getattr(d, name) for d in delays) for delays in of_ends] for name in Delays._fields)
    return np.interp(at_s, ends_s, gyro), np.interp(at_s, ends_s, wheels)


def with_chain(motion: Motion, chain: Sequence[Selected]) -> Motion:
    """The motion, with the wheels' speeds as counters tell them that these effects act on, one after the other. (73)"""
    for c in chain:
        error = c.effect.error(motion, c.values)
        left, right = motion.left_m_s + error.left_m_s, motion.right_m_s + error.right_m_s
        motion = replace(motion, left_m_s=left, right_m_s=right)
    return motion


def beside(effect: Effect, motion: Motion, size: float) -> Errors:
    """Errors, at a size, of the effect beside which alone another's form is known."""
    assert effect.beside is not None
    return effect.beside.error(motion, {effect.beside.parameters[0].name: size})
