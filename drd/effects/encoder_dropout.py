"""One counter stands still while its wheel turns."""

from drd.effects.effect import (
    END,
    SIDE,
    SIDES,
    START,
    ActsOn,
    Effect,
    Errors,
    Symptom,
    Values,
    number,
    of_side,
    on_side,
    substitute,
    window,
    windows,
)
from drd.effects.motion import Motion


class EncoderDropout(Effect):
    """One counter stands still for a while although its wheel turns; that travel is lost."""

    id = "encoder_dropout"
    acts_on = ActsOn.READOUT
    formula = "reading = 0 for t0 <= t < t1"
    source = "definition"
    parameters = (SIDE, START, END)
    covariate = "time"
    manoeuvre = "none: check the cable and the connector"
    irreversible = "the travel was never counted; the gyro and the other wheel replace it"
    remainder = 0.3
    lasting = False
    symptom = Symptom.STOPPED
    searched = False
    recurs = False

    def error(self, m: Motion, p: Values) -> Errors:
        inside = window(m.time_s, number(p, "t0"), number(p, "t1"))
        return on_side(p, -inside * of_side(m, p))

    def correction(self, m: Motion, p: Values) -> Errors:
        inside = window(m.time_s, number(p, "t0"), number(p, "t1"))
        return on_side(p, -inside * substitute(m, p))

    def shown(self, side: str = "", begin_s: float = 0.0, end_s: float = 0.0, size: float = 0.0) -> Values:
        return {SIDE.name: side, START.name: begin_s, END.name: end_s}

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        return [{"side": side, **interval} for side in SIDES for interval in windows(m, 20)]


EFFECT = EncoderDropout()
