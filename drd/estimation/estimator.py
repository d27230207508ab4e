"""Samples in, poses out. No port, no bus, no clock, no logger: live, replay and simulation run this same object."""

from dataclasses import replace

from drd.config.keys import Config, PublishOn
from drd.effects.compensation import Compensation
from drd.estimation.applied import Constant
from drd.estimation.calibration import Calibration
from drd.estimation.corrections import Corrections
from drd.estimation.estimate import Estimate, forget_pose, initial_sigmas
from drd.estimation.filter import Filter
from drd.estimation.health import Reasons
from drd.estimation.knowledge import Knowledge
from drd.estimation.lead import Place
from drd.estimation.noise import make_noise
from drd.estimation.pose_maker import PoseMaker
from drd.estimation.progress import Progress
from drd.estimation.silence import Silence
from drd.estimation.standstill import BiasMeasurement, BiasState, Standstill
from drd.estimation.state import GYRO_BIAS, HEADING_UNKNOWN_RAD2, POSITION_UNKNOWN_M2, X, Y
from drd.estimation.steering import as_modelled
from drd.estimation.stuck import Stuck
from drd.estimation.track import MakeTrack, make_track
from drd.samples import CalibratedRate, GyroSample, Pose, WheelSample
from drd.units import NS_PER_S, S_PER_NS

# Ticks further apart mean that the host was stalled.
STALL_NS = NS_PER_S // 5


