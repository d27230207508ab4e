"""Headings that drift apart too slowly for the gate: a change of ground, a wheel, or the gyro. (18)"""

import math
from collections import deque
from dataclasses import replace
from typing import Final

from drd.estimation.filter import USUAL2, Filter
from drd.estimation.hindsight import Memory
from drd.estimation.learning import Drive
from drd.estimation.parted import Parted
from drd.estimation.state import DD
from drd.estimation.track import Track
from drd.units import NS_PER_S

# Lengths of the sums of normalised innovations, in wheel readings. Noise is white; innovations to one side, each
# within the gate, are not. A short sum detects large errors soon, a long one small errors.
IN_A_ROW: Final = (20, 40, 80, 160)
WHERE_IT_SKIDS: Final = IN_A_ROW[:2]  # slip in turns makes longer sums one-sided
ONE_SIDED_SIGMAS: Final = 5.0  # of such a sum: no false alarm in days, (18)
# Another ground changes a skid-steer robot's effective tread by 20 to 40 %: a second of turning shows it.
GROUND_CHANGE: Final = 0.2
# The doubt ends once the headings have parted no further for this long and the tread is what it was.
GROUND_NS: Final = 10 * NS_PER_S
# For a skid-steer robot the doubt ends a second after a second drift would have been found.
SKID_DOUBT_NS: Final = 5 * NS_PER_S


class Drift:
    """Watches the sums of innovations; `text` names the fault, None while there is none.

    Gyros seldom change, grounds often do: the pose stays the gyro's, and the difference is in its covariance.
    """

    def __init__(self) -> None:
        self.text: str | None = None
        self._begin()
        # The doubt; when the drift was found, when the headings last parted further.
        self._parted = Parted()
        self._found_ns = self._parted_ns = 0

    def _begin(self) -> None:
        self._sums = deque([0.0] * (IN_A_ROW[-1] + 1), IN_A_ROW[-1] + 1)
        # The wheels' reading of the newest comparisons, and the sums of their z and S.
        self._reading_ns, self._z_rad, self._S_rad2 = 0, 0.0, 0.0

    def pose_was_set(self, track: Track) -> None:
        """Forget by how much the headings have parted: it is not in the pose."""
        self._parted.pose_was_set(track)

    def is_found(self, track: Track, drive: Drive) -> bool:
        """Whether innovations are one-sided, after an accepted comparison; if so, the sums start again."""
        sums, kf = self._sums, track.kf
        if track.reading_ns == self._reading_ns:  # a faster gyro sees its error in parts that are not independent
            sums.pop()
        else:
            self._reading_ns, self._z_rad, self._S_rad2 = track.reading_ns, 0.0, 0.0
        self._z_rad, self._S_rad2 = self._z_rad + kf.z, self._S_rad2 + kf.S
        sums.append(sums[-1] + self._z_rad / math.sqrt(self._S_rad2))
        lengths = IN_A_ROW if drive is Drive.DIFFERENTIAL else WHERE_IT_SKIDS
        if all(abs(sums[-1] - sums[-1 - n]) < ONE_SIDED_SIGMAS * math.sqrt(n) for n in lengths):
            return False
        self._begin()
        return True

    def watch(self, track: Track, t_ns: int, drive: Drive) -> None:
        """Look for drift after an accepted comparison, while no slip is known."""
        if self.is_found(track, drive):
            self._suspect_all(track, t_ns)
        if (before := self._parted.then) is not None:
            if drive is Drive.UNKNOWN:  # a tread still being learned is the likeliest cause: its share is no error
                self._parted.then = before = replace(before, tread_m=track.kf.nominal.tread_m)
            self._cover(track, before, t_ns)
            if self._is_over(track.kf, before, t_ns, drive):
                self._parted.begin(None)
                self.text = None

    def _suspect_all(self, track: Track, t_ns: int) -> None:
        """Suspect every cause, since none stands out: the tread is learned again, the pose stays the gyro's."""
        kf = track.kf
        kf.return_variance(*track.hindsight.corrected(kf))
        if self._parted.then is None:
            self._parted.begin(track.hindsight.before)
            self._parted_ns = t_ns
        kf.add_tread_variance((GROUND_CHANGE * kf.nominal.tread_m) ** 2)
        self._found_ns = t_ns

    def _cover(self, track: Track, before: Memory, t_ns: int) -> None:
        """Widen P for a gyro wrong by the headings' difference since, or a middle wrong by half a wheel's slip."""
        if (growth_rad2 := self._parted.cover(track)) > 0.0:
            self._parted_ns = t_ns
            track.kf.add_position_variance((0.5 * before.tread_m) ** 2 * growth_rad2)
        degrees = math.degrees(track.hindsight.apart_rad(before))
        self.text = f"wheels and gyro drift apart, by {degrees:.1f} deg so far: new ground, a wheel, or the gyro"

    def _is_over(self, kf: Filter, before: Memory, t_ns: int, drive: Drive) -> bool:
        if drive is Drive.SKID:
            return t_ns - self._found_ns > SKID_DOUBT_NS
        off_m, variance_m2 = kf.nominal.tread_m - before.tread_m, before.tread_m2 + kf.flat_P[DD]
        return off_m * off_m < USUAL2 * variance_m2 and t_ns - self._parted_ns > GROUND_NS
