"""The gyro's own clock is not what its datasheet says."""

from drd.effects.effect import ActsOn, Begins, Calibrated, Delays, Effect, Errors, Parameter, Values, number
from drd.effects.motion import Motion


class GyroSampleClock(Effect):
    """The gyro's sample rate is not nominal, so that time stamps made by counting samples run ahead or fall behind."""

    id = "gyro_sample_clock"
    acts_on = ActsOn.TIMING
    formula = "w_g(t) = w(t / ratio), t counted at the nominal rate"
    source = "definition of a clock's rate; KVH DSP-3000: 2 to 3 % from unit to unit"
    parameters = (
        Parameter(
            "ratio", "1", "actual sample rate over the nominal one", 0.95, 1.05, signed=False, linear=False, neutral=1.0
        ),
    )
    covariate = "time"
    begins = Begins.GROWING
    manoeuvre = "a long drive with sharp turns, with recorded arrival times"

    def error(self, m: Motion, p: Values) -> Errors:
        older_s = m.time_s * (1.0 - 1.0 / number(p, "ratio"))
        return Errors(gyro_rad_s=m.delayed(m.rate_rad_s, older_s) - m.rate_rad_s)

    def correction(self, m: Motion, p: Values) -> Errors:
        return Errors()  # the stamps are corrected, and with them the time over which a rate counts

    def delays(self, time_s: float, p: Values) -> Delays:
        return Delays(gyro_s=time_s * (1.0 - 1.0 / number(p, "ratio")))

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        sizes = (0.0005, 0.001, 0.002, 0.004, 0.007, 0.01, 0.014, 0.02, 0.025, 0.03, 0.04)
        return [{"ratio": 1.0 + sign * size} for size in sizes for sign in (-1.0, 1.0)]

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"ratio": 1.0 + 1e-6}]

    def calibrated(self, constants: Calibrated) -> Values | None:
        return {"ratio": constants.gyro_clock}

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # A clock that drifts as it warms; stamps from arrival, but increments divided by the nominal interval.
        rate, older_s = m.rate_rad_s, m.time_s * (1.0 - 1.0 / number(p, "ratio"))
        return [Errors(gyro_rad_s=e) for e in (m.delayed(rate, older_s * m.time_s / m.end_s) - rate, rate)]


EFFECT = GyroSampleClock()
