"""The gyro's finite bandwidth."""

from drd.effects.effect import ActsOn, Calibrated, Delays, Effect, Errors, Parameter, Values, number
from drd.effects.motion import Motion


class GyroLag(Effect):
    """The gyro follows changes of rate with a first-order lag, as a sensor of low bandwidth does."""

    id = "gyro_lag"
    acts_on = ActsOn.TIMING
    formula = "tau dw_g/dt + w_g = w"
    source = "first-order low-pass; IEEE Std 952-1997, bandwidth"
    parameters = (Parameter("tau", "s", "time constant", 0.002, 0.3, signed=False, linear=False),)
    covariate = "acceleration"
    manoeuvre = "turns that begin and end sharply; a closed loop hides it"
    remainder = 0.3  # of the angle, in turns that begin within half a second; half the time constant over that time

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=m.lagged(m.rate_rad_s, max(number(p, "tau"), 1e-12)) - m.rate_rad_s)

    def correction(self, m: Motion, p: Values) -> Errors:
        return Errors()  # undoing it exactly needs the rate's derivative, which is mostly noise

    def delays(self, time_s: float, p: Values) -> Delays:
        return Delays(gyro_s=number(p, "tau"))  # of a steady change, all that a lag does

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"tau": tau_s} for tau_s in (0.01, 0.03, 0.1, 0.3)]

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"tau": tau_s} for tau_s in (0.01, 0.05, 0.15)]

    def calibrated(self, constants: Calibrated) -> Values | None:
        return {"tau": 0.0} if constants.by_gyro else None  # wheels and reference smooth, too

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # An averager, or a filter of higher order: the same delay, but less of the second derivative.
        late = m.rate_rad_s + self.error(m, p).gyro_rad_s
        return [Errors(gyro_rad_s=m.delayed(m.rate_rad_s, number(p, "tau")) - late)]


EFFECT = GyroLag()
