"""How far wheels and gyro have turned apart since the gyro is in doubt: both headings may be wrong by so much. (18)"""

import math

from drd.estimation.hindsight import Memory
from drd.estimation.track import Track
from drd.estimation.uncertainty import OneSided


class Parted:
    """A doubt of the gyro: `then`, what was known before it, None while there is none."""

    def __init__(self) -> None:
        self.then: Memory | None = None
        self._covered_rad = OneSided()

    def begin(self, then: Memory | None) -> None:
        """From that memory on the gyro is in doubt; None: no more."""
        self.then = then
        self._covered_rad.forget()

    def pose_was_set(self, track: Track) -> None:
        """Forget by how much the headings have parted: it is not in the pose."""
        self._covered_rad.forget()
        if self.then is not None:
            self.then = track.hindsight.from_now(track.kf, self.then)

    def cover(self, track: Track, most_rad: float = math.inf) -> float:
        """Add what they have parted, `most_rad` at most, beyond the most before to the variances of both headings.

        Returns that, rad^2.
        """
        if self.then is None:
            return 0.0
        parted_rad = min(abs(track.hindsight.apart_rad(self.then)), most_rad)
        growth_rad2 = self._covered_rad.growth_to(parted_rad)
        if growth_rad2 > 0.0:
            track.kf.add_heading_variance(growth_rad2, both=True)
        return growth_rad2
