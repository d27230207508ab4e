"""Left and right turns have different scale factors."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, largest, np, number
from drd.effects.motion import Motion


class GyroScaleAsymmetry(Effect):
    """The gyro's scale factor differs between left and right turns: one reads too large, the other too small."""

    id = "gyro_scale_asymmetry"
    acts_on = ActsOn.GYRO
    formula = "e = k |w|"
    source = "IEEE Std 952-1997, scale factor asymmetry"
    parameters = (Parameter("k", "1", "relative scale-factor error in left turns; -k in right turns", 1e-5, 0.02),)
    covariate = "yaw_rate"
    manoeuvre = "as many turns to the left as to the right"

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=number(p, "k") * np.abs(m.rate_rad_s))

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # No kink at zero; an offset that grows less, or more, than in proportion.
        u = m.rate_rad_s / largest(m.rate_rad_s)
        return [Errors(gyro_rad_s=e) for e in (u * np.tanh(5.0 * u), np.sqrt(np.abs(u)), u**2)]


EFFECT = GyroScaleAsymmetry()
