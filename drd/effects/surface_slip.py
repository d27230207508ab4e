"""An interval on slippery ground."""

from drd.effects.effect import (
    END,
    START,
    ActsOn,
    Effect,
    Errors,
    Parameter,
    Values,
    np,
    number,
    since_ever,
    window,
    windows,
)
from drd.effects.motion import Motion


class SurfaceSlip(Effect):
    """In an interval on slippery ground the wheels turn more than the ground passes."""

    id = "surface_slip"
    acts_on = ActsOn.WHEELS
    formula = "reading = travel (1 + left), travel (1 + right) for t0 <= t < t1"
    source = "definition of longitudinal slip"
    parameters = (
        START,
        END,
        Parameter("left", "1", "slip of the left wheel", 1e-4, 0.5, signed=False),
        Parameter("right", "1", "slip of the right wheel", 1e-4, 0.5, signed=False),
    )
    covariate = "time"
    manoeuvre = "the same ground again, and other ground"
    remainder = 0.1  # the samples in which it begins and ends
    lasting = False
    repeats = True
    advice = "Drive over the same ground again, from {from_s:.0f} s on."

    def error(self, m: Motion, p: Values) -> Errors:
        inside = window(m.time_s, number(p, "t0"), number(p, "t1"))
        return Errors(
            left_m_s=number(p, "left") * inside * m.left_m_s, right_m_s=number(p, "right") * inside * m.right_m_s
        )

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return windows(m, 4, 0.5) + windows(m, 8, 0.5) + windows(m, 16)

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [since_ever()]

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        # Ground that changes within the interval; slip that grows with speed.
        inside, t0, t1 = window(m.time_s, number(p, "t0"), number(p, "t1")), number(p, "t0"), number(p, "t1")
        along = inside * (m.time_s - t0) / max(t1 - t0, 1e-9)
        shares = (along, inside * np.abs(m.speed_m_s))
        return [e for x in shares for e in (Errors(left_m_s=x * m.left_m_s), Errors(right_m_s=x * m.right_m_s))]


EFFECT = SurfaceSlip()
