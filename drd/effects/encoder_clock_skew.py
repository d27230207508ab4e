"""The encoders' clock drifts against the gyro's."""

from drd.effects.effect import ActsOn, Begins, Calibrated, Delays, Effect, Errors, Parameter, Values, number
from drd.effects.motion import Motion


class EncoderClockSkew(Effect):
    """The encoders' clock runs slow or fast, so that their time stamps drift away from the gyro's."""

    id = "encoder_clock_skew"
    acts_on = ActsOn.TIMING
    formula = "travel read at t = travel at t (1 + ppm / 10^6)"
    source = "definition of a clock's rate error"
    parameters = (Parameter("ppm", "ppm", "by how much the clock runs slow", 1.0, 2000.0, 1e-6, linear=False),)
    covariate = "time"
    begins = Begins.GROWING
    manoeuvre = "a long drive with hard starts and stops up to its end"

    def error(self, m: Motion, p: Values) -> Errors:
        slow = number(p, "ppm")
        late = m.delay(-slow * m.time_s)
        # Counts are travel: what comes within fewer seconds is faster.
        left_m_s, right_m_s = ((1.0 + slow) * late(speed) - speed for speed in (m.left_m_s, m.right_m_s))
        return Errors(left_m_s=left_m_s, right_m_s=right_m_s)

    def correction(self, m: Motion, p: Values) -> Errors:
        return Errors()  # the stamps are corrected

    def delays(self, time_s: float, p: Values) -> Delays:
        return Delays(wheels_s=-time_s * number(p, "ppm"))

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"ppm": sign * size} for size in (30e-6, 100e-6, 300e-6) for sign in (-1.0, 1.0)]

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"ppm": 1e-6}]

    def calibrated(self, constants: Calibrated) -> Values | None:
        return {"ppm": -constants.lag_growth}

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # A crystal that drifts as it warms: time squared.
        left_m_s, right_m_s = m.wheels_change(-number(p, "ppm") * m.time_s**2 / m.end_s)
        return [Errors(left_m_s=left_m_s, right_m_s=right_m_s)]


EFFECT = EncoderClockSkew()
