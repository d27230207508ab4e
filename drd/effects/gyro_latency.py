"""A pure delay of the gyro's samples."""

from drd.effects.effect import ActsOn, Calibrated, Delays, Effect, Errors, Parameter, Values, number
from drd.effects.motion import Motion


class GyroLatency(Effect):
    """The gyro's samples are older than their time stamps by a constant delay."""

    id = "gyro_latency"
    acts_on = ActsOn.TIMING
    formula = "w_g(t) = w(t - delay)"
    source = "sensor protocols: filter, serial line, adapter"
    parameters = (Parameter("delay", "s", "age of a sample at its stamp", 0.001, 0.3, signed=False, linear=False),)
    covariate = "acceleration"
    manoeuvre = "turns that begin and end sharply; a closed loop hides it"

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=m.delayed(m.rate_rad_s, number(p, "delay")) - m.rate_rad_s)

    def correction(self, m: Motion, p: Values) -> Errors:
        return Errors()  # the stamps are corrected, which needs no future sample

    def delays(self, time_s: float, p: Values) -> Delays:
        return Delays(gyro_s=number(p, "delay"))

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"delay": delay_s} for delay_s in (0.01, 0.05, 0.1, 0.2, 0.4)]

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"delay": delay_s} for delay_s in (0.005, 0.05, 0.15)]

    def calibrated(self, constants: Calibrated) -> Values | None:
        return {"delay": constants.gyro_lag_s} if constants.by_gyro else None

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # A filter's lag, in what it differs from a delay; a queue that grows.
        rate, delay_s = m.rate_rad_s, max(number(p, "delay"), 1e-12)
        lag = m.lagged(rate, delay_s) - m.delayed(rate, delay_s)
        return [Errors(gyro_rad_s=e) for e in (lag, m.delayed(rate, delay_s * m.time_s / m.end_s) - rate)]


EFFECT = GyroLatency()
