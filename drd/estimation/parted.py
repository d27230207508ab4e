"""Difference between the turns of wheels and gyro while the gyro is in doubt: both headings may be off by it. (18)"""

import math

from drd.estimation.hindsight import Memory
from drd.estimation.track import Track
from drd.estimation.uncertainty import OneSided


class Parted:
    """A doubt about the gyro; `then`: what was known before it, None without a doubt."""

    def __init__(self) -> None:
        self.then: Memory | None = None
        self._covered_rad = OneSided()

    def begin(self, then: Memory | None) -> None:
        """Doubt the gyro from that memory on; None: end the doubt."""
        self.then = then
        self._covered_rad.forget()

    def pose_was_set(self, track: Track) -> None:
        """Forget by how much the headings have parted: it is not in the pose."""
        self._covered_rad.forget()
        if self.then is not None:
            self.then = track.hindsight.from_now(track.kf, self.then)

    def cover(self, track: Track, most_rad: float = math.inf) -> float:
        """Widen both headings by their difference, `most_rad` at most, as far as it exceeds the largest one before.

        Returns the variance added, rad^2.
        """
        if self.then is None:
            return 0.0
        parted_rad = min(abs(track.hindsight.apart_rad(self.then)), most_rad)
        growth_rad2 = self._covered_rad.growth_to(parted_rad)
        if growth_rad2 > 0.0:
            track.kf.add_heading_variance(growth_rad2, both=True)
        return growth_rad2
