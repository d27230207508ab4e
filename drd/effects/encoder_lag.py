"""The low-pass behind which a drive tells its wheel speeds."""

from drd.effects.effect import ActsOn, Delays, Effect, Errors, Parameter, Values, number
from drd.effects.motion import Motion


class EncoderLag(Effect):
    """The drive low-pass filters the wheel speeds it reports, so that they follow the wheels with a first-order lag."""

    id = "encoder_lag"
    acts_on = ActsOn.TIMING
    formula = "tau dv/dt + v = wheel speed, for each wheel"
    source = "first-order low-pass, as drives smooth the speeds they report; Warthog: README.md of this folder"
    parameters = (
        Parameter("tau", "s", "time constant", 0.005, 0.5, signed=False, linear=False, initial="wheel_lag_s"),
    )
    covariate = "acceleration"
    manoeuvre = "hard starts and stops, turns that begin and end sharply; seldom distinguishable from encoder_latency"
    remainder = 0.3  # of the distance, in starts that take half a second: half the time constant over that time
    searched = False  # beside encoder_latency it splits one delay of a real drive into three

    def error(self, m: Motion, p: Values) -> Errors:
        tau_s = max(number(p, "tau"), 1e-12)
        return Errors(
            left_m_s=m.lagged(m.left_m_s, tau_s) - m.left_m_s,
            right_m_s=m.lagged(m.right_m_s, tau_s) - m.right_m_s,
        )

    def correction(self, m: Motion, p: Values) -> Errors:
        return Errors()  # undoing it exactly needs the speed's derivative, which is mostly noise

    def delays(self, time_s: float, p: Values) -> Delays:
        return Delays(wheels_s=number(p, "tau"))  # of a steady change, all that a lag does

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"tau": tau_s} for tau_s in (0.01, 0.05, 0.1, 0.2, 0.4)]

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        return []  # to a monitor it is a delay

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # A mean over the time before, or a filter of higher order: the same delay, but less of the second derivative.
        lag, (left_m_s, right_m_s) = self.error(m, p), m.wheels_change(number(p, "tau"))
        return [Errors(left_m_s=left_m_s - lag.left_m_s, right_m_s=right_m_s - lag.right_m_s)]


EFFECT = EncoderLag()
