"""The effective tread is not the nominal one."""

from drd.effects.effect import ActsOn, Calibrated, Effect, Errors, Parameter, Values, apart, np, number
from drd.effects.motion import Motion


class TreadError(Effect):
    """The effective tread (track width) differs from its nominal value."""

    id = "tread_error"
    acts_on = ActsOn.WHEELS
    formula = "reading = v -+ (1 + k) D w / 2"
    source = "Borenstein and Feng, UMBmark (1996): E_b"
    parameters = (Parameter("k", "1", "relative error of the effective tread", 1e-4, 0.3, initial="tread"),)
    covariate = "yaw_rate"
    proportional = True
    manoeuvre = "turns on the spot, both ways"
    geometry = True

    def error(self, m: Motion, p: Values) -> Errors:
        return apart(m, number(p, "k"))

    def calibrated(self, constants: Calibrated) -> Values | None:
        return {"k": constants.tread - 1.0}

    def relative_tread(self, p: Values) -> float:
        return 1.0 + number(p, "k")

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Tyres that scrub more in fast, in hard, or in left turns.
        speed, rate = np.abs(m.speed_m_s), m.rate_rad_s
        return [apart(m, x) for x in (speed, np.abs(speed * rate), np.sign(rate))]


EFFECT = TreadError()
