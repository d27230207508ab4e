"""The gyro's scale factor depends on the rate."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, largest, np, number
from drd.effects.gyro_scale_error import EFFECT as SCALE_ERROR
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG

MOST_SHARE = 0.15  # of the rate: three times the largest plausible error of a scale as a whole


class GyroScaleNonlinearity(Effect):
    """The gyro's scale factor depends on the rate: fast turns read differently from slow ones."""

    id = "gyro_scale_nonlinearity"
    acts_on = ActsOn.GYRO
    formula = "e = a2 u^2 + a3 u^3, u = w / largest_rate"
    source = "(2); Lefevre, The Fiber-Optic Gyroscope (2014): the sine of the Sagnac phase"
    parameters = (
        Parameter("a2", "deg/s", "even error at the largest rate", 1e-3, 2.0, RAD_PER_DEG),
        Parameter("a3", "deg/s", "odd error at the largest rate", 1e-3, 2.0, RAD_PER_DEG),
        Parameter(
            "largest_rate",
            "deg/s",
            "rate at which a2 and a3 are stated",
            1.0,
            400.0,
            RAD_PER_DEG,
            signed=False,
            linear=False,
            fixed=True,
        ),
    )
    covariate = "yaw_rate"
    manoeuvre = "turns both ways at several rates, from slow to the fastest"
    beside = SCALE_ERROR

    def error(self, m: Motion, p: Values) -> Errors:
        u = m.rate_rad_s / number(p, "largest_rate")
        return Errors(gyro_rad_s=u**2 * (number(p, "a2") + number(p, "a3") * u))

    def is_plausible(self, p: Values) -> bool:
        return abs(number(p, "a2")) + abs(number(p, "a3")) <= MOST_SHARE * number(p, "largest_rate")

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"largest_rate": max(largest(m.rate_rad_s), RAD_PER_DEG)}]

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        # A slow robot's largest: at 60 deg/s it could have 0.2 deg/s at most of the 2 that are plausible at its own.
        return [{"largest_rate": 20.0 * RAD_PER_DEG}]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Optics: the sine's next term; a modulator that is off: a sine of the rate less its straight line, or kinks.
        u = m.rate_rad_s / number(p, "largest_rate")
        wave = np.sin(2.0 * np.pi * u) + 1.5 / np.pi * u
        return [Errors(gyro_rad_s=e) for e in (u**5, wave, u * np.abs(u), u**4)]


EFFECT = GyroScaleNonlinearity()
