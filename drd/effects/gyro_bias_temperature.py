"""The gyro's bias follows its temperature."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, number
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG


class GyroBiasTemperature(Effect):
    """The gyro's bias follows its temperature and so leaves the value measured at standstill."""

    id = "gyro_bias_temperature"
    acts_on = ActsOn.GYRO
    formula = "e = b1 dT + b2 dT^2, dT = T minus its mean at standstill"
    source = "(3); IEEE Std 952-1997, bias sensitivity to temperature"
    parameters = (
        Parameter("b1", "deg/s/degC", "linear coefficient at the standstill temperature", 1e-5, 0.05, RAD_PER_DEG),
        Parameter("b2", "deg/s/degC^2", "quadratic coefficient", 1e-6, 0.005, RAD_PER_DEG),
    )
    covariate = "temperature"
    manoeuvre = "any drive while the temperature rises and falls, with standstills"

    def error(self, m: Motion, p: Values) -> Errors:
        change_c = m.temperature_change_c()
        return Errors(gyro_rad_s=change_c * (number(p, "b1") + number(p, "b2") * change_c))

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # A cubic; a coil that is slower than the thermometer.
        change_c = m.temperature_change_c()
        return [Errors(gyro_rad_s=e) for e in (change_c**3, m.lagged(change_c, 30.0), m.lagged(change_c, 120.0))]


EFFECT = GyroBiasTemperature()
