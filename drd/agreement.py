"""The comparison of the two headings, and what follows where they disagree."""

import math
from collections import deque

from drd.filter import Outcome
from drd.health import Reasons
from drd.track import Track
from drd.units import NS_PER_S

# Agreement for so long ends the report of a disagreement.
AGREEMENT_NS = 2 * NS_PER_S
# So many comparisons that differ to one side, each within its gate, are no noise: their normalised sum is white.
IN_A_ROW = 20
ONE_SIDED_SIGMAS = 5.0
STILL_ONE_SIDED_SIGMAS = 2.0
# Another ground changes a skid-steer robot's effective tread by 20 to 40 %. What has drifted again within this time was
# no other ground: a second of turning shows the new tread.
GROUND_CHANGE = 0.2
GROUND_NS = 10 * NS_PER_S
DOUBT_NS = 3 * NS_PER_S  # so much longer the report of a first drift stands: a second one would be found meanwhile


class Agreement:
    """Makes measurement (14); rejections in a row are slip, and release the wheels' heading.

    `counters` are the estimator's.
    """

    def __init__(self, rejections_before_release: int, reasons: Reasons, counters: dict[str, int]):
        self._limit, self._reasons, self._counters = rejections_before_release, reasons, counters
        self._rejections, self._rejected_ns = 0, 0
        self._slipped_m = 0.0
        self._ratios, self._turns_rad = deque([0.0] * IN_A_ROW, IN_A_ROW), deque([0.0] * IN_A_ROW, IN_A_ROW)
        self._drifted_rad, self._ground_ns = 0.0, 0

    def update(self, track: Track, t_ns: int, is_known: bool = True) -> bool:
        """Compare at the end of a gyro sample. False: the filter is not finite and must start again.

        `is_known`: how the robot steers, without which a drift of the two headings is nothing unusual.
        """
        kf = track.kf
        outcome = kf.update(track.rate_rad_s)
        if outcome is Outcome.REJECTED:
            self._counters["rejected"] += 1
            self._rejections = self._rejections + 1 if track.rejected_rad else 1
            self._rejected_ns, track.rejected_rad = t_ns, kf.z
            text = f"wheels and gyro disagree by {math.degrees(kf.z):.2f} deg"
            self._reasons.set("agreement", text, t_ns)
            if self._rejections < self._limit:
                return True
            kf.add_heading_variance(kf.z * kf.z)  # slip: the wheels' heading is worth no more than this
            # If it was one wheel, the middle's way is wrong by half of it; while it lasts always to the same side. (16)
            before_m, self._slipped_m = self._slipped_m, self._slipped_m + 0.5 * kf.nominal.tread_m * abs(kf.z)
            kf.add_position_variance(self._slipped_m**2 - before_m**2)
            self._counters["released"] += 1
            outcome = kf.update(track.rate_rad_s)
            if outcome is Outcome.REJECTED:
                # The heading is as unknown as can be, so that nothing was added: the gyro has the better turns. (24)
                kf.anchor_wheels()
                outcome = kf.update(track.rate_rad_s)
        track.rejected_rad = 0.0
        if outcome is not Outcome.ACCEPTED:
            self._counters["not_finite"] += 1
            return False
        self._counters["accepted"] += 1
        if is_known and not self._slipped_m:  # the cause of what follows slip is known
            self._watch_drift(track, t_ns)
        if t_ns - self._rejected_ns > AGREEMENT_NS:
            self._reasons.clear("agreement")
            self._slipped_m = self._drifted_rad = 0.0
        return True

    def _forget_drift(self) -> None:
        for row in (self._ratios, self._turns_rad):
            row.extend([0.0] * IN_A_ROW)

    def _watch_drift(self, track: Track, t_ns: int) -> None:
        """One of the headings drifts away too slowly for the gate. (16)

        First the ground is taken to be another, so that the tread is; where that does not explain it, nobody knows
        which of the headings is wrong, so both may be.
        """
        kf = track.kf
        self._ratios.append(kf.z / math.sqrt(kf.S))
        self._turns_rad.append(kf.z)
        limit = STILL_ONE_SIDED_SIGMAS if self._drifted_rad else ONE_SIDED_SIGMAS
        if abs(sum(self._ratios)) < limit * math.sqrt(IN_A_ROW):
            return
        if not self._ground_ns or t_ns - self._ground_ns > GROUND_NS:
            kf.add_tread_variance((GROUND_CHANGE * kf.nominal.tread_m) ** 2)
            self._ground_ns, self._rejected_ns = t_ns, t_ns + DOUBT_NS
            self._forget_drift()
            self._reasons.set("agreement", "wheels and gyro drift apart: the ground may be another", t_ns)
            return
        before_rad = self._drifted_rad
        self._drifted_rad = before_rad + abs(kf.z) if before_rad else abs(sum(self._turns_rad))
        kf.add_heading_variance(self._drifted_rad**2 - before_rad**2, both=True)
        text = f"wheels and gyro drift apart, by {math.degrees(self._drifted_rad):.1f} deg so far"
        self._reasons.set("agreement", text, t_ns)
        self._rejected_ns = t_ns
