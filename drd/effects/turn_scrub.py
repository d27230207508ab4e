"""The effective tread grows as the turn tightens."""

from drd.arrays import Array
from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, apart, np, number
from drd.effects.motion import Motion


class TurnScrub(Effect):
    """The tighter a turn, the more the wheels scrub: the effective tread grows from wide turns to turns on the spot."""

    id = "turn_scrub"
    acts_on = ActsOn.WHEELS
    formula = "reading = v -+ (1 + k f) D w / 2, f = c / (1 + c), c = |w / v| in 1/m"
    source = "Wang et al., Sensors 15 (2015) 9681: the tread depends on the path's radius; f: the simplest such form"
    parameters = (Parameter("k", "1", "relative growth of the tread on the spot", 1e-3, 0.5, signed=False),)
    covariate = "curvature"
    manoeuvre = "turns on the spot, tight and wide, both ways"

    def tightness(self, m: Motion) -> Array:
        """0 on a straight line, 1 on the spot."""
        return self._f(m, 1.0)

    @staticmethod
    def _f(m: Motion, radius_m: float) -> Array:
        """One half at a turn of this radius."""
        across = radius_m * np.abs(m.rate_rad_s)
        return across / np.maximum(np.abs(m.speed_m_s) + across, 1e-9)

    def error(self, m: Motion, p: Values) -> Errors:
        return apart(m, number(p, "k") * self.tightness(m))

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Another radius, or other exponents of the curvature.
        f = self.tightness(m)
        return [apart(m, x) for x in (self._f(m, 0.5 * m.tread_m), np.sqrt(f), f**2)]


EFFECT = TurnScrub()
