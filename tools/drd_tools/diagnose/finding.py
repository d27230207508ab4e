"""One cause as the regression knows it, before it is written down as a `results.Finding`."""

from collections.abc import Sequence
from dataclasses import dataclass

from drd_tools.diagnose.claim import Claim
from drd_tools.diagnose.generic import CHANNELS, Array, Curve
from drd_tools.diagnose.results import NO_GAIN, UNNAMED, Gain, Status, Support, Window


@dataclass(frozen=True)
class Cause:
    """One cause. `claim` is None where it has no name; `curve` is then all that is known of it, and `surrogate` the
    name that comes nearest: the model may have it, since it knows no curves. `fitted` (k,): the claim at the curve's
    knots.
    """

    claim: Claim | None
    status: Status
    also_fits: tuple[str, ...]
    windows: tuple[Window, ...]
    support: Support
    explains: float
    sentence: str
    probability: float
    curve: Curve | None = None
    surrogate: Claim | None = None
    gain: Gain = NO_GAIN
    fitted: Array | None = None

    @property
    def effect(self) -> str:
        """The catalogue's name, or "unknown"."""
        return self.claim.id if self.claim is not None else UNNAMED

    @property
    def gain_nats(self) -> float:
        """Gain in log likelihood."""
        return self.support.gain_nats or 0.0

    @property
    def acts_on(self) -> str:
        """gyro, wheels, body or timing."""
        if self.claim is None:
            assert self.curve is not None
            return CHANNELS[self.curve.channel].acts_on
        acts_on = self.claim.effect.acts_on.value
        return acts_on if acts_on != "readout" else self.claim.effect.channel

    @property
    def driver(self) -> str:
        """What it depends on."""
        if self.claim is not None:
            return self.claim.effect.driver
        assert self.curve is not None
        return self.curve.driver


def named(causes: Sequence[Cause]) -> list[Claim]:
    """The causes that have a name."""
    return [c.claim for c in causes if c.claim is not None]
