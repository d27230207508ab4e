"""One tyre loses air through the run."""

from drd.effects.effect import (
    SIDE,
    SIDES,
    ActsOn,
    Begins,
    Effect,
    Errors,
    Parameter,
    Values,
    np,
    number,
    of_side,
    on_side,
)
from drd.effects.motion import Motion


class TyreDeflation(Effect):
    """One wheel's radius shrinks steadily during the run, so that the wheel reads more and more."""

    id = "tyre_deflation"
    acts_on = ActsOn.WHEELS
    formula = "reading = travel (1 + total t / end of the run)"
    source = "geometry; a small leak at nearly constant pressure loses air steadily"
    parameters = (SIDE, Parameter("total", "1", "fraction of the radius lost by the end", 1e-4, 0.1, signed=False))
    covariate = "time"
    begins = Begins.GROWING
    manoeuvre = "long straight lines from the beginning to the end of the run"
    lasting = False

    def error(self, m: Motion, p: Values) -> Errors:
        return on_side(p, number(p, "total") * m.time_s / m.end_s * of_side(m, p))

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"side": side} for side in SIDES]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # At once in mid-run; fast at first; slow at first.
        x, speed = m.time_s / m.end_s, of_side(m, p)
        return [on_side(p, share * speed) for share in ((x >= 0.5).astype(float), 1.0 - np.exp(-3.0 * x), x**2)]


EFFECT = TyreDeflation()
