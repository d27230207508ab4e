"""What the diagnosis says of one recording or several: findings, and all that is written down."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

from drd_tools.diagnose.claim import Claim
from drd_tools.diagnose.generic import CHANNELS, Curve

Array = npt.NDArray[np.float64]


class Status(Enum):
    """How sure a finding is."""

    SUSPECTED = "suspected"
    SUPPORTED = "supported"
    CONFIRMED = "confirmed"


@dataclass(frozen=True)
class Finding:
    """One cause. `claim` is None where it has no name; `curve` is then all that is known of it, and `stand_in` the name
    that comes nearest: the model may have it, since it knows no curves.
    """

    claim: Claim | None
    status: Status
    also_fits: tuple[str, ...]
    windows: tuple[tuple[float, float], ...]
    gain_nats: float
    family_wise_p: float
    e_value: float
    explains: float
    sentence: str
    curve: Curve | None = None
    stand_in: Claim | None = None
    evidence: tuple[Array, Array] | None = None
    fit: dict[str, Any] = field(default_factory=dict)

    @property
    def effect(self) -> str:
        """The catalogue's name, or "unknown"."""
        return self.claim.id if self.claim is not None else "unknown"

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