class Estimator:
    """The pose from wheel and gyro samples, with validity and reasons.

    `resolution_m`: wheel travel of one encoder count, which defines a standstill. `compensation` removes a model's
    effects from the samples, after the gyro's calibration. `reasons`: those of the estimator to take over from.
    `new_track` makes the track that processes the samples; one with an instrumented filter gives the same poses.
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
        self.sigmas = initial_sigmas(config, self.estimates_gyro_scale)
        between_s = 1.0 / config.encoders.rate_hz if self._has_gyro else 0.0  # comparisons end between readings
        self.noise = make_noise(e.profile, e.noise, config.robot.tread_m, resolution_m, between_s)
        self.reasons = Reasons() if reasons is None else reasons
        self.counters = dict.fromkeys(
            ("poses", "accepted", "rejected", "released", "not_finite", "resets", "late_gyro", "late_wheels",
             "stuck_gyro", "gyro_gaps", "wheel_gaps", "outside_calibration", "outside_model",
             "bias_measured"), 0)  # fmt: skip
        self._track = new_track(config, self.sigmas, self.noise)
        self.knowledge = Knowledge(config, self.sigmas, self.noise, self._track, self.reasons, self.counters)
        self.bias = BiasMeasurement(e.static_bias, self.knowledge.rest_noise)
        if not self._has_gyro:
            self.bias.state = BiasState.SKIPPED
        self.standstill, self._stuck = Standstill(resolution_m), Stuck()
        self._silence = Silence(config, self.reasons)
        heading_rad = self._track.heading_rad
        self._corrections = Corrections(calibration, compensation, heading_rad, self.reasons, self.counters)
        self._progress = Progress(
            config, self._track, make_track(config, self.sigmas, self.noise), self._silence, self._corrections,
            self.bias, self.knowledge, self.counters,
        )  # fmt: skip
        self._poses = PoseMaker(config, self.reasons)
        self._tick_ns = self._gyro_pose_ns = 0
        self._pose_period_ns = 0.9 / config.encoders.rate_hz * NS_PER_S
        self._silent_after_ns = config.encoders.silent_after_s * NS_PER_S

    @property
    def filter(self) -> Filter:
        """The filter at the time up to which both sensors are known."""
        return self._track.kf

    @property
    def at_rest(self) -> bool:
        """Whether the encoders confirm a standstill."""
        return self.standstill.still and not self._silence.wheels(self._progress.pose_ns)

    # ---- samples -----------------------------------------------------------------------------------------------

    def add_gyro(self, sample: GyroSample) -> Pose | None:
        """Take a gyro sample; returns a pose if `publish_on` or silent wheels require one."""
        self._silence.begin(sample.t_ns)
        self._progress.gyro_interval_s = sample.interval_s
        rate = self._corrections.gyro(sample, self.bias.active and not self.counters["bias_measured"])
        if self.bias.active:
            self.bias.gyro(rate)
            self._silence.gyro_ns = max(self._silence.gyro_ns, rate.t_ns)
        else:
            self._watch_repeats(sample)
            if self._stuck.found:
                self.counters["stuck_gyro"] += 1
            else:
                self._progress.add_rate(rate)
        self._progress.advance()
        now_ns = sample.t_ns - self._corrections.late_ns
        self._watch(now_ns)
        silent = self._silence.wheels(now_ns)
        stamp_ns = now_ns if silent else self._silence.wheels_ns
        # A gyro may be much faster than poses are wanted, or than wheels bring new ones.
        soon = now_ns - self._gyro_pose_ns < self._pose_period_ns or stamp_ns <= self._progress.pose_ns
        if not self._track.t_ns or soon or not (silent or self._publish_on == "gyro"):
            return None
        self._gyro_pose_ns = now_ns
        return self._pose(stamp_ns)

    def add_wheels(self, sample: WheelSample) -> Pose | None:
        """Take a wheel sample; returns a pose at its time, unless poses come with the gyro's samples."""
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
        if not self._progress.add_travel(sample):
            return None
        self._progress.advance()
        # The pose is no older than the last one, and silence must not be judged at an older time either.
        self._watch(max(sample.t_ns, self._progress.pose_ns))
        wanted = self._publish_on == "wheels" or self._silence.gyro(sample.t_ns)
        return self._pose(sample.t_ns) if wanted else None

    def tick(self, now_ns: int) -> Pose | None:
        """Let time pass: detect silence, and return a pose when no sensor brings one.

        Call it often, and record it for a replay: only here is waiting for the wheels given up. A call that comes late
        because the host was stalled does nothing: samples of that time may still be in its buffers.
        """
        silence, progress = self._silence, self._progress
        silence.begin(now_ns)
        progress.is_stalled, self._tick_ns = not self._tick_ns or self.is_stall(now_ns), now_ns
        if progress.is_stalled:
            return None
        now_ns -= self._corrections.late_ns
        self._watch(now_ns)
        progress.give_up_wheels(now_ns)
        heard_ns = now_ns - self._silent_after_ns
        if silence.wheels_ns > heard_ns or (silence.gyro_ns > heard_ns and self._track.t_ns):
            return None
        return self._pose(now_ns)

    def is_stall(self, now_ns: int) -> bool:
        """Whether the host has been stalled since the last tick; False before the first one."""
        return self._tick_ns > 0 and now_ns - self._tick_ns > STALL_NS

    def stalled(self) -> None:
        """Note a stall of the host: samples in its buffers are waited for until ticks are on time again."""
        self._progress.is_stalled = True

    def _watch_repeats(self, sample: GyroSample) -> None:
        """Restore the constants if a stuck gyro has changed them since it began to repeat itself. (18)"""
        stuck, agreement, track = self._stuck, self.knowledge.agreement, self._track
        disagrees = agreement.parted_rad > 0.0 or self.reasons.has("agreement")
        is_found = stuck.take(sample.rate_rad_s, sample.interval_s, disagrees)
        if stuck.repeats == 0:
            agreement.parted_rad = 0.0
        elif is_found or not stuck.found:
            agreement.gyro_repeats(track, stuck.repeats, sample.t_ns)
        if is_found:
            agreement.gyro_is_stuck(track)

    def _watch(self, now_ns: int) -> None:
        """Turn silence and an unknown bias into reasons."""
        self._silence.watch(now_ns)
        if not self.bias.is_settled:
            self.bias.watch(self.reasons, self._track.kf.sigma(GYRO_BIAS), now_ns)

    def _pose(self, t_ns: int) -> Pose:
        """The pose at `t_ns`, or at the last one's time where that is newer."""
        progress = self._progress
        t_ns = progress.pose_ns = max(t_ns, progress.pose_ns)
        preview = progress.look_ahead(t_ns)
        if not preview.kf.is_finite():
            self.knowledge.recover(t_ns)
            preview = self._track
        self.counters["poses"] += 1
        with_gyro = self._has_gyro and not self.bias.active and not self._silence.gyro(t_ns)
        lead = progress.lead(preview, with_gyro)
        progress.told = lead.onward(preview.kf)
        gyro_interval_s = progress.gyro_interval_s if with_gyro else None
        return self._poses.make(preview, lead, t_ns, self.counters["poses"], progress.wheel_interval_s, gyro_interval_s)

    # ---- the static bias ---------------------------------------------------------------------------------------

    def calibrate_bias(self) -> str | None:
        """Measure the static bias again. Returns why not, if the robot is not known to stand or has no gyro."""
        if not self._has_gyro or not self._silence.gyro_ns or self._silence.gyro(self._progress.pose_ns):
            return "no gyro"
        if not self.standstill.still or self.reasons.has("encoders"):
            return "the encoders do not confirm a standstill"
        n = self._track.kf.nominal
        self._progress.gyro.segments.clear()
        self.bias.restart(-n.gyro_bias_rad_s / n.gyro_scale if self.bias.is_known else None)
        return None

    def _bias_progress(self, t_ns: int) -> None:
        """Report after each wheel sample; at the end, hand the result and the gyro to the filter."""
        bias, track, progress = self.bias, self._track, self._progress
        bias.tell(self.reasons, t_ns)
        if bias.active:
            return
        if bias.state is BiasState.DONE:
            n = track.kf.nominal
            track.kf.set_gyro_bias(-n.gyro_scale * bias.bias_rad_s, bias.sigma_rad_s)  # (11), (28)
            self.counters["bias_measured"] += 1
        track.kf.anchor_gyro()
        progress.gyro.end_ns = track.t_ns
        for rate in bias.take_pending():
            if bias.turned:
                self._turn_meanwhile(rate)
            if rate.t_ns > track.t_ns:
                progress.add_rate(rate)

    def _turn_meanwhile(self, rate: CalibratedRate) -> None:
        """Add the turn that the filter has not seen, of a robot turned by hand during the measurement."""
        n, unseen_s = self._track.kf.nominal, rate.interval_s - max(rate.t_ns - self._track.t_ns, 0) * S_PER_NS
        turn_rad = (n.gyro_scale * rate.rate_rad_s + n.gyro_bias_rad_s) * max(unseen_s, 0.0)
        n.heading_rad, n.gyro_heading_rad = n.heading_rad + turn_rad, n.gyro_heading_rad + turn_rad

    # ---- from one estimator to the next ------------------------------------------------------------------------

    def estimate(self, in_place: bool = False) -> Estimate | None:
        """The estimate at the last pose, to continue from; None before the first wheel sample. `in_place`: for this
        estimator itself, which still has its pending samples, so the estimate is the one before them.
        """
        if not self._silence.wheels_ns:
            return None
        track, wander_m2 = self._progress.look_ahead(self._progress.pose_ns), self.knowledge.steering.wander_m2
        kf = track.kf
        if in_place:
            kf, wander_m2 = self._track.kf, 0.0
        P = 0.5 * (kf.P + kf.P.T)
        P[X, X], P[Y, Y] = P[X, X] + wander_m2, P[Y, Y] + wander_m2
        is_reset = self.reasons.has("filter")
        if is_reset:
            forget_pose(P)
        return Estimate(
            nominal=replace(kf.nominal),
            P=P,
            at_rest=self.at_rest,
            lost=self._silence.was_lost or is_reset,
            speed_m_s=track.speed_m_s,
            rate_rad_s=track.rate_rad_s,
            learned=self.knowledge.learned,
        )

    def resume(self, estimate: Estimate, bias_known: bool) -> None:
        """Continue with the estimate from before a restart or a suspension, between two samples."""
        self._track.kf.put(estimate.nominal, estimate.P)
        self.knowledge.recall(estimate.learned)
        self._silence.was_lost = estimate.lost
        self.bias.is_known = bias_known

    def take_over(
        self, other: "Estimator", same_wheels: bool, same_gyro: bool, same_lag: bool, same_model: bool
    ) -> None:
        """Continue in another's place and with its reasons, between two samples; no pending sample is lost.

        Unchanged by the new configuration: `same_wheels`, the basis of wheel scales and tread; `same_gyro`, that of
        the gyro's bias and scale; `same_lag`, that of the wheels' lag; `same_model`, the compensation with its state.
        """
        if not (same_wheels and same_gyro):  # constants that the monitor has found hold for the sensors as they were
            for name in list(other.knowledge.applied.taken):
                other.apply(name, None)
        self._progress.take_over(other._progress, same_wheels, same_gyro)
        self.counters.update(other.counters)
        self._tick_ns, self._gyro_pose_ns = other._tick_ns, other._gyro_pose_ns
        self._silence.take_over(other._silence, other._tick_ns)
        if same_model:
            self._corrections.take_over(other._corrections)
        self.knowledge.take_over(other.knowledge, same_wheels, same_gyro, same_lag)
        if same_wheels:
            self.standstill = other.standstill
        if same_gyro:
            self.bias.take_over(other.bias, self.knowledge.rest_noise)
            self._stuck = other._stuck
        self._drop_reasons(same_gyro, same_model)

    def _drop_reasons(self, same_gyro: bool, same_model: bool) -> None:
        """Clear the reasons that nothing would end any more, and those that start again."""
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
        """Set the present pose, with its standard deviations; what was learned about the sensors stays.

        The deviations are limited to those of an unknown pose.
        """
        sigma_m, sigma_rad = min(sigma_m, POSITION_UNKNOWN_M2**0.5), min(sigma_rad, HEADING_UNKNOWN_RAD2**0.5)
        self._set_pose((x_m, y_m, heading_rad), self._progress.moved(), sigma_m, sigma_rad)

    def _set_pose(self, asked: Place, moved: Place, sigma_m: float, sigma_rad: float) -> None:
        self._progress.set_pose(asked, moved, sigma_m, sigma_rad)
        self._silence.was_lost = False
        for source in ("filter", "position"):
            self.reasons.clear(source)

    def reset(self) -> None:
        """Return to the origin and the initial uncertainty; the measured bias stays."""
        kf, s = self._track.kf, self.sigmas
        bias, sigma, moved = kf.nominal.gyro_bias_rad_s, kf.sigma(GYRO_BIAS), self._progress.moved()
        self.knowledge.begin_anew()
        kf.set_gyro_bias(bias, sigma)
        self._set_pose((0.0, 0.0, 0.0), moved, s.position_m, s.heading_rad)

    def apply(self, name: str, constant: Constant | None) -> str | None:
        """Adopt a constant that the monitor has found, or, if None, restore the previous value; returns why not."""
        return self.knowledge.applied.change(self._track, self.newest, self._config.robot.tread_m, name, constant)

    def newest(self) -> Place:
        """The newest pose: x and y in m, heading in rad."""
        return self._progress.newest()
