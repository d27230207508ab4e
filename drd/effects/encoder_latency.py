"""A pure delay of the encoders' samples."""

from drd.effects.effect import ActsOn, Calibrated, Delays, Effect, Errors, Parameter, Values, number
from drd.effects.motion import Motion


class EncoderLatency(Effect):
    """The encoders' samples are older than their time stamps by a constant delay."""

    id = "encoder_latency"
    acts_on = ActsOn.TIMING
    formula = "travel read at t = travel at t - delay"
    source = "definition; drives accumulate, filter and transmit their counts periodically"
    parameters = (
        Parameter(
            "delay", "s", "age of a sample at its stamp", 0.001, 0.5, signed=False, linear=False, initial="wheel_lag_s"
        ),
    )
    covariate = "acceleration"
    manoeuvre = "hard starts and stops, turns that begin and end sharply"

    def error(self, m: Motion, p: Values) -> Errors:
        left_m_s, right_m_s = m.wheels_change(number(p, "delay"))
        return Errors(left_m_s=left_m_s, right_m_s=right_m_s)

    def correction(self, m: Motion, p: Values) -> Errors:
        return Errors()  # the stamps are corrected, which needs no future sample

    def delays(self, time_s: float, p: Values) -> Delays:
        return Delays(wheels_s=number(p, "delay"))

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"delay": delay_s} for delay_s in (0.01, 0.05, 0.1, 0.2, 0.4)]

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"delay": delay_s} for delay_s in (0.005, 0.05, 0.15)]

    def calibrated(self, constants: Calibrated) -> Values | None:
        return {"delay": constants.wheels_lag_s}

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # One wheel's frame after the other's; a filter's lag, in what it differs from a delay.
        left, right, delay_s = m.left_m_s, m.right_m_s, max(number(p, "delay"), 1e-12)
        left_late, right_late = map(m.delay(delay_s), (left, right))
        lag = Errors(left_m_s=m.lagged(left, delay_s) - left_late, right_m_s=m.lagged(right, delay_s) - right_late)
        return [Errors(left_m_s=left_late - left, right_m_s=right - right_late), lag]


EFFECT = EncoderLatency()
