"""Simulated gyros by Table I: each has its own random error function, which is not a polynomial."""

import math
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.config.robot import Robot
from drd.effects.effect import ActsOn, Effect, Errors, Values
from drd.effects.motion import Motion
from drd.units import DEG_PER_RAD, RAD_PER_DEG
from drd_tools.paper.physics import Gyro, RateTable
from drd_tools.simulate.conditions import Conditions, Random, wandering
from drd_tools.simulate.sensors import readings_deg_s

TEMPERATURE_RANGE_C: Final = (-40.0, 75.0)
FACTORY_C: Final = 25.0  # temperature at which scale factor and bias are set
# Relative sizes of the curves' components. Rate: the sine of the Sagnac phase, and a difference between left and right
# turns due to an offset of that phase. Temperature: slope and curvature.
RATE_SHAPES: Final = (1.0, 0.3)
TEMPERATURE_SHAPES: Final = (1.0, 0.5)
RIPPLE: Final = 0.05  # effects of electronics and optics beyond low orders, as a share of the specification
PHASE_AT_FULL_SCALE_RAD: Final = 0.44  # 150 m of fibre on 66 mm at 820 nm
GRID: Final = 801
INTERVAL_S: Final = 0.1


class SimulatedGyro(Effect):
    """One gyro of the population: its error by rate and temperature, and a bias that wanders."""

    id = "gyro_scale_nonlinearity"  # in its place in the catalogue's order
    acts_on = ActsOn.GYRO
    parameters = ()

    def __init__(self, physics: Gyro, random: Random):
        self._physics, self._random = physics, random
        self.sheet = Robot(
            name="paper",
            wheel_radius_m=math.nan,
            tread_m=math.nan,
            gyro_rate_hz=1.0 / INTERVAL_S,
            gyro_range_deg_s=physics.full_scale_deg_s,
            gyro_angle_random_walk_deg_per_sqrt_h=physics.walk_deg_per_sqrt_h,
            gyro_resolution_deg_s=physics.count_deg_s,
        )
        rate = np.linspace(-1.0, 1.0, GRID)  # of full scale
        phase = PHASE_AT_FULL_SCALE_RAD * rate
        # (sin(phase + offset) - sin(offset)) / phase: an even and, by the offset, an odd part.
        half = 0.5 * phase
        shapes = np.sinc(phase / math.pi), half * np.sinc(half / math.pi) ** 2
        curve = _mixed(shapes, RATE_SHAPES, random)
        # The datasheet's straight line is the best one over the full range.
        curve -= np.average(curve, weights=rate**2)
        curve = curve / math.sqrt(np.mean(curve**2)) + _ripple(6.0 * rate, random)
        self._scale_at = rate * physics.full_scale_deg_s, curve * physics.nonlinearity
        self._scale_at_c = _over_temperature(physics.scale_over_temperature, random)
        self._bias_at_c = _over_temperature(physics.bias_over_temperature_deg_s, random)

    def error_deg_s(self, rate_deg_s: Array | float, temperature_c: Array | float) -> Array:
        """The error without noise at a true rate and temperature; the shape of the two broadcast. (1)"""
        scale = np.interp(rate_deg_s, *self._scale_at) + np.interp(temperature_c, *self._scale_at_c)
        return np.asarray(scale * np.asarray(rate_deg_s) + np.interp(temperature_c, *self._bias_at_c))

    def error(self, m: Motion, p: Values) -> Errors:  # noqa: ARG002  # it has none
        """Errors on a drive; the bias wander is drawn anew each time."""
        error_deg_s = self.error_deg_s(DEG_PER_RAD * m.rate_rad_s, m.temperature_c) + self._wander_deg_s(m.time_s)
        return Errors(gyro_rad_s=RAD_PER_DEG * error_deg_s)

    def _wander_deg_s(self, time_s: Array) -> Array:
        p = self._physics
        return p.bias_stability_deg_s * wandering(time_s, p.bias_correlation_s, self._random)

    def read(self, rate_deg_s: Array, temperature_c: Array) -> tuple[Array, Array]:
        """Readings of successive intervals, ccw positive: rate in deg/s and temperature, both of shape (n,)."""
        unit_c, time_s = self._physics.thermometer_c, np.asarray(INTERVAL_S * np.arange(len(rate_deg_s)))
        rate = rate_deg_s + self.error_deg_s(rate_deg_s, temperature_c) + self._wander_deg_s(time_s)
        read = readings_deg_s(RAD_PER_DEG * rate, INTERVAL_S, self.sheet, Conditions(), self._random)
        return read, unit_c * np.round(temperature_c / unit_c)

    def on_rate_table(self, table: RateTable) -> tuple[Array, Array, Array, Array]:
        """A calibration's samples: time_s, table_rate_deg_s, rate_deg_s, temperature_c, each of shape (n,)."""
        limit = 0.95 * self._physics.full_scale_deg_s  # beyond, it would clip due to its scale error
        steps = round(limit / table.rate_step_deg_s)
        rates = np.linspace(-limit, limit, 2 * steps + 1)
        temperatures = np.linspace(table.coldest_c, table.warmest_c, round(table.temperatures))
        samples = round(table.dwell_s / INTERVAL_S)
        # Successive dwells have different rates, so that they can be told apart.
        true = np.tile(np.repeat(rates, samples), len(temperatures))
        temperature = np.repeat(temperatures, samples * len(rates))
        rate, read_c = self.read(true, temperature)
        return np.asarray(INTERVAL_S * np.arange(len(true))), true, rate, read_c


def _mixed(shapes: tuple[Array, ...], sizes: tuple[float, ...], random: Random) -> Array:
    """Random mixture of shapes, each first centred and scaled to unit size."""
    total = np.zeros_like(shapes[0])
    for shape, size in zip(shapes, sizes, strict=True):
        centred = shape - shape.mean()
        total += size * random.standard_normal() * centred / centred.std()
    return total


def _ripple(phase_rad: Array, random: Random) -> Array:
    return np.asarray(RIPPLE * random.standard_normal() * np.sin(phase_rad + random.uniform(0.0, 2.0 * math.pi)))


def _over_temperature(peak_to_peak: float, random: Random) -> tuple[Array, Array]:
    """Draw a curve over the full temperature range that is zero at the factory's setting; for np.interp."""
    temperature = np.linspace(*TEMPERATURE_RANGE_C, GRID)
    t = (temperature - FACTORY_C) / 60.0
    curve = _mixed((t, t**2), TEMPERATURE_SHAPES, random)
    curve = peak_to_peak * (curve / np.ptp(curve) + _ripple(6.0 * t, random))
    return temperature, curve - np.interp(FACTORY_C, temperature, curve)
