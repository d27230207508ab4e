"""Comparison of the two headings, and the response where they disagree."""

import math

from drd.estimation.drift import Drift
from drd.estimation.filter import USUAL2, Outcome
from drd.estimation.health import Reasons
from drd.estimation.learning import Drive
from drd.estimation.parted import Parted
from drd.estimation.stuck import STUCK_READINGS
from drd.estimation.track import Track
from drd.estimation.uncertainty import OneSided
from drd.units import NS_PER_S

# Agreement for this long ends the report of a disagreement.
AGREEMENT_NS = 2 * NS_PER_S


class Agreement:
    """Makes measurement (14); consecutive rejections mean slip and release the wheels' heading.

    `counters` are the estimator's. `parted_rad`: sum of the headings' differences, since it was cleared, in
    comparisons beyond three standard deviations.
    """

    def __init__(self, rejections_before_release: int, reasons: Reasons, counters: dict[str, int]):
        self._limit, self._reasons, self._counters = rejections_before_release, reasons, counters
        self._rejections, self._rejected_ns = 0, 0
        self._is_slip, self._slipped_m = False, OneSided()
        self._drift = Drift()
        # Doubt while the gyro repeats its reading, and the gyro's time until which it has done so.
        self._repeats, self._repeats_ns = Parted(), 0
        self.parted_rad = 0.0

    def anew(self, track: Track) -> "Agreement":
        """A new instance for a filter that has restarted; the doubt about a gyro that repeats itself stays."""
        anew = Agreement(self._limit, self._reasons, self._counters)
        anew._repeats, anew._repeats_ns = self._repeats, self._repeats_ns
        anew.pose_was_set(track)
        return anew

    def take_over(self, other: "Agreement") -> None:
        """Continue in another's place, with the same sensors."""
        self._rejections, self._rejected_ns, self.parted_rad = other._rejections, other._rejected_ns, other.parted_rad
        self._is_slip, self._slipped_m, self._drift = other._is_slip, other._slipped_m, other._drift
        self._repeats, self._repeats_ns = other._repeats, other._repeats_ns

    def pose_was_set(self, track: Track) -> None:
        """Forget earlier errors: they are not in the pose."""
        self._slipped_m.forget()
        self._repeats.pose_was_set(track)
        self._drift.pose_was_set(track)

    def update(self, track: Track, t_ns: int, drive: Drive) -> bool:
        """Compare at the end of a gyro sample. False: the filter is not finite and must start again."""
        kf = track.kf
        track.hindsight.watch(kf, t_ns)
        outcome = kf.update(track.rate_rad_s)
        if outcome is Outcome.ACCEPTED and kf.z * kf.z > USUAL2 * kf.S:
            self.parted_rad += abs(kf.z)
        if outcome is Outcome.REJECTED:
            self._counters["rejected"] += 1
            self._rejections = self._rejections + 1 if track.rejected_rad else 1
            self._rejected_ns, track.rejected_rad = t_ns, kf.z
            text = f"wheels and gyro disagree by {math.degrees(kf.z):.2f} deg"
            self._reasons.set("agreement", text, t_ns)
            if self._rejections < self._limit:
                return True
            z_rad = kf.z
            self.parted_rad += abs(z_rad)
            self.slip(track, t_ns, z_rad)
            if kf.stands:
                kf.turn_by_gyro_alone(-z_rad)
            outcome = kf.update(track.rate_rad_s)
            if outcome is Outcome.REJECTED:
                # The heading's variance is at its limit, so nothing was added: continue from the gyro's heading. (35)
                kf.anchor_wheels()
                outcome = kf.update(track.rate_rad_s)
        track.rejected_rad = 0.0
        if outcome is not Outcome.ACCEPTED:
            self._counters["not_finite"] += 1
            return False
        self._counters["accepted"] += 1
        self._cover_repeats(track)
        self._watch_drift(track, t_ns, drive)
        if t_ns - self._rejected_ns > AGREEMENT_NS:
            self._reasons.clear("agreement")
            self._is_slip = False
            self._slipped_m.forget()
        return True

    def slip(self, track: Track, t_ns: int, parted_rad: float) -> None:
        """Widen the wheels' heading by this error, and undo what was learned from it. (18)

        If one wheel slipped, the middle's travel is wrong by half of it, with one sign while the slip lasts.
        """
        kf, slipped_m = track.kf, track.hindsight.slipped_m
        kf.return_variance(*track.hindsight.corrected(kf))
        self._is_slip = True
        self._counters["released"] += 1
        track.take_back(track.hindsight.before, t_ns)
        kf.add_heading_variance(parted_rad * parted_rad)
        kf.add_position_variance(self._slipped_m.growth(slipped_m))

    def gyro_repeats(self, track: Track, times: int, t_ns: int) -> None:
        """Note that the gyro has repeated itself, `times` times by `t_ns`: constants may have to be restored."""
        if times == 1:
            self._repeats.begin(track.hindsight.now(track.kf))
        elif times >= STUCK_READINGS:
            self._repeats_ns = t_ns

    def _cover_repeats(self, track: Track) -> None:
        """Account for a gyro that repeats itself and may be stuck before the wheels show it: the headings may be wrong
        by their difference. (18)
        """
        if track.gyro_ns <= self._repeats_ns:
            self._repeats.cover(track)

    def gyro_is_stuck(self, track: Track) -> None:
        """Undo what was learned since the gyro began to repeat itself: both headings have followed it. (18)"""
        if (then := self._repeats.then) is not None:
            self._cover_repeats(track)
            track.kf.return_variance(*then.corrected(track.kf))
            track.take_back(then, track.t_ns)

    def _watch_drift(self, track: Track, t_ns: int, drive: Drive) -> None:
        drift, seen, text = self._drift, track.hindsight, None
        if not self._is_slip:
            drift.watch(track, t_ns, drive)
            text = drift.text
        elif drift.is_found(track, drive) and (then := seen.before) is not None:
            self.slip(track, t_ns, seen.apart_rad(then))
            text = "wheels and gyro drift apart: a wheel slips, or the gyro is wrong"
        if text is not None:
            self._reasons.set("agreement", text, t_ns)
            self._rejected_ns = t_ns
