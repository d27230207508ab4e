"""Loss of gyro packets while the host was stalled. (18)"""

from typing import Final

from drd.config.keys import Config
from drd.estimation.parted import Parted
from drd.estimation.track import Track
from drd.samples import CalibratedRate
from drd.units import NS_PER_S

BEHIND: Final = 0.5  # of an interval: halfway between jitter without a loss and one lost packet
# A gyro still behind after this was not held up by the stall: its clock is measured again from eight arrivals.
DOUBT_NS: Final = 2 * NS_PER_S


class Stall:
    """Doubt about a gyro without packet numbers after a stall: a loss shows only when its times are behind the wheels'
    or go on after a gap. The lost turn is at most the fastest yaw rate times that.
    """

    def __init__(self, config: Config) -> None:
        self._is_numbered = config.fog.protocol == "dsp17xx"
        self._parted = Parted()
        self._newest_ns = 0  # of the gyro, in the stall
        self._fastest_rad_s = 0.0

    def turns(self, rate_rad_s: float) -> None:
        """Note the robot's yaw rate, by either sensor."""
        if self._parted.then is not None:
            self._fastest_rad_s = max(self._fastest_rad_s, abs(rate_rad_s))

    def gyro(self, track: Track, rate: CalibratedRate, gap_s: float, behind_s: float, is_stalled: bool) -> None:
        """Take a gyro sample, after a gap (0: none), `behind_s` older than the wheels' newest."""
        if self._is_numbered:
            return
        if is_stalled and self._parted.then is None:
            self._parted.begin(track.hindsight.now(track.kf))
            self._fastest_rad_s = abs(track.rate_rad_s)
        self.turns(rate.rate_rad_s)
        if is_stalled:
            self._newest_ns = rate.t_ns
        elif self._parted.then is not None:
            is_behind = behind_s > BEHIND * rate.interval_s
            if gap_s or is_behind:
                self._parted.cover(track, self._fastest_rad_s * max(gap_s, behind_s))
            if (gap_s and not is_behind) or rate.t_ns - self._newest_ns > DOUBT_NS:
                self._parted.begin(None)

    def pose_was_set(self, track: Track) -> None:
        """Forget the difference of the headings: it is not in the pose."""
        self._parted.pose_was_set(track)
