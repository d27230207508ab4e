"""One cause, as the regression represents it and in words, before it becomes a `results.Finding`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from drd.arrays import Array
from drd.effects.effect import ActsOn
from drd_tools.diagnose.results import UNNAMED, Status, Support, Window
from drd_tools.diagnose.select.orders import Ripple
from drd_tools.diagnose.select.splines import CHANNELS, Curve
from drd_tools.diagnose.selected import SCALE, Selected
from drd_tools.diagnose.series import NO_GAIN, Gain


@dataclass(frozen=True)
class Cause:
    """One cause. `selected` is None if it has no name; `curve` or `ripple` then describes it, and `surrogate` is the
    nearest name, which the model may contain in its place, since it has no curves. `rivals`: the names, as fitted, that
    the recording cannot distinguish from it. `fitted` (k,): the effect at the curve's knots.
    """

    selected: Selected | None
    status: Status
    rivals: tuple[Selected, ...]
    windows: tuple[Window, ...]
    support: Support
    explains: float
    sentence: str
    probabilities: dict[str, float]
    curve: Curve | None = None
    ripple: Ripple | None = None
    surrogate: Selected | None = None
    gain: Gain = NO_GAIN
    fitted: Array | None = None

    @property
    def effect(self) -> str:
        """The catalogue's name, or "unknown"."""
        return self.selected.id if self.selected is not None else UNNAMED

    @property
    def also_fits(self) -> tuple[str, ...]:
        """The rivals' names."""
        return tuple(r.id for r in self.rivals)

    @property
    def gain_nats(self) -> float:
        """Gain in log likelihood."""
        return self.support.gain_nats or 0.0

    @property
    def acts_on(self) -> str:
        """Where it acts: gyro, wheels, body or timing."""
        if self.ripple is not None:
            return ActsOn.WHEELS.value
        if self.selected is None:
            assert self.curve is not None
            return CHANNELS[self.curve.channel].acts_on
        acts_on = self.selected.effect.acts_on.value
        return acts_on if acts_on != "readout" else self.selected.effect.channel

    @property
    def covariate(self) -> str:
        """The variable that it depends on."""
        if self.selected is not None:
            return self.selected.effect.covariate
        if self.ripple is not None:
            return f"{self.ripple.side}_wheel_angle"
        assert self.curve is not None
        return self.curve.covariate


def named(causes: Sequence[Cause]) -> list[Selected]:
    """The causes that have a name."""
    return [c.selected for c in causes if c.selected is not None]


def sentence(selected: Selected, explains: float | None, also_fits: Sequence[str]) -> str:
    """A finding in words; `explains`: its share of the mismatch, if known."""
    shown = []
    for q in selected.effect.parameters:
        if q.choices:
            shown.append(f"{q.name} {selected.values[q.name]}")
        elif not (q.fixed or (q.linear and q.name not in selected.free)):
            unit = "" if q.unit == "1" else f" {q.unit}"
            value, sigma = selected.number(q.name) / q.si, selected.sigma(q.name) / q.si
            shown.append(f"{q.name} = {rounded(value, sigma)}{unit}")
    if (beside := selected.beside) is not None:
        (q,) = beside.parameters
        size = rounded(selected.number(SCALE.name) / q.si, selected.sigma(SCALE.name) / q.si)
        shown.append(f"together with {beside.id}, {q.name} = {size}")
    share = ""
    if explains is not None:
        percent = f"{100.0 * explains:.0f}" if explains >= 0.01 else "less than 1"
        share = f"; it explains {percent} % of the mismatch"
    text = f"{selected.effect.sentence} Here {', '.join(shown)}{share}."
    if also_fits:
        text += f" This recording cannot distinguish it from {', '.join(also_fits)}."
    return f"{text} {selected.effect.caveat}".rstrip()


def rounded(value: float, sigma: float) -> str:
    """Format a value and its deviation, with as many digits as that warrants."""
    if sigma <= 0.0:
        return f"{value:.4g}"
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:.{digits}f} +- {sigma:.{digits}f}" if digits < 7 else f"{value:.3g} +- {sigma:.2g}"
