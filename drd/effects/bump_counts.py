"""Rough ground only ever adds travel."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Symptom, Values, both, np, number
from drd.effects.motion import Motion


class BumpCounts(Effect):
    """Stones and cracks make the wheels travel further than the robot; modelled by the mean excess."""

    id = "bump_counts"
    acts_on = ActsOn.WHEELS
    formula = "reading = travel (1 + travel_per_m)"
    source = "Borenstein and Feng, UMBmark (1996): non-systematic errors; geometry of the longer path"
    parameters = (Parameter("travel_per_m", "m/m", "mean excess travel", 1e-5, 0.05, signed=False),)
    covariate = "speed"
    needs_position = "it is the same in both wheels and shows only in the distance"
    manoeuvre = "the same path on rough and on smooth ground"
    lasting = False  # it belongs to the ground

    symptom = Symptom.JUMPED

    def shown(self, side: str = "", begin_s: float = 0.0, end_s: float = 0.0, size: float = 0.0) -> Values:
        return {"travel_per_m": size}

    def error(self, m: Motion, p: Values) -> Errors:
        return both(m, number(p, "travel_per_m"))

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Hard hits at speed; ground that is rougher in one half of the run.
        return [both(m, x) for x in (np.abs(m.speed_m_s), (m.time_s < 0.5 * m.end_s).astype(float))]


EFFECT = BumpCounts()
