"""Motions for tests of physical effects."""

import numpy as np

from drd.arrays import Array
from drd.effects.effect import Effect, Values
from drd.effects.motion import Motion

TREAD_M, RADIUS_M = 0.6, 0.1


def motion(rate_hz: float = 20.0, seconds: float = 120.0, seed: int = 1) -> Motion:
    """Turns both ways, acceleration and braking, some reverse, warming and cooling: all that excites effects."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(1, round(rate_hz * seconds) + 1) / rate_hz
    speed, rate = 0.5 * np.ones_like(time_s), np.zeros_like(time_s)
    for k in range(1, 5):
        phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        speed += 0.3 * np.sin(0.21 * k * time_s + phase[0])
        rate += 0.4 * np.sin(0.17 * k * time_s + phase[1])
    temperature_c = 22.0 + 6.0 * np.sin(2.0 * np.pi * time_s / seconds) + 2.0 * time_s / seconds
    return driven(time_s, speed, rate, temperature_c)


def driven(time_s: Array, speed: Array, rate: Array, temperature_c: Array) -> Motion:
    """A motion without slip; the first temperature is the standstill's, the run ends with its last sample."""
    step_s = np.diff(time_s, prepend=0.0)
    left, right = speed - 0.5 * TREAD_M * rate, speed + 0.5 * TREAD_M * rate
    return Motion(
        time_s,
        rate,
        speed,
        np.gradient(speed, time_s),
        np.cumsum(rate * step_s),
        left,
        right,
        np.cumsum(left * step_s) / RADIUS_M,
        np.cumsum(right * step_s) / RADIUS_M,
        temperature_c,
        float(temperature_c[0]),
        TREAD_M,
        RADIUS_M,
        float(time_s[-1]),
    )


def in_si(effect: Effect, values: Values) -> dict[str, float | str]:
    """Convert values from the catalogue's units to SI, for the formulas."""
    units = {q.name: q.si for q in effect.parameters}
    return {name: x if isinstance(x, str) else x * units[name] for name, x in values.items()}
