"""A constant error of the gyro's scale factor."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, number
from drd.effects.motion import Motion


class GyroScaleError(Effect):
    """The gyro's scale factor is off: every turn reads too large or too small by the same factor."""

    id = "gyro_scale_error"
    acts_on = ActsOn.GYRO
    formula = "w_g = (1 + k) w"
    source = "IEEE Std 952-1997; paper, section 2"
    parameters = (Parameter("k", "1", "relative error of the scale factor", 1e-5, 0.05, initial="gyro_scale"),)
    covariate = "yaw_rate"
    proportional = True
    manoeuvre = "many turns in the same direction"

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=number(p, "k") * m.rate_rad_s)

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # The light source's wavelength drifts through the run.
        return [Errors(gyro_rad_s=m.rate_rad_s * m.time_s)]


EFFECT = GyroScaleError()
