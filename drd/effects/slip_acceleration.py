"""The wheels slip with the drive force."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, both, np, number
from drd.effects.motion import Motion


class SlipAcceleration(Effect):
    """Driven wheels turn more than the ground passes while the robot speeds up, and less while it brakes."""

    id = "slip_acceleration"
    acts_on = ActsOn.WHEELS
    formula = "reading = travel + k a |travel|"
    source = "slip proportional to drive force (linear tyre model)"
    parameters = (Parameter("k", "s^2/m", "slip per acceleration", 1e-4, 0.2, signed=False),)
    covariate = "acceleration"
    needs_position = "it is the same in both wheels and shows only in the distance"
    manoeuvre = "hard starts and soft stops, with a position reference: it cancels over a complete start and stop"

    def error(self, m: Motion, p: Values) -> Errors:
        slip = number(p, "k") * m.acceleration_m_s2
        return Errors(left_m_s=slip * np.abs(m.left_m_s), right_m_s=slip * np.abs(m.right_m_s))

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Other slip in braking than in speeding up; slip that grows faster than force.
        forward = np.sign(m.speed_m_s)
        slip = np.abs(m.acceleration_m_s2)
        return [both(m, x) for x in (slip, forward * m.acceleration_m_s2 * slip)]


EFFECT = SlipAcceleration()
