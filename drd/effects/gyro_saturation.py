"""The gyro's output clips."""

from drd.arrays import Array
from drd.effects.effect import ActsOn, Chance, Effect, Errors, Parameter, Symptom, Values, between, largest, np, number
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG


class GyroSaturation(Effect):
    """The gyro saturates: its reading stays at a limit, so that part of each faster turn is lost."""

    id = "gyro_saturation"
    acts_on = ActsOn.READOUT
    formula = "|w_g| <= limit"
    source = "IEEE Std 528-2001, input limits"
    parameters = (
        Parameter("limit", "deg/s", "the largest reading", 5.0, 720.0, RAD_PER_DEG, signed=False, linear=False),
    )
    covariate = "yaw_rate"
    manoeuvre = "the fastest turns"
    irreversible = "all rates beyond the limit read the same"
    remainder = 1.0
    symptom = Symptom.CLIPPED
    searched = False
    needs_wheels = "without wheels nothing tells that the robot turned faster"

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=self.clipped(m.rate_rad_s, p) - m.rate_rad_s)

    def clipped(self, rate_rad_s: Array, p: Values) -> Array:
        limit = number(p, "limit")
        return np.clip(rate_rad_s, -limit, limit)

    def shown(self, side: str = "", begin_s: float = 0.0, end_s: float = 0.0, size: float = 0.0) -> Values:
        return {"limit": size}

    def drawn(self, m: Motion, chance: Chance) -> Values:
        turning = np.abs(m.rate_rad_s[np.abs(m.rate_rad_s) > 0.02])
        return {"limit": float(between(0.6, 0.9, chance.large) * turning.max())}

    def correction(self, m: Motion, p: Values) -> Errors:
        return Errors()

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        top = largest(m.rate_rad_s)
        return [{"limit": share * top} for share in (0.98, 0.95, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4)]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Soft; another limit to the left than to the right.
        rate, limit = m.rate_rad_s, max(number(p, "limit"), 1e-9)
        return [Errors(gyro_rad_s=e) for e in (limit * np.tanh(rate / limit) - rate, -np.maximum(rate - limit, 0.0))]


EFFECT = GyroSaturation()
