"""Samples in, poses out. No port, no bus, no clock, no logger: live, replay and simulation run this same object."""

import math

import numpy as np

from drd.calibration import Calibration
from drd.config import Config
from drd.effects.compensation import Compensation
from drd.filter import Filter, Outcome, Sigmas
from drd.health import Reasons
from drd.noise import make_noise
from drd.samples import CalibratedRate, GyroSample, Pose, Validity, WheelSample
from drd.silence import Silence
from drd.standstill import BiasMeasurement, BiasState, Standstill
from drd.timeline import Stream
from drd.track import Track
from drd.uncertainty import (
    UNSEEN_ACCELERATION_M_S2,
    UNSEEN_TURN_RAD_S2,
    position_bound_m,
    rate_sigma_rad_s,
    speed_sigma_m_s,
)
from drd.units import NS_PER_S, RAD_PER_DEG, S_PER_NS

# Agreement for so long ends the report of a disagreement.
AGREEMENT_NS = 2 * NS_PER_S
# Ticks further apart mean that the host stood still.
STALL_NS = NS_PER_S // 5
# Standard deviations of the heading at which the pose is degraded, and invalid.
HEADING_DOUBTFUL_RAD = 0.5
HEADING_LOST_RAD = 1.5


class Estimator:
    """The pose from wheel and gyro samples, with validity and reasons.

    `resolution_m`: wheel travel of one encoder count, which decides what a standstill is. `compensation` takes a
    model's effects off the samples, behind the gyro's calibration.
    """

    def __init__(
        self,
        config: Config,
        calibration: Calibration | None = None,
        resolution_m: float = 1e-4,
        compensation: Compensation | None = None,
    ):
        e, i = config.estimation, config.estimation.initial
        self._config, self._calibration, self._compensation = config, calibration, compensation
        self._has_gyro = config.fog.protocol != "none"
        self.estimates_gyro_scale = e.gyro_scale == "yes" or (e.gyro_scale == "auto" and calibration is None)
        tread_m = config.robot.tread_m
        self._sigmas = Sigmas(
            position_m=i.position_m,
            heading_rad=i.heading_deg * RAD_PER_DEG,
            wheel_scale=i.wheel_scale,
            tread_m=i.tread * tread_m,
            gyro_scale=i.gyro_scale if self.estimates_gyro_scale else 0.0,
            gyro_bias_rad_s=i.gyro_bias_deg_s * RAD_PER_DEG,
        )
        self._noise = noise = make_noise(e.profile, e.noise, tread_m, resolution_m)
        self._track, self._preview = (
            Track(
                Filter(tread_m, self._sigmas, noise, e.gate_sigma, e.midpoint),
                config.fog.silent_after_s if self._has_gyro else 0.0,
                config.robot.max_speed_m_s,
                e.heading == "gyro",
            )
            for _ in range(2)
        )
        self._wheels, self._gyro = Stream(), Stream()
        self.bias = BiasMeasurement(e.static_bias, e.noise)
        self.standstill = Standstill(resolution_m)
        self.reasons = Reasons()
        self._silence = Silence(config, self.reasons)
        self.counters = dict.fromkeys(
            ("poses", "accepted", "rejected", "released", "not_finite", "resets", "late_gyro", "late_wheels",
             "gyro_gaps", "wheel_gaps", "outside_calibration", "outside_model",
             "bias_measured"), 0)  # fmt: skip
        self._reorder_ns = self._gyro_wait_ns = round(e.reorder_s * NS_PER_S)
        # What the model takes off the stamps, at most, and when it was last outside the range in which it was seen.
        self._late_ns = self._outside_ns = 0
        # Longer than gap_s: within it a returning counter still tells the whole travel.
        self._wheel_wait_ns = round((config.encoders.gap_s + e.reorder_s) * NS_PER_S)
        self._rejections, self._rejected_ns = 0, 0
        self._tick_ns = self._pose_ns = self._gyro_pose_ns = 0
        self._wheel_interval_s, self._gyro_interval_s = 1.0 / config.encoders.rate_hz, 1.0 / config.fog.rate_hz
        if not self._has_gyro:
            self.bias.state = BiasState.SKIPPED

    @property
    def filter(self) -> Filter:
        """The filter at the time up to which both sensors are known."""
        return self._track.kf

    # ---- samples -----------------------------------------------------------------------------------------------

    def add_gyro(self, sample: GyroSample) -> Pose | None:
        """Take a gyro sample; a pose where the configuration or silent wheels ask for one here."""
        self._silence.begin(sample.t_ns)
        self._gyro_interval_s = sample.interval_s
        rate = self._compensated(self._calibrated(sample), sample.temperature_c)
        if self.bias.active:
            self.bias.gyro(rate)
            self._silence.gyro_ns = max(self._silence.gyro_ns, rate.t_ns)
        else:
            self._add_rate(rate)
        self._advance()
        now_ns = sample.t_ns - self._late_ns
        self._watch(now_ns)
        silent = self._silence.wheels(now_ns)
        # A gyro may be much faster than poses are wanted.
        soon = now_ns - self._gyro_pose_ns < 0.9 / self._config.encoders.rate_hz * NS_PER_S
        if not self._track.t_ns or soon or not (silent or self._config.output.publish_on == "gyro"):
            return None
        self._gyro_pose_ns = now_ns
        return self._pose(now_ns if silent else self._silence.wheels_ns)

    def add_wheels(self, sample: WheelSample) -> Pose | None:
        """Take a wheel sample; a pose at its time unless the configuration publishes on the gyro only."""
        self._silence.begin(sample.t_ns)
        still = self.standstill.feed(sample)  # whole counts
        sample = self._without_effects(sample)
        if not self._track.t_ns:
            self._track.t_ns = sample.t_ns - round(sample.interval_s * NS_PER_S)
        if self.bias.active and self._has_gyro:
            self.bias.wheels(sample, still)
            self._bias_progress(sample.t_ns)
        if sample.lost_s > 0.0:
            self.counters["wheel_gaps"] += 1
        left_m_s, right_m_s = sample.left_m / sample.interval_s, sample.right_m / sample.interval_s
        own_m_s = self._compensation.lateral_m_s if self._compensation is not None else 0.0
        if not self._wheels.add(sample.t_ns, sample.interval_s, left_m_s, right_m_s, self._track.t_ns, own_m_s):
            self.counters["late_wheels"] += 1
            return None
        self._silence.wheels_ns, self._wheel_interval_s = sample.t_ns, sample.interval_s
        if sample.lost_s > 0.0:  # what was not seen may have been as fast as what came before or after
            self._track.speed_m_s = max(abs(self._track.speed_m_s), 0.5 * abs(left_m_s + right_m_s))
        self._advance()
        # The pose is not older than the last one, nor may its silences be judged by an older time.
        self._watch(max(sample.t_ns, self._pose_ns))
        wanted = self._config.output.publish_on == "wheels" or self._silence.gyro(sample.t_ns)
        return self._pose(sample.t_ns) if wanted else None

    def tick(self, now_ns: int) -> Pose | None:
        """Time passes: notice silence, and give a pose when no sensor brings one.

        To be called often, and recorded for a replay: only here a wait for the wheels is given up. A call that comes
        late, since the whole host stood still, does nothing: the samples of that time may wait in its buffers.
        """
        self._silence.begin(now_ns)
        stalled, self._tick_ns = now_ns - self._tick_ns > STALL_NS, now_ns
        if stalled:
            return None
        now_ns -= self._late_ns
        self._watch(now_ns)
        self._advance(now_ns)
        newest_ns = max(self._silence.wheels_ns, self._silence.gyro_ns if self._track.t_ns else 0)
        silent = now_ns - newest_ns >= self._config.encoders.silent_after_s * NS_PER_S
        return self._pose(now_ns) if silent else None

    def _calibrated(self, sample: GyroSample) -> CalibratedRate:
        calibration = self._calibration
        if calibration is None:
            return CalibratedRate(sample.t_ns, sample.interval_s, sample.rate_rad_s, 0.0)
        inside = calibration.is_inside(sample)
        self.counters["outside_calibration"] += not inside
        text = None if inside else "rate or temperature outside the range of the gyro's calibration"
        self.reasons.update("calibration", text, sample.t_ns)
        return calibration.correct(sample)

    def _compensated(self, rate: CalibratedRate, temperature_c: float) -> CalibratedRate:
        """The rate without the model's effects."""
        model = self._compensation
        if model is None:
            return rate
        standing = self.bias.active and not self.counters["bias_measured"]
        found = model.gyro(rate, temperature_c, self._heading_rad(rate.t_ns), standing)
        self._tell_model(model, rate.t_ns)
        return found

    def _without_effects(self, sample: WheelSample) -> WheelSample:
        """The travel without the model's effects."""
        model = self._compensation
        if model is None:
            return sample
        found = model.wheels(sample, self._heading_rad(sample.t_ns))
        self._tell_model(model, sample.t_ns)
        return found

    def _heading_rad(self, t_ns: int) -> float:
        """Of the robot at the middle of a sample that ends now, near enough."""
        track = self._track
        return track.kf.nominal.heading_rad + track.rate_rad_s * (t_ns - track.t_ns) * S_PER_NS if track.t_ns else 0.0

    def _tell_model(self, model: Compensation, t_ns: int) -> None:
        """After each sample: the model's delays into the waits, its range into the health."""
        self._late_ns = max(model.gyro_delay_ns, model.wheel_delay_ns)
        self._gyro_wait_ns = self._reorder_ns + max(0, model.gyro_delay_ns - model.wheel_delay_ns)
        if model.outside:
            self.counters["outside_model"] += 1
            self._outside_ns = t_ns
            self.reasons.set("model", "outside the range in which the model's effects were seen", t_ns)
        elif t_ns - self._outside_ns > AGREEMENT_NS:
            self.reasons.clear("model")

    def _add_rate(self, rate: CalibratedRate) -> None:
        last_ns = self._gyro.end_ns
        if not self._gyro.add(rate.t_ns, rate.interval_s, rate.rate_rad_s, rate.sigma_rad_s, self._track.t_ns):
            self.counters["late_gyro"] += 1
            return
        self._silence.gyro_ns = rate.t_ns
        gap_s = (rate.t_ns - last_ns) * S_PER_NS if last_ns else 0.0
        self.counters["gyro_gaps"] += gap_s > 1.5 * rate.interval_s
        if gap_s > self._config.fog.silent_after_s:
            # It may have been switched off and on: its bias repeats only so well.
            self._track.kf.add_gyro_bias_variance(self._noise.gyro_bias_restart_rad2_s2)

    # ---- the static bias ---------------------------------------------------------------------------------------

    def _bias_progress(self, t_ns: int) -> None:
        """After each wheel sample of the measurement: report, or hand the result and the gyro to the filter."""
        bias, kf = self.bias, self._track.kf
        if bias.active:
            self._tell_bias(t_ns)
            return
        self.reasons.clear("bias")
        if bias.state is BiasState.DONE:
            kf.set_gyro_bias(-kf.nominal.gyro_scale * bias.bias_rad_s, bias.sigma_rad_s)  # (11), (27)
            self.counters["bias_measured"] += 1
        elif not self.counters["bias_measured"]:
            text = f"gyro bias not measured: the robot moved after {bias.averaged_s:.1f} s of standstill"
            self.reasons.set("bias", text, t_ns)
        kf.anchor_gyro()
        self._gyro.end_ns = self._track.t_ns
        for rate in bias.take_pending():
            if rate.t_ns > self._track.t_ns:
                self._add_rate(rate)

    def _tell_bias(self, t_ns: int) -> None:
        severity = Validity.DEGRADED if self.counters["bias_measured"] else Validity.INITIALISING
        self.reasons.set("bias", self.bias.state.value, t_ns, severity)

    def calibrate_bias(self) -> str | None:
        """Measure the static bias anew. Returns why not, if the robot is not known to stand or has no gyro."""
        if not self._has_gyro or not self._silence.gyro_ns:
            return "no gyro"
        if not self.standstill.still or self.reasons.has("encoders"):
            return "the encoders do not confirm a standstill"
        self._gyro.segments.clear()
        self.bias.restart()
        return None

    # ---- time --------------------------------------------------------------------------------------------------

    def _advance(self, now_ns: int = 0) -> None:
        """Step the filter to the newest time up to which both sensors are known, or have had time to report.

        `now_ns`: the wheels have had their time, too, if they are that much older.
        """
        if not self._track.t_ns:
            return
        end_ns = self._silence.wheels_ns
        if self._has_gyro and not self.bias.active:
            end_ns = max(min(end_ns, self._gyro.end_ns), end_ns - self._gyro_wait_ns)
        end_ns = max(end_ns, now_ns - self._wheel_wait_ns)
        compare = None if self._track.gyro_heading else self._update
        self._track.run(self._wheels, self._gyro, end_ns, compare)
        self._wheels.drop_until(self._track.t_ns)
        self._gyro.drop_until(self._track.t_ns)

    def _update(self, t_ns: int) -> None:
        """Measurement (14), and what follows from its outcome."""
        track, kf = self._track, self._track.kf
        outcome = kf.update(track.rate_rad_s)
        if outcome is Outcome.REJECTED:
            self.counters["rejected"] += 1
            self._rejections = self._rejections + 1 if track.rejected_rad else 1
            self._rejected_ns, track.rejected_rad = t_ns, kf.z
            text = f"wheels and gyro disagree by {math.degrees(kf.z):.2f} deg"
            self.reasons.set("agreement", text, t_ns)
            if self._rejections < self._config.estimation.rejections_before_release:
                return
            kf.add_heading_variance(kf.z * kf.z)  # slip: the wheels' heading is worth no more than this
            self.counters["released"] += 1
            outcome = kf.update(track.rate_rad_s)
        track.rejected_rad = 0.0
        if outcome is not Outcome.ACCEPTED:
            self.counters["not_finite"] += 1
            self._recover(t_ns)
            return
        self.counters["accepted"] += 1
        if t_ns - self._rejected_ns > AGREEMENT_NS:
            self.reasons.clear("agreement")

    # ---- validity ----------------------------------------------------------------------------------------------

    def _watch(self, now_ns: int) -> None:
        """Turn silence and spread into reasons."""
        reasons, minimum_s = self.reasons, self._config.estimation.static_bias.minimum_s
        self._silence.watch(now_ns)
        if self.bias.active and not reasons.has("bias"):
            self._tell_bias(now_ns)
        if self.bias.state is BiasState.SHORT and reasons.has("bias"):
            learned = self._track.kf.gyro_bias_sigma_rad_s() < 2.0 * self.bias.sigma_after_rad_s(minimum_s)
            if learned:
                reasons.clear("bias")

    def _pose(self, t_ns: int) -> Pose:
        """The pose at `t_ns`, or at the last one's time where that is newer."""
        t_ns = self._pose_ns = max(t_ns, self._pose_ns)
        preview = self._look_ahead(t_ns)
        if not preview.kf.is_finite():
            self._recover(t_ns)
            preview = self._track
        n = preview.kf.nominal
        xx, xy, xh, yy, yh, hh = preview.kf.pose_covariance()
        covariance = (xx + self._noise.count_m2, xy, xh, yy + self._noise.count_m2, yh, hh)  # (26)
        bound_m = position_bound_m(covariance)
        self._watch_heading(math.sqrt(max(hh, 0.0)), t_ns)
        limit_m = self._config.estimation.max_position_bound_m
        exceeded = limit_m is not None and bound_m > limit_m
        self.reasons.update(
            "bound", "the position bound exceeds its limit" if exceeded else None, t_ns, Validity.INVALID
        )
        self.counters["poses"] += 1
        return Pose(
            t_ns=max(t_ns, preview.t_ns),
            sequence=self.counters["poses"],
            x_m=n.x_m,
            y_m=n.y_m,
            heading_rad=n.heading_rad,
            speed_m_s=preview.speed_m_s,
            rate_rad_s=preview.rate_rad_s,
            speed_sigma_m_s=self._speed_sigma_m_s(preview),
            rate_sigma_rad_s=self._rate_sigma_rad_s(preview, t_ns),
            covariance=covariance,
            position_bound_m=bound_m,
            validity=self.reasons.validity,
            reasons=self.reasons.active(),
        )

    def _watch_heading(self, sigma_rad: float, t_ns: int) -> None:
        """A heading known so badly leaves the linear covariance without a meaning."""
        severity = Validity.INVALID if sigma_rad > HEADING_LOST_RAD else Validity.DEGRADED
        text = "the heading is hardly known" if sigma_rad > HEADING_DOUBTFUL_RAD else None
        self.reasons.update("heading", text, t_ns, severity)

    def _look_ahead(self, t_ns: int) -> Track:
        """The track, or a copy of it that is carried on through the samples that wait for their partner."""
        if self._track.t_ns >= t_ns:
            return self._track
        self._preview.copy_from(self._track)
        if self._track.t_ns:
            self._preview.run(self._wheels, self._gyro, t_ns)
        return self._preview

    def _speed_sigma_m_s(self, track: Track) -> float:
        unseen = UNSEEN_ACCELERATION_M_S2 * track.unseen_s
        return speed_sigma_m_s(track.kf, self._noise, track.speed_m_s, self._wheel_interval_s) + unseen

    def _rate_sigma_rad_s(self, track: Track, t_ns: int) -> float:
        gyro = self._has_gyro and not self.bias.active and not self._silence.gyro(t_ns)
        interval_s = self._gyro_interval_s if gyro else self._wheel_interval_s
        unseen = UNSEEN_TURN_RAD_S2 * track.blind_s
        return rate_sigma_rad_s(track.kf, self._noise, track.rate_rad_s, interval_s, gyro) + unseen

    # ---- commands ----------------------------------------------------------------------------------------------

    def set_pose(self, x_m: float, y_m: float, heading_rad: float, sigma_m: float, sigma_rad: float) -> None:
        """Take a pose from outside with its standard deviations, for now; what was learned of the sensors stays."""
        if self._track.t_ns and self._silence.wheels(self._pose_ns):
            self._track.run(self._wheels, self._gyro, self._pose_ns, self._update)  # nothing to wait for any more
        here, ahead = self._track.kf.nominal, self._look_ahead(self._pose_ns).kf.nominal
        # The track lags behind the newest samples: it is set so that they lead it to the pose that was asked for.
        dx_m, dy_m = ahead.x_m - here.x_m, ahead.y_m - here.y_m
        turned = heading_rad - ahead.heading_rad
        c, s = math.cos(turned), math.sin(turned)
        covariance = np.diag([sigma_m**2, sigma_m**2, sigma_rad**2])
        x_m, y_m = x_m - c * dx_m + s * dy_m, y_m - s * dx_m - c * dy_m
        self._track.kf.set_pose(x_m, y_m, here.heading_rad + turned, covariance)
        self._track.unseen_s = self._track.blind_s = self._track.rejected_rad = 0.0
        self._silence.was_lost = False
        for source in ("filter", "position"):
            self.reasons.clear(source)

    def reset(self) -> None:
        """Back to the origin and the initial uncertainty; the measured bias stays."""
        kf, s = self._track.kf, self._sigmas
        bias, sigma = kf.nominal.gyro_bias_rad_s, kf.gyro_bias_sigma_rad_s()
        kf.restart(self._config.robot.tread_m, s)
        kf.set_gyro_bias(bias, sigma)
        self.set_pose(0.0, 0.0, 0.0, s.position_m, s.heading_rad)

    def _recover(self, t_ns: int) -> None:
        """The covariance or the state is not finite: start again where the robot is not known to be."""
        self.counters["resets"] += 1
        self._track.kf.restart(self._config.robot.tread_m, self._sigmas)
        self.reasons.set("filter", "the estimate was not finite and was reset", t_ns, Validity.INVALID)
