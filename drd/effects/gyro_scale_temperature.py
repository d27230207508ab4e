"""The gyro's scale factor follows its temperature."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, np, number
from drd.effects.gyro_scale_error import EFFECT as SCALE_ERROR
from drd.effects.motion import Motion


class GyroScaleTemperature(Effect):
    """The gyro's scale factor depends on its temperature: the same turn reads differently warm and cold."""

    id = "gyro_scale_temperature"
    acts_on = ActsOn.GYRO
    formula = "e = k (T - T0) w"
    source = "(5); Lefevre, The Fiber-Optic Gyroscope (2014): the light source's wavelength"
    parameters = (
        Parameter("k", "1/degC", "relative change of the scale factor", 1e-6, 5e-3),
        Parameter("T0", "degC", "temperature of zero error", -40.0, 85.0, linear=False, fixed=True),
    )
    covariate = "temperature"
    manoeuvre = "turns at several temperatures"
    beside = SCALE_ERROR

    def error(self, m: Motion, p: Values) -> Errors:
        # nan_to_num: an unknown temperature is taken as T0.
        return Errors(gyro_rad_s=number(p, "k") * np.nan_to_num(m.temperature_c - number(p, "T0")) * m.rate_rad_s)

    def absorbed(self, p: Values, k: float) -> Values | None:
        # k (T - T0) w + scale w
        own = number(p, "k")
        return {**p, "T0": number(p, "T0") - k / own} if own else p

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"T0": m.still_c if np.isfinite(m.still_c) else 20.0}]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # A quadratic; a coil that is slower than the thermometer.
        change_c = np.nan_to_num(m.temperature_c - number(p, "T0"))
        return [Errors(gyro_rad_s=m.rate_rad_s * e) for e in (change_c**2, m.lagged(change_c, 120.0))]


EFFECT = GyroScaleTemperature()
