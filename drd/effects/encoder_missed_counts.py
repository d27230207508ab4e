"""An encoder loses counts above a speed."""

from drd.effects.effect import (
    SIDE,
    SIDES,
    ActsOn,
    Chance,
    Effect,
    Errors,
    Parameter,
    Values,
    between,
    largest,
    np,
    number,
    of_side,
    on_side,
    substitute,
)
from drd.effects.motion import Motion


class EncoderMissedCounts(Effect):
    """One counter loses a share of its counts while its wheel turns faster than it can follow."""

    id = "encoder_missed_counts"
    acts_on = ActsOn.WHEELS
    formula = "reading = travel (1 - fraction) where the wheel is faster than speed"
    source = "limit frequency of a quadrature counter"
    parameters = (
        SIDE,
        Parameter("fraction", "1", "fraction of the counts that is lost", 1e-4, 0.2, signed=False),
        Parameter("speed", "m/s", "wheel speed above which counts are lost", 0.05, 5.0, signed=False, linear=False),
    )
    covariate = "speed"
    manoeuvre = "straight lines at several speeds"
    remainder = 0.2  # near the edge the gyro and the other wheel decide; all may be left of one passed for a moment

    def error(self, m: Motion, p: Values) -> Errors:
        speed = of_side(m, p)
        return on_side(p, np.where(np.abs(speed) > number(p, "speed"), -number(p, "fraction") * speed, 0.0))

    def correction(self, m: Motion, p: Values) -> Errors:
        fast = np.abs(substitute(m, p)) > number(p, "speed")
        return on_side(p, np.where(fast, -number(p, "fraction") * of_side(m, p), 0.0))

    def drawn(self, m: Motion, chance: Chance) -> Values:
        # No speed that is held: a threshold at just that is neither passed nor not.
        speed = np.abs(m.left_m_s)[np.abs(m.left_m_s) > 0.05]
        threshold = between(0.3, 0.9, chance.speed) * (float(speed.max()) if len(speed) else 0.1)
        return {**super().drawn(m, chance), "speed": threshold}

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [
            {"side": side, "speed": largest(of_side(m, {"side": side})) * k / 10}
            for side in SIDES
            for k in range(2, 10)
        ]

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [
            {"side": side, "speed": speed}
            for side in SIDES
            for speed in (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0)
        ]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # More and more above the speed; no sharp edge.
        speed, above = of_side(m, p), number(p, "speed")
        beyond = np.abs(speed) - above
        return [on_side(p, -speed * x) for x in (np.maximum(beyond, 0.0), 0.5 + 0.5 * np.tanh(10.0 * beyond))]


EFFECT = EncoderMissedCounts()
