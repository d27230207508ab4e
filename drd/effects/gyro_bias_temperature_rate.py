"""The Shupe effect: the gyro's bias follows the rate of temperature."""

from drd.effects.effect import ActsOn, Chance, Effect, Errors, Parameter, Values, between_logs, number
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG


class GyroBiasTemperatureRate(Effect):
    """While the gyro warms or cools, the temperature gradient across its coil shifts the bias (Shupe effect)."""

    id = "gyro_bias_temperature_rate"
    acts_on = ActsOn.GYRO
    formula = "e = b dT/dt, low-passed by the coil's first-order lag"
    source = "Shupe, Appl. Opt. 19 (1980) 654"
    parameters = (
        Parameter("b", "deg/s per degC/s", "bias per rate of temperature change", 1e-3, 1.0, RAD_PER_DEG),
        Parameter("coil_lag_s", "s", "thermal time constant of the coil", 5.0, 300.0, signed=False, linear=False),
    )
    covariate = "temperature_rate"
    manoeuvre = "any drive while the temperature rises and falls again"

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=number(p, "b") * m.temperature_rate_c_s(number(p, "coil_lag_s")))

    def lag_s(self, p: Values) -> float:
        return number(p, "coil_lag_s")

    def drawn(self, m: Motion, chance: Chance) -> Values:
        return {"coil_lag_s": between_logs(10.0, 100.0, chance.lag)}

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"coil_lag_s": lag_s} for lag_s in (15.0, 40.0, 100.0)]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # A faster or slower coil; heat that passes two layers.
        lag_s = number(p, "coil_lag_s")
        twice = m.lagged(m.temperature_rate_c_s(lag_s), lag_s)
        return [
            Errors(gyro_rad_s=e)
            for e in (m.temperature_rate_c_s(lag_s / 3.0), m.temperature_rate_c_s(3.0 * lag_s), twice)
        ]


EFFECT = GyroBiasTemperatureRate()
