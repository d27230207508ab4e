"""Vibration, rectified, shifts the gyro's bias."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, np, number
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG


class GyroVibrationBias(Effect):
    """Vibration shifts the gyro's bias, in proportion to the speed squared."""

    id = "gyro_vibration_bias"
    acts_on = ActsOn.GYRO
    formula = "e = k v^2"
    source = "IEEE Std 952-1997, vibration rectification; vibration grows with speed"
    parameters = (Parameter("k", "deg/s/(m/s)^2", "bias per speed squared", 1e-5, 0.3, RAD_PER_DEG),)
    covariate = "speed"
    manoeuvre = "long straight lines at several speeds"

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=number(p, "k") * m.speed_m_s**2)

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Other powers: damped, or with a resonance at speed.
        speed = np.abs(m.speed_m_s)
        return [Errors(gyro_rad_s=e) for e in (speed, speed**3)]


EFFECT = GyroVibrationBias()
