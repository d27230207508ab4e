"""The gyro does not see small rates."""

from drd.arrays import Array
from drd.effects.effect import ActsOn, Chance, Effect, Errors, Parameter, Symptom, Values, between_logs, np, number
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG


class GyroDeadband(Effect):
    """The gyro has a dead band: it reads zero while the rate, bias included, is below a threshold."""

    id = "gyro_deadband"
    acts_on = ActsOn.READOUT
    formula = "w_g = 0 for |w| < band"
    source = "IEEE Std 528-2001, dead band"
    parameters = (Parameter("band", "deg/s", "threshold", 1e-3, 2.0, RAD_PER_DEG, signed=False, linear=False),)
    covariate = "yaw_rate"
    manoeuvre = "long, very slow turns, both ways"
    irreversible = "all rates below the threshold read zero"
    remainder = 1.0
    symptom = Symptom.MUTED

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=np.where(np.abs(m.rate_rad_s) < number(p, "band"), -m.rate_rad_s, 0.0))

    def shown(self, side: str = "", begin_s: float = 0.0, end_s: float = 0.0, size: float = 0.0) -> Values:
        return {"band": size}

    def hidden(self, rate_rad_s: Array, p: Values) -> Array | None:
        return rate_rad_s[np.abs(rate_rad_s) < number(p, "band")]

    def drawn(self, m: Motion, chance: Chance) -> Values:
        return {"band": between_logs(0.05, 0.5, chance.small) * RAD_PER_DEG}

    def correction(self, m: Motion, p: Values) -> Errors:
        return Errors()

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"band": band_deg_s * RAD_PER_DEG} for band_deg_s in np.geomspace(0.01, 1.0, 14)]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # No sharp edge; a threshold that is lost from larger rates too.
        rate, band = m.rate_rad_s, max(number(p, "band"), 1e-9)
        return [Errors(gyro_rad_s=e) for e in (-rate * np.exp(-((rate / band) ** 2)), -np.clip(rate, -band, band))]


EFFECT = GyroDeadband()
