"""Headings that drift apart too slowly for the gate: another ground, or one of the sensors. (18)"""

import math
from collections import deque
from typing import Final

from drd.estimation.filter import Filter
from drd.estimation.learning import Drive
from drd.estimation.uncertainty import OneSided
from drd.units import NS_PER_S

# So many comparisons that differ to one side, each within its gate, are no noise: their normalised sum is white.
IN_A_ROW: Final = 20
ONE_SIDED_SIGMAS: Final = 5.0  # of the sum of IN_A_ROW: none by chance in days, (18)
STILL_ONE_SIDED_SIGMAS: Final = 2.0  # below, the drift has ended
# Another ground changes a skid-steer robot's effective tread by 20 to 40 %: a second of turning shows it.
GROUND_CHANGE: Final = 0.2
# Drift that begins again within this time has another cause, and the tread must have come back by then to so near.
GROUND_NS: Final = 10 * NS_PER_S
SAME_TREAD: Final = 0.05
# A skid-steer robot's other ground is no trouble once a second drift would have been found.
SKID_DOUBT_NS: Final = 5 * NS_PER_S


class Drift:
    """Watches the sum of innovations; `text` says what is wrong, None while nothing is."""

    def __init__(self) -> None:
        self.text: str | None = None
        self._ratios, self._turns_rad = deque([0.0] * IN_A_ROW, IN_A_ROW), deque([0.0] * IN_A_ROW, IN_A_ROW)
        self._drifted_rad = OneSided()
        # Since the ground was taken to be another: when, the tread and the heading then, and by how much the heading
        # would be off if it was the gyro.
        self._ground_ns, self._tread_m, self._heading_rad = 0, 0.0, 0.0
        self._gyro_rad = OneSided()

    def is_over(self) -> None:
        """The headings agree again."""
        self._drifted_rad.forget()

    def parted_rad(self, kf: Filter) -> float:
        """After a comparison that was accepted, while wheels slip or nobody knows how the robot steers: by how much the
        headings have drifted apart, 0 where that may be noise.
        """
        if not self._is_one_sided(kf):
            return 0.0
        parted_rad = sum(self._turns_rad)
        self._begin()
        return parted_rad

    def watch(self, kf: Filter, t_ns: int, drive: Drive) -> None:
        """After a comparison that was accepted."""
        self.text = None
        is_one_sided = self._is_one_sided(kf)
        if self._ground_ns:
            self._cover_the_gyro(kf, t_ns, drive)
        if not is_one_sided:
            return
        if not self._ground_ns or t_ns - self._ground_ns > GROUND_NS:
            self._suspect_the_ground(kf, t_ns)
        else:
            self._suspect_both(kf)

    def _is_one_sided(self, kf: Filter) -> bool:
        self._ratios.append(kf.z / math.sqrt(kf.S))
        self._turns_rad.append(kf.z)
        limit = STILL_ONE_SIDED_SIGMAS if self._drifted_rad.sum else ONE_SIDED_SIGMAS
        return abs(sum(self._ratios)) >= limit * math.sqrt(IN_A_ROW)

    def _begin(self) -> None:
        for row in (self._ratios, self._turns_rad):
            row.extend([0.0] * IN_A_ROW)

    def _suspect_the_ground(self, kf: Filter, t_ns: int) -> None:
        tread_m = kf.nominal.tread_m
        kf.add_tread_variance((GROUND_CHANGE * tread_m) ** 2)
        self._ground_ns, self._tread_m, self._heading_rad = t_ns, tread_m, kf.heading_rad
        self._gyro_rad.forget()
        self._cover(kf, sum(self._turns_rad))
        self._begin()
        self.text = "wheels and gyro drift apart: another ground, or the gyro"

    def _cover_the_gyro(self, kf: Filter, t_ns: int, drive: Drive) -> None:
        """While the tread is not what it was, the gyro may be wrong instead: then the heading is, by what both part."""
        part = 1.0 - self._tread_m / kf.nominal.tread_m
        turned_rad, self._heading_rad = kf.heading_rad - self._heading_rad, kf.heading_rad
        age_ns = t_ns - self._ground_ns
        if age_ns > SKID_DOUBT_NS if drive is Drive.SKID else age_ns > GROUND_NS and abs(part) < SAME_TREAD:
            self._ground_ns = 0
            return
        if drive is not Drive.SKID:
            self._cover(kf, turned_rad * part)
        self.text = f"wheels and gyro drift apart: another ground (tread {100.0 * part:+.0f} %), or the gyro"

    def _cover(self, kf: Filter, part_rad: float) -> None:
        """The gyro may be wrong by that, or one wheel by a way that is half of it in the middle."""
        growth_rad2 = self._gyro_rad.growth(part_rad)
        kf.add_heading_variance(growth_rad2, both=True)
        kf.add_position_variance((0.5 * self._tread_m) ** 2 * growth_rad2)

    def _suspect_both(self, kf: Filter) -> None:
        """No other ground: nobody knows which of the headings is wrong, so both may be."""
        d = self._drifted_rad
        kf.add_heading_variance(d.growth(abs(kf.z) if d.sum else abs(sum(self._turns_rad))), both=True)
        self.text = f"wheels and gyro drift apart, by {math.degrees(d.sum):.1f} deg so far"
