"""The robot turns about a point ahead of or behind its reported centre."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, np, number
from drd.effects.motion import Motion


class RotationCentreOffset(Effect):
    """The reported centre is ahead of the centre of rotation (if negative, behind) and so moves sideways in turns."""

    id = "rotation_centre_offset"
    acts_on = ActsOn.BODY
    formula = "v_y = a w"
    source = "kinematics of a rigid body; Mandow et al., IROS 2007: instantaneous centres of rotation"
    parameters = (Parameter("a", "m", "distance of the reported centre ahead of the centre of rotation", 1e-4, 1.0),)
    covariate = "yaw_rate"
    proportional = True
    needs_position = "no sensor on the robot measures its lateral motion"
    manoeuvre = "turns on the spot, with a position reference; a longitudinal lever arm of the reference looks the same"
    caveat = "A reference mounted that far ahead of its assumed position looks the same."

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(lateral_m_s=number(p, "a") * m.rate_rad_s)

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # A centre that moves with the rate, or lies elsewhere in left turns than in right ones.
        rate = m.rate_rad_s
        return [Errors(lateral_m_s=e) for e in (rate * np.abs(rate), np.abs(rate))]


EFFECT = RotationCentreOffset()
