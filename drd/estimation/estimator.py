"""Samples in, poses out. No port, no bus, no clock, no logger: live, replay and simulation run this same object."""

from dataclasses import replace

import numpy as np

from drd.config.keys import Config, PublishOn
from drd.effects.compensation import Compensation
from drd.estimation.agreement import Agreement
from drd.estimation.applied import Applied, Constant
from drd.estimation.calibration import Calibration
from drd.estimation.corrections import Corrections
from drd.estimation.estimate import Estimate, forget_gyro, forget_pose, forget_wheels, initial_sigmas, put_into
from drd.estimation.filter import Filter
from drd.estimation.health import Reasons
from drd.estimation.lead import Lead, Place, onward, seen_from
from drd.estimation.learning import Learned, RestNoise, WheelNoise
from drd.estimation.noise import make_noise
from drd.estimation.pose_maker import PoseMaker
from drd.estimation.silence import Silence
from drd.estimation.standstill import BiasMeasurement, BiasState, Standstill
from drd.estimation.state import GYRO_BIAS, Six, X, Y
from drd.estimation.steering import Steering, as_modelled
from drd.estimation.stuck import Stuck
from drd.estimation.timeline import Segment, Stream
from drd.estimation.track import MakeTrack, Track, make_track
from drd.estimation.uncertainty import OneSided
from drd.samples import CalibratedRate, GyroSample, Pose, Validity, WheelSample
from drd.units import NS_PER_S, S_PER_NS

# Ticks further apart mean that the host stood still.
STALL_NS = NS_PER_S // 5


