"""The gyro's bias jumps once."""

from dataclasses import replace

from drd.effects.effect import START, ActsOn, Effect, Errors, Parameter, Values, np, number, window
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG


class GyroBiasStep(Effect):
    """The gyro's bias jumps once and stays at its new value."""

    id = "gyro_bias_step"
    acts_on = ActsOn.GYRO
    formula = "e = b for t >= t0"
    source = "IEEE Std 952-1997, bias instability"
    parameters = (Parameter("b", "deg/s", "size of the jump", 1e-4, 1.0, RAD_PER_DEG), replace(START, text="its time"))
    covariate = "time"
    manoeuvre = "standstills of a minute from time to time"
    lasting = False
    repeats = True
    recurs = False

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=number(p, "b") * window(m.time_s, number(p, "t0"), float("inf")))

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        begin_s = float(m.time_s[0])
        return [{"t0": begin_s + (m.end_s - begin_s) * k / 40} for k in range(1, 40)]

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{START.name: -np.inf}]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # A jump that takes half a minute, or that fades.
        since_s, after = m.time_s - number(p, "t0"), window(m.time_s, number(p, "t0"), float("inf"))
        fading = np.exp(-np.maximum(since_s, 0.0) / 100.0)
        return [Errors(gyro_rad_s=e) for e in (after * np.minimum(since_s / 30.0, 1.0), after * fading)]


EFFECT = GyroBiasStep()
