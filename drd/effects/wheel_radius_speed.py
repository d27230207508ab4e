"""Tyres grow with speed."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, both, np, number
from drd.effects.motion import Motion


class WheelRadiusSpeed(Effect):
    """Tyres grow with speed, so that the wheels turn less per metre at high speed than at low speed."""

    id = "wheel_radius_speed"
    acts_on = ActsOn.WHEELS
    formula = "reading = travel (1 - k v^2)"
    source = "the centrifugal load on a tyre is proportional to v^2"
    parameters = (Parameter("k", "(m/s)^-2", "relative growth of the radius per speed squared", 1e-5, 0.02),)
    covariate = "speed"
    needs_position = "it is the same in both wheels and shows only in the distance"
    manoeuvre = "straight lines at several speeds, with a position reference"

    def error(self, m: Motion, p: Values) -> Errors:
        return both(m, -number(p, "k") * m.speed_m_s**2)

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Other powers.
        speed = np.abs(m.speed_m_s)
        return [both(m, x) for x in (speed, speed**3)]


EFFECT = WheelRadiusSpeed()
