"""The gyro's bias depends on where the robot looks."""

from math import pi

from drd.effects.effect import ActsOn, Chance, Effect, Errors, Parameter, Values, between, np, number
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG


class GyroHeadingDependentBias(Effect):
    """The gyro's bias depends on the heading, through the Earth's magnetic field or, on a slope, Earth rotation."""

    id = "gyro_heading_dependent_bias"
    acts_on = ActsOn.GYRO
    formula = "e = b cos(psi - phase)"
    source = "Lefevre, The Fiber-Optic Gyroscope (2014): Faraday effect; Earth rate: geometry"
    parameters = (
        Parameter("b", "deg/s", "amplitude", 1e-4, 0.1, RAD_PER_DEG, signed=False),
        Parameter("phase", "rad", "heading at which the bias is largest", 0.0, 2.0 * pi, signed=False, linear=False),
    )
    covariate = "heading"
    manoeuvre = "long straight lines, or standstills, in many headings"
    lasting = False  # a heading counts from where the run began

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=number(p, "b") * np.cos(m.heading_rad - number(p, "phase")))

    def drawn(self, m: Motion, chance: Chance) -> Values:
        return {**super().drawn(m, chance), "phase": between(0.0, 2.0 * np.pi, chance.phase)}

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        # Two phases a quarter turn apart make any phase together: they are fitted as one.
        return [{"phase": 0.0}]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Soft iron: twice in a turn.
        return [Errors(gyro_rad_s=e) for e in (np.cos(2.0 * m.heading_rad), np.sin(2.0 * m.heading_rad))]


EFFECT = GyroHeadingDependentBias()
