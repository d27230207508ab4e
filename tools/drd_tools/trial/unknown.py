"""Physics in no catalogue, for the trial only: each must be reported as `unknown`, never as the nearest name."""

import math
from typing import ClassVar, Final

import numpy as np

from drd.arrays import Array
from drd.effects.effect import ActsOn, Chance, Effect, Errors, Parameter, Values, between, both, number
from drd.effects.motion import Motion

COIL_LAG_S: Final = 60.0
HALF_WIDTH_C: Final = 0.5


def _size(unit: str, text: str, si: float = 1.0, high: float = 1e3) -> Parameter:
    return Parameter("k", unit, text, 1e-6, high, si)


PERIOD: Final = Parameter("period", "s", "period", 10.0, 1e5, signed=False, linear=False)
PHASE: Final = Parameter("phase", "rad", "phase", 0.0, 6.3, linear=False)
ORDER: Final = Parameter("order", "1", "periods in a turn of the wheel", 0.2, 20.0, signed=False, linear=False)
PITCH: Final = Parameter("pitch", "m", "distance of the intervals", 0.5, 100.0, signed=False, linear=False)
DEG: Final = math.pi / 180.0


class Hidden(Effect):
    """An effect that the diagnosis cannot know. `temperature`: the profile that shows it, or any."""

    acts_on = ActsOn.GYRO
    formula = "see `error`"
    source = "made up"
    manoeuvre = "any"
    temperature: ClassVar[str] = ""

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        """Return one variant, whose period and pitch recur a few times in a drive."""
        middle = {PERIOD.name: 0.35 * m.end_s, PHASE.name: 0.0, PITCH.name: 4.0, ORDER.name: 2.7}
        return [{q.name: middle[q.name] for q in self.parameters if not q.linear}]

    def drawn(self, m: Motion, chance: Chance) -> Values:
        """Draw the nonlinear parameters, off the middle."""
        found = {
            PERIOD.name: between(0.25, 0.6, chance.period) * m.end_s,
            PHASE.name: between(0.0, 2.0 * math.pi, chance.phase),
            PITCH.name: between(3.0, 6.0, chance.pitch),
            ORDER.name: between(1.4, 3.8, chance.pitch),  # a drive at the usual speeds samples it several times
        }
        return {q.name: found[q.name] for q in self.parameters if not q.linear}


class BiasTide(Hidden):
    """The gyro's bias swings with the time of day."""

    id = "unknown_bias_tide"
    covariate = "time"
    parameters = (_size("deg/s", "amplitude", DEG), PERIOD, PHASE)

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=number(p, "k") * _swing(m, p))


class ScaleHysteresis(Hidden):
    """The gyro's scale is another one while the coil warms than while it cools."""

    id = "unknown_scale_hysteresis"
    covariate = "temperature"
    parameters = (_size("1", "half of the loop's width"),)
    temperature = "cycle"

    def error(self, m: Motion, p: Values) -> Errors:
        T = m.temperature_change_c()
        branch = np.tanh((T - m.lagged(T, COIL_LAG_S)) / HALF_WIDTH_C)
        return Errors(gyro_rad_s=number(p, "k") * branch * m.rate_rad_s)


class BiasAcceleration(Hidden):
    """The gyro's bias grows with the size of the acceleration, whatever its sign."""

    id = "unknown_bias_acceleration"
    covariate = "acceleration"
    # Where it turns on the spot only, no plausible size shows.
    parameters = (_size("deg/s/(m/s^2)", "per acceleration", DEG, high=1.0),)

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=number(p, "k") * np.abs(m.acceleration_m_s2))


class MotorField(Hidden):
    """The field of the left motor shakes the gyro once per turn of its wheel."""

    id = "unknown_motor_field"
    covariate = "wheel_phase"
    parameters = (_size("deg/s", "amplitude", DEG), PHASE)

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=number(p, "k") * np.cos(m.left_wheel_rad - number(p, "phase")))


class WheelGear(Hidden):
    """A gear behind the left wheel's encoder is off its centre: it turns more often than the wheel, or less."""

    id = "unknown_wheel_gear"
    acts_on = ActsOn.WHEELS
    covariate = "wheel_phase"
    parameters = (_size("1", "amplitude", high=0.1), ORDER, PHASE)

    def error(self, m: Motion, p: Values) -> Errors:
        """Acts on the left wheel."""
        return Errors(
            left_m_s=number(p, "k") * np.cos(number(p, "order") * m.left_wheel_rad + number(p, "phase")) * m.left_m_s
        )


class LoadTransfer(Hidden):
    """Both wheels roll on another radius in left than in right turns, the more the faster (speed times yaw rate)."""

    id = "unknown_load_transfer"
    acts_on = ActsOn.WHEELS
    covariate = "yaw_rate"
    # Where it turns on the spot only, no plausible size shows.
    parameters = (_size("s^2/m", "relative radius per lateral acceleration", high=0.2),)

    def error(self, m: Motion, p: Values) -> Errors:
        return both(m, number(p, "k") * m.speed_m_s * m.rate_rad_s)


class SlipMap(Hidden):
    """The ground's grip is a pattern in the plane: the wheels slip by place, time after time."""

    id = "unknown_slip_map"
    acts_on = ActsOn.WHEELS
    covariate = "place"
    parameters = (_size("1", "slip where it is largest"), PITCH, PHASE)

    def error(self, m: Motion, p: Values) -> Errors:
        step = m.speed_m_s * np.gradient(m.time_s)
        x, y = np.cumsum(step * np.cos(m.heading_rad)), np.cumsum(step * np.sin(m.heading_rad))
        a, phase = math.pi / number(p, "pitch"), number(p, "phase")
        return both(m, number(p, "k") * (np.sin(a * x + phase) * np.sin(a * y - phase)) ** 2)


class BreathingDelay(Hidden):
    """The encoders' delay rises and falls with the load of their bus."""

    id = "unknown_breathing_delay"
    acts_on = ActsOn.WHEELS
    covariate = "time"
    parameters = (_size("s", "amplitude of the delay"), PERIOD, PHASE)

    def error(self, m: Motion, p: Values) -> Errors:
        # To first order in the delay.
        delay_s = number(p, "k") * _swing(m, p)
        left, right = (-delay_s * np.gradient(v, m.time_s) for v in (m.left_m_s, m.right_m_s))
        return Errors(left_m_s=left, right_m_s=right)


class WarmTyres(Hidden):
    """The tyres grow and shrink with the temperature."""

    id = "unknown_warm_tyres"
    acts_on = ActsOn.WHEELS
    covariate = "temperature"
    parameters = (_size("1/degC", "relative radius per degree"),)
    temperature = "cycle"

    def error(self, m: Motion, p: Values) -> Errors:
        return both(m, number(p, "k") * m.temperature_change_c())


def _swing(m: Motion, p: Values) -> Array:
    return np.asarray(np.sin(2.0 * math.pi * m.time_s / number(p, "period") + number(p, "phase")))


HIDDEN: Final[dict[str, Hidden]] = {
    effect.id: effect
    for effect in (
        BiasTide(), ScaleHysteresis(), BiasAcceleration(), MotorField(),
        WheelGear(), LoadTransfer(), SlipMap(), BreathingDelay(), WarmTyres(),
    )
}  # fmt: skip
PREFIX: Final = "unknown_"
