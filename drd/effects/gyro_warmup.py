"""The gyro's bias decays from power-on."""

from drd.effects.effect import ActsOn, Begins, Chance, Effect, Errors, Parameter, Values, between_logs, np, number
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG


class GyroWarmup(Effect):
    """The gyro's bias settles after power-on, as the gyro warms itself up."""

    id = "gyro_warmup"
    acts_on = ActsOn.GYRO
    formula = "e = b exp(-t / tau), t since power-on"
    source = "first-order self-heating; IEEE Std 528-2001, warm-up time"
    parameters = (
        Parameter("b", "deg/s", "bias at power-on", 1e-4, 1.0, RAD_PER_DEG),
        Parameter("tau", "s", "time constant", 10.0, 3000.0, signed=False, linear=False),
    )
    covariate = "time"
    begins = Begins.POWER_ON
    manoeuvre = "a drive from a cold power-on, at least three time constants long, with standstills"
    advice = "Start at power-on, with the gyro cold."

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=number(p, "b") * np.exp(-m.time_s / number(p, "tau")))

    def drawn(self, m: Motion, chance: Chance) -> Values:
        return {"tau": between_logs(40.0, 400.0, chance.settling)}

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"tau": tau_s} for tau_s in (25.0, 50.0, 100.0, 200.0, 400.0, 800.0)]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Two time constants; a power of time; heat that must come first.
        x = m.time_s / number(p, "tau")
        return [Errors(gyro_rad_s=e) for e in (np.exp(-0.5 * x), np.exp(-2.0 * x), 1.0 / (1.0 + x), x * np.exp(-x))]


EFFECT = GyroWarmup()
