"""Samples into the track: how far it may advance, where it leads, and poses set from outside."""

import math

import numpy as np

from drd.config.keys import Config
from drd.estimation.corrections import Corrections
from drd.estimation.knowledge import Knowledge
from drd.estimation.lead import Lead, Place, onward, seen_from
from drd.estimation.silence import Silence
from drd.estimation.stall import Stall
from drd.estimation.standstill import BiasMeasurement
from drd.estimation.state import Six
from drd.estimation.timeline import Stream
from drd.estimation.track import Track
from drd.estimation.uncertainty import UNSEEN_ACCELERATION_M_S2, lead_moments, unseen_growth
from drd.samples import CalibratedRate, WheelSample
from drd.units import NS_PER_S, S_PER_NS

MOST_JITTER_NS = NS_PER_S // 1000  # of intervals, which are rounded


class Progress:
    """The samples that the track has not used up yet, and the times that it waits for.

    `preview` becomes a copy of the track, to look ahead. `pose_ns`, `told`: time and place of the last pose, to which
    commands refer. `is_stalled`: no pending sample is given up. `counters` are the estimator's.
    """

    def __init__(
        self,
        config: Config,
        track: Track,
        preview: Track,
        silence: Silence,
        corrections: Corrections,
        bias: BiasMeasurement,
        knowledge: Knowledge,
        counters: dict[str, int],
    ):
        self.track, self._preview = track, preview
        preview.kf.noise = track.kf.noise  # shared, since it is learned
        self._silence, self._corrections, self._bias, self._knowledge = silence, corrections, bias, knowledge
        self._counters = counters
        self._has_gyro = config.fog.protocol != "none"
        self._gyro_silent_after_s = config.fog.silent_after_s
        self.wheels, self.gyro = Stream(), Stream()
        self.wheel_interval_s, self.gyro_interval_s = 1.0 / config.encoders.rate_hz, 1.0 / config.fog.rate_hz
        self._reorder_ns = round(config.estimation.reorder_s * NS_PER_S)
        # Longer than gap_s: within it a returning counter still has the whole travel.
        self._wheel_wait_ns = round((config.encoders.gap_s + config.estimation.reorder_s) * NS_PER_S)
        self.is_stalled, self.pose_ns = False, 0
        self._stall = Stall(config)
        self.told: Place | None = None

    def take_over(self, other: "Progress", same_wheels: bool, same_gyro: bool) -> None:
        """Continue in another's place: no pending sample is lost."""
        self.track.copy_from(other.track)
        self.track.hindsight = other.track.hindsight
        self.wheels, self.gyro = other.wheels, other.gyro
        self.is_stalled, self.pose_ns, self.told = other.is_stalled, other.pose_ns, other.told
        if same_gyro and same_wheels:
            self._stall = other._stall
        if not same_gyro:
            self.gyro.segments.clear()

    # ---- samples -----------------------------------------------------------------------------------------------

    def add_rate(self, rate: CalibratedRate) -> None:
        """Take a gyro sample."""
        last_ns, track = self.gyro.end_ns, self.track
        if not self.gyro.add(rate.t_ns, rate.interval_s, rate.rate_rad_s, rate.sigma_rad_s, track.gyro_ns):
            self._counters["late_gyro"] += 1
            return
        self._silence.gyro_ns = rate.t_ns
        gap_s = (rate.t_ns - last_ns) * S_PER_NS if last_ns else 0.0
        is_gap = gap_s > 1.5 * rate.interval_s
        self._counters["gyro_gaps"] += is_gap
        behind_s = (self._silence.wheels_ns - rate.t_ns) * S_PER_NS
        self._stall.gyro(track, rate, gap_s if is_gap else 0.0, behind_s, self.is_stalled)
        if gap_s > self._gyro_silent_after_s:
            # It may have been switched off and on: its bias repeats only so well.
            track.kf.add_gyro_bias_variance(track.kf.noise.gyro_bias_restart_rad2_s2)

    def add_travel(self, sample: WheelSample) -> bool:
        """Take a wheel sample. False: too late, only its travel counts."""
        track, own_m_s = self.track, self._corrections.lateral_m_s
        left_m_s, right_m_s = sample.left_m / sample.interval_s, sample.right_m / sample.interval_s
        start_ns = max(sample.t_ns - round(sample.interval_s * NS_PER_S), self.wheels.end_ns)
        if sample.lost_m:
            self._go_over_gap(sample)
        if start_ns < (missed_ns := min(track.t_ns, sample.t_ns)):
            track.catch_up(left_m_s, right_m_s, start_ns, missed_ns)
        if not self.wheels.add(sample.t_ns, sample.interval_s, left_m_s, right_m_s, track.t_ns, own_m_s):
            self._counters["late_wheels"] += 1
            return False
        self._silence.wheels_ns, self.wheel_interval_s = sample.t_ns, sample.interval_s
        self._stall.turns((right_m_s - left_m_s) / track.kf.nominal.tread_m)
        if sample.lost_s > 0.0:  # unseen motion may have been as fast as that before or after
            track.speed_m_s = max(abs(track.speed_m_s), 0.5 * abs(left_m_s + right_m_s))
        return True

    def _go_over_gap(self, sample: WheelSample) -> None:
        """Move the pose on by the counters' travel in a gap, along the gyro's heading in the middle of it. (36)

        The variance added for the gap stays: the path is unknown, and a counter may have restarted. Travel beyond
        that variance is not believed, and none if the pose was set meanwhile.
        """
        track, n, begin_ns = self.track, self.track.kf.nominal, sample.t_ns - round(sample.interval_s * NS_PER_S)
        was_set = self.wheels.end_ns > begin_ns - round(sample.lost_s * NS_PER_S) + MOST_JITTER_NS
        speed = min(abs(track.speed_m_s), track.max_speed_m_s)
        allowed_m2 = unseen_growth(0.0, sample.lost_s, speed, UNSEEN_ACCELERATION_M_S2)
        if not self._has_gyro or was_set or track.blind_s or sample.lost_m**2 > allowed_m2:
            return
        middle_rad, way_m = track.kf.heading_rad - 0.5 * track.unseen_turn_rad, sample.lost_m
        if begin_ns > track.t_ns:
            rest_s = (begin_ns - track.t_ns) * S_PER_NS
            turn_rad = n.gyro_scale * self.gyro.integral(track.t_ns, begin_ns) + n.gyro_bias_rad_s * rest_s
            middle_rad += 0.5 * turn_rad
        way_m *= 1.0 - 0.5 * (n.scale_left + n.scale_right)
        n.x_m, n.y_m = n.x_m + way_m * math.cos(middle_rad), n.y_m + way_m * math.sin(middle_rad)

    # ---- time --------------------------------------------------------------------------------------------------

    def advance(self, now_ns: int = 0) -> None:
        """Step the filter to the newest time up to which both sensors are known, or have had time to report.

        `now_ns`: at this time, wheels whose wait is over are given up, too.
        """
        track, again = self.track, self.track.t_ns > 0
        while again and (end_ns := self._known_until_ns(now_ns)) > track.t_ns:
            again = self._run_until(end_ns)

    def give_up_wheels(self, now_ns: int) -> None:
        """Advance without wheels whose wait is over; before that, only samples bring anything new."""
        if self.track.t_ns < now_ns - self._wheel_wait_ns:
            self.advance(now_ns)

    def _known_until_ns(self, now_ns: int) -> int:
        end_ns, lag_ns = self._silence.wheels_ns, self.track.lag_ns
        if self._has_gyro and not self._bias.active:
            # A sample of the gyro is not late before its interval is over.
            wait_ns = self._reorder_ns + round(self.gyro_interval_s * NS_PER_S)
            wait_ns += self._corrections.further_wait_ns + max(-lag_ns, 0)  # a late gyro
            # Where the lag has grown, the gyro's next sample covers the time that is seen twice.
            unused = self.gyro.end_ns > self.track.gyro_ns
            both_ns = min(end_ns, self.gyro.end_ns + lag_ns if unused else self.track.t_ns)
            end_ns = both_ns if self.is_stalled else max(both_ns, end_ns - wait_ns)
        return max(end_ns, now_ns - self._wheel_wait_ns)

    def _run_until(self, end_ns: int) -> bool:
        track = self.track
        is_early = track.run(self.wheels, self.gyro, end_ns, self._knowledge.compare)
        self.wheels.drop_until(track.t_ns)
        self.gyro.drop_until(track.gyro_ns)
        return is_early

    # ---- ahead of the track ------------------------------------------------------------------------------------

    def look_ahead(self, t_ns: int) -> Track:
        """The track, or a copy of it advanced through the samples that wait for the other sensor."""
        if self.track.t_ns >= t_ns:
            return self.track
        self._preview.copy_from(self.track)
        if self.track.t_ns:
            self._preview.run(self.wheels, self.gyro.joined(self.wheels.end_ns - self.track.lag_ns), t_ns)
        return self._preview

    def lead(self, track: Track, with_gyro: bool = True) -> Lead:
        """The step from the time that the wheels' newest samples describe to their arrival. (30)"""
        steering, seen, lag_ns = self._knowledge.steering, self.track.hindsight, track.lag_ns
        (corrected_m2, corrected_rad2), doubt_s2 = seen.corrected(self.track.kf), seen.lag_doubt_s2(self.track.kf)
        wander_m2 = steering.wander_m2 + seen.slipped_m**2 + corrected_m2
        unseen_s = self.wheel_interval_s
        if with_gyro:  # its samples may come in bunches
            unseen_s = max(self.gyro_interval_s, (track.t_ns - self.gyro.end_ns) * S_PER_NS)
        none = Lead(0.0, 0.0, 0.0, steering.scale, wander_m2, doubt_s2, corrected_rad2, unseen_s)
        if lag_ns <= 0:
            return none
        n, lag_s = track.kf.nominal, lag_ns * S_PER_NS
        if with_gyro and self.gyro.segments:
            turn_rad = n.gyro_scale * self.gyro.integral(track.t_ns - lag_ns, track.t_ns) + n.gyro_bias_rad_s * lag_s
        else:  # the newest is used up: its rate is held, or that of the wheels
            turn_rad = track.rate_rad_s * lag_s
        return none._replace(lag_s=lag_s, distance_m=track.speed_m_s * lag_s, turn_rad=turn_rad)

    def newest(self) -> Place:
        """The newest pose."""
        preview = self.look_ahead(self.pose_ns)
        return self.lead(preview).onward(preview.kf)

    def moved(self) -> Place:
        """Travel since the last pose, to which commands refer: later samples may have brought no pose."""
        if self.track.t_ns and self._silence.wheels(self.pose_ns):
            while self.track.t_ns < self.pose_ns:  # nothing to wait for any more
                self._run_until(self.pose_ns)
        if self.told is None or self.track.t_ns <= self.pose_ns:
            return 0.0, 0.0, 0.0
        return seen_from(self.told, self.newest())

    def set_pose(self, asked: Place, moved: Place, sigma_m: float, sigma_rad: float) -> None:
        """Replace the last pose by one from outside; the robot has moved by `moved` since."""
        track, kf, self.told = self.track, self.track.kf, asked
        # The track lags behind the newest samples: it is set so that they lead it to the pose that was asked for.
        kf.move(self.newest(), onward(asked, moved))
        self._knowledge.pose_was_set()
        track.uncertain_heading.forget()
        self._stall.pose_was_set(track)
        self.wheels.end_ns = max(self.wheels.end_ns, track.t_ns)  # no catching up with unseen motion
        # The filter's pose is older: its error includes that of the wheels' travel and turn since then.
        between = self._covariance_from_now()
        covariance = np.diag([sigma_m**2 + between[0], sigma_m**2 + between[3], sigma_rad**2 + between[5]])
        # And that of the lead: a share of the lag's error, and the rest of its mean square. (30)
        lag_s2 = kf.lag_covariance()[3]
        share, lead_s2 = lead_moments(kf.nominal.wheel_lag_s, lag_s2)
        v, heading_rad, w = track.speed_m_s, kf.heading_rad, track.rate_rad_s
        a = np.array([v * math.cos(heading_rad), v * math.sin(heading_rad), w])
        covariance += (lead_s2 - share * share * lag_s2) * np.outer(a, a)
        kf.set_pose(kf.nominal.x_m, kf.nominal.y_m, heading_rad, covariance)
        kf.lead_to_pose(share * v, share * w)
        track.unseen_s = track.blind_s = track.rejected_rad = 0.0

    def _covariance_from_now(self) -> Six:
        """Covariance of the newest pose as seen from the filter's own, upper triangle."""
        preview, n = self._preview, self.track.kf.nominal
        preview.copy_from(self.track)
        preview.kf.set_pose(n.x_m, n.y_m, self.track.kf.heading_rad, np.zeros((3, 3)))
        if 0 < self.track.t_ns < self.pose_ns:
            preview.run(self.wheels, self.gyro, self.pose_ns)
        return preview.kf.pose_covariance()
