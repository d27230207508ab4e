"""By what wheels and gyro have turned apart since the gyro may be wrong: so wrong may both headings be. (18)"""

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

    def cover(self, track: Track) -> float:
        """Add what they have parted beyond the most before to the variances of both headings; returns that, rad^2."""
        if self.then is None:
            return 0.0
        growth_rad2 = self._covered_rad.growth_to(track.hindsight.apart_rad(self.then))
        if growth_rad2 > 0.0:
            track.kf.add_heading_variance(growth_rad2, both=True)
        return growth_rad2
