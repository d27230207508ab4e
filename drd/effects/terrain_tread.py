"""Effective tread and forward gain in an interval on other ground."""

from drd.effects.effect import (
    END,
    START,
    ActsOn,
    Effect,
    Errors,
    Parameter,
    Values,
    apart,
    both,
    np,
    number,
    since_ever,
    window,
    windows,
)
from drd.effects.motion import Motion


class TerrainTread(Effect):
    """During an interval on different ground, a skid-steer robot's effective tread and forward gain change."""

    id = "terrain_tread"
    acts_on = ActsOn.WHEELS
    formula = "reading = (1 + gain) v -+ (1 + tread) D w / 2 for t0 <= t < t1"
    source = "Mandow et al., IROS 2007: instantaneous centres of rotation for each type of ground"
    parameters = (
        START,
        END,
        Parameter("tread", "1", "relative change of the effective tread", 1e-3, 0.5),
        Parameter("gain", "1", "relative over-reading of the wheels straight ahead", 1e-4, 0.3),
    )
    covariate = "place"
    manoeuvre = "turns on the spot and straight lines on each ground, with a position or heading reference"
    remainder = 0.1  # the samples in which it begins and ends
    lasting = False
    repeats = True
    advice = "Drive over the same ground again, from {from_s:.0f} s on."
    essential = "tread"  # the gain alone is surface_slip, alike on both sides

    def error(self, m: Motion, p: Values) -> Errors:
        inside = window(m.time_s, number(p, "t0"), number(p, "t1"))
        # gain: of the mean of both wheels, which is both less what is apart.
        ahead, across = both(m, number(p, "gain") * inside), apart(m, (number(p, "tread") - number(p, "gain")) * inside)
        return Errors(left_m_s=ahead.left_m_s + across.left_m_s, right_m_s=ahead.right_m_s + across.right_m_s)

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return windows(m, 4, 0.5) + windows(m, 8, 0.5) + windows(m, 16)

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [since_ever()]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Ground that changes within the interval; scrub that grows with the rate; slip that grows with speed.
        t0, t1 = number(p, "t0"), number(p, "t1")
        inside = window(m.time_s, t0, t1)
        along = inside * (m.time_s - t0) / max(t1 - t0, 1e-9)
        return [apart(m, along), apart(m, inside * np.abs(m.rate_rad_s)), both(m, inside * np.abs(m.speed_m_s))]


EFFECT = TerrainTread()
