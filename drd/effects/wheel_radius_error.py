"""The wheels' radii are not the nominal ones."""

from drd.effects.effect import ActsOn, Calibrated, Effect, Errors, Parameter, Values, np, number
from drd.effects.motion import Motion


class WheelRadiusError(Effect):
    """The wheels' effective radii differ from their nominal values: a larger wheel reads too little."""

    id = "wheel_radius_error"
    acts_on = ActsOn.WHEELS
    formula = "reading = travel (1 - left), travel (1 - right)"
    source = "Borenstein and Feng, UMBmark (1996): E_d"
    parameters = (
        Parameter("left", "1", "relative excess of the left radius over nominal", 1e-5, 0.1, initial="wheel_scale"),
        Parameter("right", "1", "relative excess of the right radius over nominal", 1e-5, 0.1, initial="wheel_scale"),
    )
    covariate = "speed"
    proportional = True
    manoeuvre = "long straight lines, with a position reference"
    geometry = True
    opposed = True

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(left_m_s=-number(p, "left") * m.left_m_s, right_m_s=-number(p, "right") * m.right_m_s)

    def calibrated(self, constants: Calibrated) -> Values | None:
        return {"left": 1.0 - 1.0 / constants.left, "right": 1.0 - 1.0 / constants.right}

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Load moves from wheel to wheel with speed and in turns.
        loads = (np.abs(m.speed_m_s), m.rate_rad_s)
        return [e for x in loads for e in (Errors(left_m_s=x * m.left_m_s), Errors(right_m_s=x * m.right_m_s))]


EFFECT = WheelRadiusError()
