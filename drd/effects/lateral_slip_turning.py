"""The body slides outward in turns."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, np, number
from drd.effects.motion import Motion


class LateralSlipTurning(Effect):
    """The body slides outward in turns, in proportion to its lateral acceleration."""

    id = "lateral_slip_turning"
    acts_on = ActsOn.BODY
    formula = "v_y = -k v w"
    source = "tyre slip angle proportional to lateral force (linear tyre model)"
    parameters = (
        Parameter("k", "s", "lateral speed per lateral acceleration", 1e-4, 0.2, signed=False, initial="slip_s"),
    )
    covariate = "lateral_acceleration"
    needs_position = "no sensor on the robot measures its lateral motion"
    manoeuvre = "a slalom at speed, with a position reference"

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(lateral_m_s=-number(p, "k") * m.speed_m_s * m.rate_rad_s)

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Tyres near their limit; stiffness that falls with speed.
        across = m.speed_m_s * m.rate_rad_s
        return [Errors(lateral_m_s=-across * x) for x in (np.abs(across), np.abs(m.speed_m_s))]


EFFECT = LateralSlipTurning()
