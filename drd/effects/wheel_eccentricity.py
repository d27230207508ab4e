"""One wheel is out of round, or its encoder off centre."""

from drd.effects.effect import SIDE, ActsOn, Chance, Effect, Errors, Parameter, Values, between, np, number, on_side
from drd.effects.motion import Motion


class WheelEccentricity(Effect):
    """One wheel is eccentric: it reads too much in one half of each revolution and too little in the other."""

    id = "wheel_eccentricity"
    acts_on = ActsOn.WHEELS
    formula = "reading = travel (1 + e cos(angle + phase)), with the wheel's angle since the start"
    source = "geometry: a wheel whose axle is off centre by e radii"
    parameters = (
        SIDE,
        Parameter("e", "1", "amplitude", 1e-4, 0.05, signed=False),
        Parameter("phase", "rad", "phase of the ripple at the start", 0.0, 6.2832, signed=False, linear=False),
    )
    covariate = "wheel_phase"
    uneven = True
    manoeuvre = "slow straight lines, sampled several times per wheel revolution"
    remainder = 0.1  # the ripple within one sample; at most one radian of the wheel in it
    lasting = False  # a counter that is not absolute starts anywhere

    def error(self, m: Motion, p: Values) -> Errors:
        left = p["side"] == "left"
        angle, speed = (m.left_wheel_rad, m.left_m_s) if left else (m.right_wheel_rad, m.right_m_s)
        return on_side(p, number(p, "e") * np.cos(angle + number(p, "phase")) * speed)

    def drawn(self, m: Motion, chance: Chance) -> Values:
        return {**super().drawn(m, chance), "phase": between(0.0, 2.0 * np.pi, chance.phase)}

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        # Two phases a quarter turn apart make any phase together: they are fitted as one.
        return [{"side": side, "phase": 0.0} for side in ("left", "right")]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # An oval wheel: twice in a turn.
        left = p["side"] == "left"
        angle, speed = (m.left_wheel_rad, m.left_m_s) if left else (m.right_wheel_rad, m.right_m_s)
        return [on_side(p, ripple * speed) for ripple in (np.cos(2.0 * angle), np.sin(2.0 * angle))]


EFFECT = WheelEccentricity()