class Estimator:
    """The pose from wheel and gyro samples, with validity and reasons.

    `resolution_m`: wheel travel of one encoder count, which decides what a standstill is. `compensation` takes a
    model's effects off the samples, behind the gyro's calibration. `reasons`: those of the estimator to take over from.
    `new_track` makes the track that the samples go into: one whose filter is watched gives the same poses.
    `publish_on`: the samples that bring a pose, the gyro's at most at the encoders' rate.
    """

    def __init__(
        self,
        config: Config,
        calibration: Calibration | None = None,
        resolution_m: float = 1e-4,
        compensation: Compensation | None = None,
        reasons: Reasons | None = None,
        new_track: MakeTrack = make_track,
        publish_on: PublishOn = "wheels",
    ):
        config = config if compensation is None else as_modelled(config, compensation)
        e = config.estimation
        self._config = config
        self._publish_on = publish_on
        self._has_gyro = config.fog.protocol != "none"
        self.estimates_gyro_scale = e.gyro_scale == "yes" or (e.gyro_scale == "auto" and calibration is None)
        tread_m = config.robot.tread_m
        self.sigmas = initial_sigmas(config, self.estimates_gyro_scale)
        between_s = 1.0 / config.encoders.rate_hz if self._has_gyro else 0.0  # comparisons end between readings
        self.noise = noise = make_noise(e.profile, e.noise, tread_m, resolution_m, between_s)
        self._track, self._preview = new_track(config, self.sigmas, noise), make_track(config, self.sigmas, noise)
        self._preview.kf.noise = self._track.kf.noise  # what is learned of it holds for both
        self._wheels, self._gyro = Stream(), Stream()
        is_learned = e.profile == "physical"  # the printed Q and R are what they are
        self.rest_noise, self.wheel_noise = (
            RestNoise(noise.gyro_rad2_per_s, is_learned),
            WheelNoise(noise, is_learned, is_known=config.robot.drive == "differential"),
        )
        self.steering = Steering(config, self.wheel_noise)
        self.steering.begin(self._track.kf)
        self.wheel_noise.put_into(self._track.kf.noise)
        self.bias = BiasMeasurement(e.static_bias, self.rest_noise)
        self.bias_known = False  # measured, or known from before a restart
        self.standstill = Standstill(resolution_m)
        self.reasons = Reasons() if reasons is None else reasons
        self._silence = Silence(config, self.reasons)
        self._poses = PoseMaker(config, self.reasons)
        self.counters = dict.fromkeys(
            ("poses", "accepted", "rejected", "released", "not_finite", "resets", "late_gyro", "late_wheels",
             "stuck_gyro", "gyro_gaps", "wheel_gaps", "outside_calibration", "outside_model",
             "bias_measured"), 0)  # fmt: skip
        self._corrections = Corrections(calibration, compensation, self._heading_rad, self.reasons, self.counters)
        self.applied = Applied()
        self._unbelieved_rad = OneSided()  # turned by the gyro at rest, before its noise is known
        self._agreement = Agreement(e.rejections_before_release, self.reasons, self.counters)
        self._stuck = Stuck()
        self._reorder_ns = round(e.reorder_s * NS_PER_S)
        # Longer than gap_s: within it a returning counter still tells the whole travel.
        self._wheel_wait_ns = round((config.encoders.gap_s + e.reorder_s) * NS_PER_S)
        self._tick_ns = self._pose_ns = self._gyro_pose_ns = 0
        self._told: Place | None = None  # the last pose, which commands are about
        self._is_stalled = False
        self._pose_period_ns = 0.9 / config.encoders.rate_hz * NS_PER_S
        self._silent_after_ns = config.encoders.silent_after_s * NS_PER_S
        self._wheel_interval_s, self._gyro_interval_s = 1.0 / config.encoders.rate_hz, 1.0 / config.fog.rate_hz
        if not self._has_gyro:
            self.bias.state = BiasState.SKIPPED

    @property
    def filter(self) -> Filter:
        """The filter at the time up to which both sensors are known."""
        return self._track.kf

    # ---- samples -----------------------------------------------------------------------------------------------

    def add_gyro(self, sample: GyroSample) -> Pose | None:
        """Take a gyro sample; a pose where `publish_on` or silent wheels ask for one here."""
        self._silence.begin(sample.t_ns)
        self._gyro_interval_s = sample.interval_s
        rate = self._corrections.gyro(sample, self.bias.active and not self.counters["bias_measured"])
        if self.bias.active:
            self.bias.gyro(rate)
            self._silence.gyro_ns = max(self._silence.gyro_ns, rate.t_ns)
        else:
            self._watch_repeats(sample)
            if self._stuck.found:
                self.counters["stuck_gyro"] += 1
            else:
                self._add_rate(rate)
        self._advance()
        now_ns = sample.t_ns - self._corrections.late_ns
        self._watch(now_ns)
        silent = self._silence.wheels(now_ns)
        # A gyro may be much faster than poses are wanted.
        soon = now_ns - self._gyro_pose_ns < self._pose_period_ns
        if not self._track.t_ns or soon or not (silent or self._publish_on == "gyro"):
            return None
        self._gyro_pose_ns = now_ns
        return self._pose(now_ns if silent else self._silence.wheels_ns)

    def add_wheels(self, sample: WheelSample) -> Pose | None:
        """Take a wheel sample; a pose at its time unless poses are to come with the gyro's samples."""
        self._silence.begin(sample.t_ns)
        still = self.standstill.feed(sample)  # whole counts
        sample = self._corrections.wheels(sample)
        if not self._track.t_ns:
            self._track.t_ns = sample.t_ns - round(sample.interval_s * NS_PER_S)
        if self.bias.active and self._has_gyro:
            self.bias.wheels(sample, still)
            self._bias_progress(sample.t_ns)
        if sample.lost_s > 0.0:
            self.counters["wheel_gaps"] += 1
        left_m_s, right_m_s = sample.left_m / sample.interval_s, sample.right_m / sample.interval_s
        own_m_s = self._corrections.lateral_m_s
        start_ns = max(sample.t_ns - round(sample.interval_s * NS_PER_S), self._wheels.end_ns)
        missed_s = (min(self._track.t_ns, sample.t_ns) - start_ns) * S_PER_NS
        if missed_s > 0.0:
            self._track.catch_up(left_m_s * missed_s, right_m_s * missed_s)
        if not self._wheels.add(sample.t_ns, sample.interval_s, left_m_s, right_m_s, self._track.t_ns, own_m_s):
            self.counters["late_wheels"] += 1
            return None
        self._silence.wheels_ns, self._wheel_interval_s = sample.t_ns, sample.interval_s
        if sample.lost_s > 0.0:  # what was not seen may have been as fast as what came before or after
            self._track.speed_m_s = max(abs(self._track.speed_m_s), 0.5 * abs(left_m_s + right_m_s))
        self._advance()
        # The pose is not older than the last one, nor may its silences be judged by an older time.
        self._watch(max(sample.t_ns, self._pose_ns))
        wanted = self._publish_on == "wheels" or self._silence.gyro(sample.t_ns)
        return self._pose(sample.t_ns) if wanted else None

    def tick(self, now_ns: int) -> Pose | None:
        """Time passes: notice silence, and give a pose when no sensor brings one.

        To be called often, and recorded for a replay: only here a wait for the wheels is given up. A call that comes
        late, since the whole host stood still, does nothing: the samples of that time may wait in its buffers.
        """
        self._silence.begin(now_ns)
        self._is_stalled, self._tick_ns = not self._tick_ns or self.is_stall(now_ns), now_ns
        if self._is_stalled:
            return None
        now_ns -= self._corrections.late_ns
        self._watch(now_ns)
        track, silence = self._track, self._silence
        if track.t_ns < now_ns - self._wheel_wait_ns:  # before that only samples bring something new
            self._advance(now_ns)
        heard_ns = now_ns - self._silent_after_ns
        if silence.wheels_ns > heard_ns or (silence.gyro_ns > heard_ns and track.t_ns):
            return None
        return self._pose(now_ns)

    def is_stall(self, now_ns: int) -> bool:
        """Whether the host stood still since the last tick; unknown, and so not, before the first."""
        return self._tick_ns > 0 and now_ns - self._tick_ns > STALL_NS

    def stalled(self) -> None:
        """The host stood still: until ticks come in time again, nothing that waits in its buffers is given up."""
        self._is_stalled = True

    def _heading_rad(self, t_ns: int) -> float:
        track = self._track
        return track.kf.nominal.heading_rad + track.rate_rad_s * (t_ns - track.t_ns) * S_PER_NS if track.t_ns else 0.0

    def _watch_repeats(self, sample: GyroSample) -> None:
        """What a gyro that is stuck has taught since it repeats itself is taken back. (18)"""
        stuck, agreement, track = self._stuck, self._agreement, self._track
        disagrees = agreement.parted_rad > 0.0 or self.reasons.has("agreement")
        if stuck.take(sample.rate_rad_s, sample.interval_s, disagrees):
            agreement.gyro_is_stuck(track)
        elif stuck.repeats == 0:
            agreement.parted_rad = 0.0
        elif stuck.repeats == 1:
            track.hindsight.mark(track.kf)

    def _add_rate(self, rate: CalibratedRate) -> None:
        last_ns = self._gyro.end_ns
        if not self._gyro.add(rate.t_ns, rate.interval_s, rate.rate_rad_s, rate.sigma_rad_s, self._track.gyro_ns):
            self.counters["late_gyro"] += 1
            return
        self._silence.gyro_ns = rate.t_ns
        gap_s = (rate.t_ns - last_ns) * S_PER_NS if last_ns else 0.0
        self.counters["gyro_gaps"] += gap_s > 1.5 * rate.interval_s
        if gap_s > self._config.fog.silent_after_s:
            # It may have been switched off and on: its bias repeats only so well.
            self._track.kf.add_gyro_bias_variance(self.noise.gyro_bias_restart_rad2_s2)

    # ---- the static bias ---------------------------------------------------------------------------------------

    def _bias_progress(self, t_ns: int) -> None:
        """After each wheel sample of the measurement: report, or hand the result and the gyro to the filter."""
        bias, kf = self.bias, self._track.kf
        if bias.active:
            self._tell_bias(t_ns)
            return
        self.reasons.clear("bias")
        if bias.state is BiasState.DONE:
            kf.set_gyro_bias(-kf.nominal.gyro_scale * bias.bias_rad_s, bias.sigma_rad_s)  # (11), (28)
            self.counters["bias_measured"] += 1
            self.bias_known = True
        elif not self.bias_known:
            text = f"gyro bias not measured: the robot moved after {bias.averaged_s:.1f} s of standstill"
            self.reasons.set("bias", text, t_ns)
        kf.anchor_gyro()
        self._gyro.end_ns = self._track.t_ns
        for rate in bias.take_pending():
            if bias.turned:
                self._turn_meanwhile(rate)
            if rate.t_ns > self._track.t_ns:
                self._add_rate(rate)

    def _turn_meanwhile(self, rate: CalibratedRate) -> None:
        """Somebody turned the robot during the measurement: what the filter has not been told of it."""
        n, unseen_s = self._track.kf.nominal, rate.interval_s - max(rate.t_ns - self._track.t_ns, 0) * S_PER_NS
        turn_rad = (n.gyro_scale * rate.rate_rad_s + n.gyro_bias_rad_s) * max(unseen_s, 0.0)
        n.heading_rad, n.gyro_heading_rad = n.heading_rad + turn_rad, n.gyro_heading_rad + turn_rad

    @property
    def _is_bias_known(self) -> bool:
        return self.bias_known or self.counters["bias_measured"] > 0

    def _tell_bias(self, t_ns: int) -> None:
        severity = Validity.DEGRADED if self._is_bias_known else Validity.INITIALISING
        self.reasons.set("bias", self.bias.state.value, t_ns, severity)

    def calibrate_bias(self) -> str | None:
        """Measure the static bias anew. Returns why not, if the robot is not known to stand or has no gyro."""
        if not self._has_gyro or not self._silence.gyro_ns:
            return "no gyro"
        if not self.standstill.still or self.reasons.has("encoders"):
            return "the encoders do not confirm a standstill"
        n = self._track.kf.nominal
        self._gyro.segments.clear()
        self.bias.restart(-n.gyro_bias_rad_s / n.gyro_scale if self._is_bias_known else None)
        return None

    # ---- time --------------------------------------------------------------------------------------------------

    def _advance(self, now_ns: int = 0) -> None:
        """Step the filter to the newest time up to which both sensors are known, or have had time to report.

        `now_ns`: the wheels have had their time, too, if they are that much older.
        """
        track, again = self._track, self._track.t_ns > 0
        while again and (end_ns := self._known_until_ns(now_ns)) > track.t_ns:
            again = self._run_until(end_ns)

    def _known_until_ns(self, now_ns: int) -> int:
        end_ns, lag_ns = self._silence.wheels_ns, self._track.lag_ns
        if self._has_gyro and not self.bias.active:
            # A sample of the gyro is not late before its interval is over.
            wait_ns = self._reorder_ns + round(self._gyro_interval_s * NS_PER_S)
            wait_ns += self._corrections.further_wait_ns + max(-lag_ns, 0)  # a late gyro
            # Where the lag has grown, the gyro's next sample tells of the time that is seen twice.
            unused = self._gyro.end_ns > self._track.gyro_ns
            both_ns = min(end_ns, self._gyro.end_ns + lag_ns if unused else self._track.t_ns)
            end_ns = both_ns if self._is_stalled else max(both_ns, end_ns - wait_ns)
        return max(end_ns, now_ns - self._wheel_wait_ns)

    def _run_until(self, end_ns: int) -> bool:
        track = self._track
        is_early = track.run(self._wheels, self._gyro, end_ns, self._compare)
        self._wheels.drop_until(track.t_ns)
        self._gyro.drop_until(track.gyro_ns)
        return is_early

    def _compare(self, t_ns: int, wheels: Segment, gyro: Segment) -> None:
        """Where a gyro sample ends: compare the headings; at rest, first learn the noise that weighs them."""
        track, kf = self._track, self._track.kf
        if wheels.a == wheels.b == 0.0:
            self.rest_noise.add(gyro.a, (gyro.end_ns - gyro.start_ns) * S_PER_NS)
            kf.noise.gyro_rad2_per_s = self.rest_noise.variance_rad2_per_s
            if not self.rest_noise.known:
                # Robot and heading stand; if they do not, since the wheels are late or slip, both are wrong by this.
                part_rad = kf.nominal.heading_rad - kf.nominal.gyro_heading_rad
                kf.add_heading_variance(self._unbelieved_rad.growth(part_rad), both=True)
                kf.anchor_gyro()
                return
        else:
            self.rest_noise.interrupt()
            self._unbelieved_rad.forget()
            if track.gyro_heading:
                return
        if not self._agreement.update(track, t_ns, self.steering.drive):
            self._recover(t_ns)
        else:
            # Slip that the gate found is no noise, and must not pass for it.
            self.wheel_noise.take(kf, is_usual=not self.reasons.has("agreement"))
            if not self.steering.watch(kf):
                self._agreement.slip(track, t_ns, 0.0)

    # ---- validity ----------------------------------------------------------------------------------------------

    def _watch(self, now_ns: int) -> None:
        """Turn silence and spread into reasons."""
        self._silence.watch(now_ns)
        if self.bias.is_settled:
            return
        is_told = self.reasons.has("bias")
        if self.bias.active and not is_told:
            self._tell_bias(now_ns)
        elif is_told and self.bias.state is BiasState.SHORT:
            minimum_s = self._config.estimation.static_bias.minimum_s
            if self._track.kf.sigma(GYRO_BIAS) < 2.0 * self.bias.sigma_after_rad_s(minimum_s):
                self.reasons.clear("bias")

    def _pose(self, t_ns: int) -> Pose:
        """The pose at `t_ns`, or at the last one's time where that is newer."""
        t_ns = self._pose_ns = max(t_ns, self._pose_ns)
        preview = self._look_ahead(t_ns)
        if not preview.kf.is_finite():
            self._recover(t_ns)
            preview = self._track
        self.counters["poses"] += 1
        with_gyro = self._has_gyro and not self.bias.active and not self._silence.gyro(t_ns)
        gyro_interval_s = self._gyro_interval_s if with_gyro else None
        lead = self._lead(preview) if with_gyro else self._no_lead()
        self._told = lead.onward(preview.kf)
        return self._poses.make(preview, lead, t_ns, self.counters["poses"], self._wheel_interval_s, gyro_interval_s)

    def _lead(self, track: Track) -> Lead:
        """From the time that the wheels' newest samples are about to the time at which they came. (30)"""
        lag_ns = track.lag_ns
        if lag_ns <= 0:
            return self._no_lead()
        n, lag_s = track.kf.nominal, lag_ns * S_PER_NS
        if self._gyro.segments:
            turn_rad = n.gyro_scale * self._gyro.integral(track.t_ns - lag_ns, track.t_ns) + n.gyro_bias_rad_s * lag_s
        else:  # the newest is used up: as fast as in it
            turn_rad = track.rate_rad_s * lag_s
        return self._no_lead()._replace(lag_s=lag_s, way_m=track.speed_m_s * lag_s, turn_rad=turn_rad)

    def _no_lead(self) -> Lead:
        steering, seen = self.steering, self._track.hindsight
        wander_m2 = steering.wander_m2 + seen.slipped_m**2
        return Lead(0.0, 0.0, 0.0, steering.scale, wander_m2, seen.lag_doubt_s(self._track.kf))

    def _look_ahead(self, t_ns: int) -> Track:
        """The track, or a copy of it that is carried on through the samples that wait for their partner."""
        if self._track.t_ns >= t_ns:
            return self._track
        self._preview.copy_from(self._track)
        if self._track.t_ns:
            self._preview.run(self._wheels, self._gyro, t_ns)
        return self._preview

    # ---- from one estimator to the next ------------------------------------------------------------------------

    def estimate(self) -> Estimate | None:
        """All that is known at the last pose, to go on from; None before the wheels were heard."""
        if not self._silence.wheels_ns:
            return None
        track = self._look_ahead(self._pose_ns)
        P = 0.5 * (track.kf.P + track.kf.P.T)
        P[X, X], P[Y, Y] = P[X, X] + self.steering.wander_m2, P[Y, Y] + self.steering.wander_m2
        is_reset = self.reasons.has("filter")
        if is_reset:
            forget_pose(P)
        return Estimate(
            nominal=replace(track.kf.nominal),
            P=P,
            at_rest=self.at_rest,
            lost=self._silence.was_lost or is_reset,
            speed_m_s=track.speed_m_s,
            rate_rad_s=track.rate_rad_s,
            learned=self.learned,
        )

    @property
    def learned(self) -> Learned:
        """Noise and drive, as far as they were learned."""
        k, rest = self._track.kf.noise, self.rest_noise
        wheels = (k.wheel_m2_per_m, k.turn_rad2_per_rad, k.jitter_s2) if self.wheel_noise.is_known else (0.0, 0.0, 0.0)
        return Learned(self.steering.drive.value, rest.differences, rest.variance_rad2_per_s, *wheels)

    def _recall_wheels(self, learned: Learned) -> None:
        self.steering.recall(learned)
        self.steering.begin(self._track.kf)
        self.wheel_noise.recall(learned)
        self.wheel_noise.put_into(self._track.kf.noise)

    def _recall_gyro(self, learned: Learned) -> None:
        self.rest_noise.recall(learned)
        self._track.kf.noise.gyro_rad2_per_s = self.rest_noise.variance_rad2_per_s

    @property
    def at_rest(self) -> bool:
        """The encoders confirm a standstill."""
        return self.standstill.still and not self._silence.wheels(self._pose_ns)

    def resume(self, estimate: Estimate, bias_known: bool) -> None:
        """Go on with what was known before a restart or a suspension, between two samples."""
        put_into(self._track.kf, estimate)
        self._recall_wheels(estimate.learned)
        self._recall_gyro(estimate.learned)
        self._silence.was_lost = estimate.lost
        self.bias_known = bias_known

    def take_over(self, other: "Estimator", same_wheels: bool, same_gyro: bool, same_model: bool) -> None:
        """Go on in another's place and with its reasons, between two samples; nothing that is on its way is lost.

        What is the same, other than the configuration around it: `same_wheels`, what wheel scales and tread were
        learned with; `same_gyro`, the same of bias and scale; `same_model`, the compensation and where it stands.
        """
        self._track.copy_from(other._track)
        self._track.hindsight = other._track.hindsight
        self._wheels, self._gyro = other._wheels, other._gyro
        self.counters.update(other.counters)
        self._tick_ns, self._pose_ns, self._gyro_pose_ns = other._tick_ns, other._pose_ns, other._gyro_pose_ns
        self._is_stalled, self._told = other._is_stalled, other._told
        silence, before = self._silence, other._silence
        silence.begin(1 if before.gyro(other._tick_ns) else other._tick_ns)
        silence.wheels_ns, silence.gyro_ns, silence.was_lost = before.wheels_ns, before.gyro_ns, before.was_lost
        if same_model:
            self._corrections.take_over(other._corrections)
        if same_wheels and same_gyro:
            self.applied = other.applied
        if same_wheels:
            self.standstill = other.standstill
            self._take_over_wheels(other)
        else:
            forget_wheels(self._track.kf, self._config.robot.tread_m, self.sigmas)
            self._track.kf.add_position_variance(other.steering.wander_m2)
            self.steering.begin(self._track.kf)
        if same_gyro:
            if self.noise == other.noise:
                self.rest_noise = self.bias.rest_noise = other.rest_noise
                self._track.kf.noise.gyro_rad2_per_s = self.rest_noise.variance_rad2_per_s
            else:
                self._recall_gyro(other.learned)
            self.bias_known = other.bias_known
            if not other.bias.active:  # one that is under way begins anew
                mine, done = self.bias, other.bias
                mine.state, mine.averaged_s = done.state, done.averaged_s
                mine.bias_rad_s, mine.sigma_rad_s = done.bias_rad_s, done.sigma_rad_s
        else:
            forget_gyro(self._track.kf, self.sigmas)
            self._gyro.segments.clear()
        self._drop_reasons(same_gyro, same_model)

    def _take_over_wheels(self, other: "Estimator") -> None:
        if self.noise == other.noise and self._config.robot.drive == other._config.robot.drive:
            self.wheel_noise, self.steering = other.wheel_noise, other.steering
            self.wheel_noise.put_into(self._track.kf.noise)
        else:
            self._recall_wheels(other.learned)
            if self.steering.scale < other.steering.scale:  # nothing will tell any more
                self._track.kf.add_scale_variance(other.steering.scale, 0.0)
            self._track.kf.add_position_variance(other.steering.wander_m2)

    def _drop_reasons(self, same_gyro: bool, same_model: bool) -> None:
        """Those that nothing would end any more, or that begin anew."""
        gone = {
            "calibration": not self._corrections.is_calibrated,
            "model": not same_model,
            "bias": not same_gyro or self.bias.state is BiasState.SKIPPED,
            "agreement": self._track.gyro_heading,
        }
        for source in ("fog", "fog.port", "agreement", "bias"):
            gone[source] = gone.get(source, False) or not self._has_gyro
        for source, is_gone in gone.items():
            if is_gone:
                self.reasons.clear(source)

    # ---- commands ----------------------------------------------------------------------------------------------

    def set_pose(self, x_m: float, y_m: float, heading_rad: float, sigma_m: float, sigma_rad: float) -> None:
        """Take a pose from outside with its standard deviations, for now; what was learned of the sensors stays."""
        self._set_pose((x_m, y_m, heading_rad), self._moved(), sigma_m, sigma_rad)

    def _moved(self) -> Place:
        """The way since the last pose, which commands are about: samples may have come that brought none."""
        if self._track.t_ns and self._silence.wheels(self._pose_ns):
            while self._track.t_ns < self._pose_ns:  # nothing to wait for any more
                self._run_until(self._pose_ns)
        if self._told is None or self._track.t_ns <= self._pose_ns:
            return 0.0, 0.0, 0.0
        return seen_from(self._told, self.newest())

    def _set_pose(self, asked: Place, moved: Place, sigma_m: float, sigma_rad: float) -> None:
        kf, self._told = self._track.kf, asked
        # The track lags behind the newest samples: it is set so that they lead it to the pose that was asked for.
        kf.move(self.newest(), onward(asked, moved))
        self.steering.pose_was_set()
        self._track.blind_way.forget()
        self._track.hindsight.begin(kf, self._track.t_ns)
        self._wheels.end_ns = max(self._wheels.end_ns, self._track.t_ns)  # what passed unseen is not caught up with
        # The filter's pose is older: its error has the wheels' way and turn since then, too.
        between = self._covariance_from_now()
        covariance = np.diag([sigma_m**2 + between[0], sigma_m**2 + between[3], sigma_rad**2 + between[5]])
        kf.set_pose(kf.nominal.x_m, kf.nominal.y_m, kf.heading_rad, covariance)
        kf.lead_to_pose(self._track.speed_m_s, self._track.rate_rad_s)
        self._track.unseen_s = self._track.blind_s = self._track.rejected_rad = 0.0
        self._silence.was_lost = False
        for source in ("filter", "position"):
            self.reasons.clear(source)

    def _covariance_from_now(self) -> Six:
        """Covariance of the newest pose as seen from the filter's own, upper triangle."""
        preview, n = self._preview, self._track.kf.nominal
        preview.copy_from(self._track)
        preview.kf.set_pose(n.x_m, n.y_m, self._track.kf.heading_rad, np.zeros((3, 3)))
        if 0 < self._track.t_ns < self._pose_ns:
            preview.run(self._wheels, self._gyro, self._pose_ns)
        return preview.kf.pose_covariance()

    def apply(self, name: str, constant: Constant | None) -> str | None:
        """Take a constant that the monitor has found, or, None, put back what was there; returns why not."""
        return self.applied.change(self._track, self.newest, self._config.robot.tread_m, name, constant)

    def newest(self) -> Place:
        """The newest pose: x and y in m, heading in rad."""
        preview = self._look_ahead(self._pose_ns)
        return self._lead(preview).onward(preview.kf)

    def reset(self) -> None:
        """Back to the origin and the initial uncertainty; the measured bias stays."""
        kf, s = self._track.kf, self.sigmas
        bias, sigma, moved = kf.nominal.gyro_bias_rad_s, kf.sigma(GYRO_BIAS), self._moved()
        self._begin_anew()
        kf.set_gyro_bias(bias, sigma)
        self._set_pose((0.0, 0.0, 0.0), moved, s.position_m, s.heading_rad)

    def _begin_anew(self) -> None:
        self._agreement = self._agreement.anew()
        self._track.kf.restart(self._config.robot.tread_m, self.sigmas)
        self.applied = Applied()
        self.wheel_noise = self.wheel_noise.anew()
        self.steering = Steering(self._config, self.wheel_noise)
        self.steering.begin(self._track.kf)
        self.wheel_noise.put_into(self._track.kf.noise)

    def _recover(self, t_ns: int) -> None:
        """The covariance or the state is not finite: start again where the robot is not known to be."""
        self.counters["resets"] += 1
        self._begin_anew()
        self.reasons.set("filter", "the estimate was not finite and was reset", t_ns, Validity.INVALID)
