"""Samples in, poses out. No port, no bus, no clock, no logger: live, replay and simulation run this same object."""

import math
from dataclasses import dataclass

import numpy as np

from drd.calibration import Calibration
from drd.config import Config
from drd.filter import Filter, Outcome, Sigmas
from drd.health import Reasons
from drd.noise import make_noise
from drd.samples import CalibratedRate, GyroSample, Pose, Validity, WheelSample
from drd.standstill import BiasMeasurement, BiasState, Standstill
from drd.timeline import Piece, Stream, pieces
from drd.uncertainty import (
    UNSEEN_ACCELERATION_M_S2,
    UNSEEN_TURN_RAD_S2,
    position_bound_m,
    rate_sigma_rad_s,
    speed_sigma_m_s,
    unseen_growth,
)
from drd.units import NS_PER_S, RAD_PER_DEG, S_PER_NS

# Agreement for so long ends the report of a disagreement.
AGREEMENT_NS = 2 * NS_PER_S


@dataclass(slots=True)
class Track:
    """A filter with the time it has reached and for how long the robot's motion has not been seen."""

    kf: Filter
    t_ns: int = 0
    unseen_s: float = 0.0
    blind_s: float = 0.0  # neither wheels nor gyro


class Estimator:
    """The pose from wheel and gyro samples, with validity and reasons.

    `resolution_m`: wheel travel of one encoder count, which decides what a standstill is.
    """

    def __init__(self, config: Config, calibration: Calibration | None = None, resolution_m: float = 1e-4):
        e, i = config.estimation, config.estimation.initial
        self._config, self._calibration = config, calibration
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
        self._noise = noise = make_noise(e.profile, e.noise, tread_m)
        self._track, self._preview = (
            Track(Filter(tread_m, self._sigmas, noise, e.gate_sigma, e.midpoint)) for _ in range(2)
        )
        self._wheels, self._gyro = Stream(), Stream()
        self._has_gyro = config.fog.protocol != "none"
        self.bias = BiasMeasurement(e.static_bias, e.noise)
        self.standstill = Standstill(resolution_m)
        self.reasons = Reasons()
        self.counters = dict.fromkeys(
            ("poses", "accepted", "rejected", "released", "not_finite", "resets", "late_gyro", "late_wheels",
             "gyro_gaps", "wheel_gaps", "outside_calibration", "bias_measured"), 0)  # fmt: skip
        self._gyro_wait_ns = round(e.reorder_s * NS_PER_S)
        # Longer than gap_s: within it a returning counter still tells the whole travel.
        self._wheel_wait_ns = round((config.encoders.gap_s + e.reorder_s) * NS_PER_S)
        self._rejections, self._rejected_ns = 0, 0
        self._last_gyro_ns = self._last_wheel_ns = self._first_ns = 0
        self._speed_m_s = self._rate_rad_s = 0.0
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
        self._first_ns = self._first_ns or sample.t_ns
        self._last_gyro_ns, self._gyro_interval_s = max(self._last_gyro_ns, sample.t_ns), sample.interval_s
        rate = self._calibrated(sample)
        if self.bias.active:
            self.bias.gyro(rate)
        else:
            self._add_rate(rate)
        self._advance()
        self._watch(sample.t_ns)
        if self._wheels_silent(sample.t_ns):
            return self._pose(sample.t_ns) if self._track.t_ns else None
        return self._pose(self._last_wheel_ns) if self._config.output.publish_on != "wheels" else None

    def add_wheels(self, sample: WheelSample) -> Pose | None:
        """Take a wheel sample; a pose at its time unless the configuration publishes on the gyro only."""
        self._first_ns = self._first_ns or sample.t_ns
        if not self._track.t_ns:
            self._track.t_ns = sample.t_ns - round(sample.interval_s * NS_PER_S)
        still = self.standstill.feed(sample)
        if self.bias.active and self._has_gyro:
            self.bias.wheels(sample.t_ns, still)
            self._bias_progress(sample.t_ns)
        if sample.lost_s > 0.0:
            self.counters["wheel_gaps"] += 1
        left_m_s, right_m_s = sample.left_m / sample.interval_s, sample.right_m / sample.interval_s
        if not self._wheels.add(sample.t_ns, sample.interval_s, left_m_s, right_m_s, self._track.t_ns):
            self.counters["late_wheels"] += 1
            return None
        self._last_wheel_ns, self._wheel_interval_s = sample.t_ns, sample.interval_s
        self._speed_m_s = 0.5 * (left_m_s + right_m_s)
        self._advance()
        self._watch(sample.t_ns)
        return self._pose(sample.t_ns) if self._config.output.publish_on != "gyro" else None

    def tick(self, now_ns: int) -> Pose | None:
        """Time passes: notice silence, and give a pose when no sensor brings one."""
        self._first_ns = self._first_ns or now_ns
        self._watch(now_ns)
        newest_ns = max(self._last_wheel_ns, self._last_gyro_ns if self._track.t_ns else 0)
        if now_ns - newest_ns < self._config.encoders.silent_after_s * NS_PER_S:
            return None
        self._advance(now_ns)
        return self._pose(now_ns)

    def _calibrated(self, sample: GyroSample) -> CalibratedRate:
        calibration = self._calibration
        if calibration is None:
            return CalibratedRate(sample.t_ns, sample.interval_s, sample.rate_rad_s, 0.0)
        inside = calibration.is_inside(sample)
        self.counters["outside_calibration"] += not inside
        text = None if inside else "rate or temperature outside the range of the gyro's calibration"
        self.reasons.update("calibration", text, sample.t_ns)
        return calibration.correct(sample)

    def _add_rate(self, rate: CalibratedRate) -> None:
        gap = self._gyro.end_ns and rate.t_ns - self._gyro.end_ns > 1.5 * rate.interval_s * NS_PER_S
        self.counters["gyro_gaps"] += bool(gap)
        if not self._gyro.add(rate.t_ns, rate.interval_s, rate.rate_rad_s, rate.sigma_rad_s, self._track.t_ns):
            self.counters["late_gyro"] += 1

    # ---- the static bias ---------------------------------------------------------------------------------------

    def _bias_progress(self, t_ns: int) -> None:
        """After each wheel sample of the measurement: report, or hand the result and the gyro to the filter."""
        bias, kf = self.bias, self._track.kf
        if bias.active:
            severity = Validity.DEGRADED if self.counters["bias_measured"] else Validity.INITIALISING
            self.reasons.set("bias", bias.state.value, t_ns, severity)
            return
        self.reasons.clear("bias")
        if bias.state is BiasState.DONE:
            kf.set_gyro_bias(-kf.nominal.gyro_scale * bias.bias_rad_s, bias.sigma_rad_s)  # (11), (27)
            self.counters["bias_measured"] += 1
        elif not self.counters["bias_measured"]:
            text = f"gyro bias not measured: the robot moved after {bias.averaged_s:.1f} s of standstill"
            self.reasons.set("bias", text, t_ns)
        kf.anchor_gyro()
        for rate in bias.take_pending():
            if rate.t_ns > self._track.t_ns:
                self._add_rate(rate)

    def calibrate_bias(self) -> str | None:
        """Measure the static bias anew. Returns why not, if the robot is not known to stand or has no gyro."""
        if not self._has_gyro or not self._last_gyro_ns:
            return "no gyro"
        if not self.standstill.still or self.reasons.has("encoders"):
            return "the encoders do not confirm a standstill"
        self._gyro.segments.clear()
        self.bias.restart()
        return None

    # ---- time --------------------------------------------------------------------------------------------------

    def _advance(self, now_ns: int = 0) -> None:
        """Step the filter to the newest time up to which both sensors are known, or have had time to report."""
        wheel_ns = self._last_wheel_ns
        if not self._track.t_ns:
            return
        if self._has_gyro and not self.bias.active:
            gyro_ns = self._gyro.end_ns
            newest_ns = max(wheel_ns, gyro_ns, now_ns)
            end_ns = max(min(wheel_ns, gyro_ns), wheel_ns - self._gyro_wait_ns)
        else:
            newest_ns = end_ns = max(wheel_ns, now_ns)
            end_ns = wheel_ns
        end_ns = max(end_ns, newest_ns - self._wheel_wait_ns)
        self._run(self._track, end_ns)
        self._wheels.drop_until(self._track.t_ns)
        self._gyro.drop_until(self._track.t_ns)

    def _run(self, track: Track, end_ns: int) -> None:
        for piece in pieces(self._wheels, self._gyro, track.t_ns, end_ns):
            self._step(track, piece)
            track.t_ns = piece.end_ns

    def _step(self, track: Track, piece: Piece) -> None:
        """One filter step over a piece of time; the update comes where a gyro sample ends."""
        kf, wheels, gyro = track.kf, piece.wheels, piece.gyro
        dt_s = (piece.end_ns - piece.start_ns) * S_PER_NS
        left_m, right_m = (wheels.a * dt_s, wheels.b * dt_s) if wheels else (0.0, 0.0)
        rate, sigma = (gyro.a, gyro.b) if gyro else (None, 0.0)
        kf.predict(dt_s, left_m, right_m, rate, sigma)
        if rate is not None:
            self._rate_rad_s = kf.nominal.gyro_scale * rate + kf.nominal.gyro_bias_rad_s
        if wheels:
            track.unseen_s = track.blind_s = 0.0
            if not gyro:
                kf.anchor_gyro()  # (24)
                if self._gyro_silent(piece.end_ns):
                    self._rate_rad_s = (right_m - left_m) / kf.nominal.tread_m / dt_s
            elif piece.end_ns == gyro.end_ns and track is self._track:
                self._update(kf, piece.end_ns)
            return
        self._unseen(track, dt_s, blind=gyro is None)

    def _unseen(self, track: Track, dt_s: float, blind: bool) -> None:
        """No wheels: the position widens by what the robot may have done; without a gyro the heading too. (25)"""
        speed, rate = abs(self._speed_m_s), abs(self._rate_rad_s)
        track.kf.add_position_variance(unseen_growth(track.unseen_s, dt_s, speed, UNSEEN_ACCELERATION_M_S2))
        track.unseen_s += dt_s
        if blind:
            track.kf.add_heading_variance(unseen_growth(track.blind_s, dt_s, rate, UNSEEN_TURN_RAD_S2), both=True)
            track.blind_s += dt_s
        else:
            track.kf.anchor_wheels()  # (24)

    def _update(self, kf: Filter, t_ns: int) -> None:
        """Measurement (14), and what follows from its outcome."""
        outcome = kf.update(self._rate_rad_s)
        if outcome is Outcome.REJECTED:
            self.counters["rejected"] += 1
            self._rejections += 1
            self._rejected_ns = t_ns
            text = f"wheels and gyro disagree by {math.degrees(kf.z):.2f} deg"
            self.reasons.set("agreement", text, t_ns)
            if self._rejections < self._config.estimation.rejections_before_release:
                return
            kf.add_heading_variance(kf.z * kf.z)  # slip: the wheels' heading is worth no more than this
            self.counters["released"] += 1
            outcome = kf.update(self._rate_rad_s)
        self._rejections = 0
        self.counters["accepted" if outcome is Outcome.ACCEPTED else "not_finite"] += 1
        if t_ns - self._rejected_ns > AGREEMENT_NS:
            self.reasons.clear("agreement")

    # ---- validity ----------------------------------------------------------------------------------------------

    def _wheels_silent(self, now_ns: int) -> bool:
        since = self._last_wheel_ns or self._first_ns
        return now_ns - since >= self._config.encoders.silent_after_s * NS_PER_S

    def _gyro_silent(self, now_ns: int) -> bool:
        return now_ns - (self._last_gyro_ns or self._first_ns) >= self._config.fog.silent_after_s * NS_PER_S

    def _watch(self, now_ns: int) -> None:
        """Turn silence and spread into reasons."""
        reasons, e = self.reasons, self._config.estimation
        if self._has_gyro:
            reasons.update(
                "fog", "no gyro samples: heading from the wheels alone" if self._gyro_silent(now_ns) else None, now_ns
            )
        if not self._last_wheel_ns:
            reasons.set("encoders", "no wheel samples yet", now_ns, Validity.INITIALISING)
        elif self._wheels_silent(now_ns):
            silent_s = (now_ns - self._last_wheel_ns) * S_PER_NS
            severity = Validity.INVALID if silent_s > e.invalid_after_s else Validity.DEGRADED
            reasons.set("encoders", "no wheel samples: position unknown since then", now_ns, severity)
        else:
            reasons.clear("encoders")
        if self.bias.active and not reasons.has("bias"):
            reasons.set("bias", self.bias.state.value, now_ns, Validity.INITIALISING)
        if self.bias.state is BiasState.SHORT and reasons.has("bias"):
            learned = self._track.kf.gyro_bias_sigma_rad_s() < 2.0 * self.bias.sigma_after_rad_s(
                e.static_bias.minimum_s
            )
            if learned:
                reasons.clear("bias")

    def _pose(self, t_ns: int) -> Pose:
        """The pose at `t_ns`: the filter's, carried on through the samples that wait for their partner."""
        track, preview = self._track, self._preview
        preview.kf.copy_from(track.kf)
        preview.t_ns, preview.unseen_s, preview.blind_s = track.t_ns, track.unseen_s, track.blind_s
        if track.t_ns:
            rate = self._rate_rad_s
            self._run(preview, t_ns)
            self._rate_rad_s = rate
        if not preview.kf.is_finite():
            self._recover(t_ns)
        n, covariance = preview.kf.nominal, preview.kf.pose_covariance()
        bound_m = position_bound_m(covariance)
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
            speed_m_s=self._speed_m_s,
            rate_rad_s=self._rate_rad_s,
            speed_sigma_m_s=self._speed_sigma_m_s(preview),
            rate_sigma_rad_s=self._rate_sigma_rad_s(preview, t_ns),
            covariance=covariance,
            position_bound_m=bound_m,
            validity=self.reasons.validity,
            reasons=self.reasons.active(),
        )

    def _speed_sigma_m_s(self, track: Track) -> float:
        unseen = UNSEEN_ACCELERATION_M_S2 * track.unseen_s
        return speed_sigma_m_s(track.kf, self._noise, self._speed_m_s, self._wheel_interval_s) + unseen

    def _rate_sigma_rad_s(self, track: Track, t_ns: int) -> float:
        gyro = self._has_gyro and not self.bias.active and not self._gyro_silent(t_ns)
        interval_s = self._gyro_interval_s if gyro else self._wheel_interval_s
        unseen = UNSEEN_TURN_RAD_S2 * track.blind_s
        return rate_sigma_rad_s(track.kf, self._noise, self._rate_rad_s, interval_s, gyro) + unseen

    # ---- commands ----------------------------------------------------------------------------------------------

    def set_pose(self, x_m: float, y_m: float, heading_rad: float, sigma_m: float, sigma_rad: float) -> None:
        """Take a pose from outside with its standard deviations; what was learned of the sensors stays."""
        covariance = np.diag([sigma_m**2, sigma_m**2, sigma_rad**2])
        self._track.kf.set_pose(x_m, y_m, heading_rad, covariance)
        self.reasons.clear("filter")

    def reset(self) -> None:
        """Back to the origin and the initial uncertainty; the measured bias stays."""
        kf = self._track.kf
        bias, sigma = kf.nominal.gyro_bias_rad_s, kf.gyro_bias_sigma_rad_s()
        kf.restart(self._config.robot.tread_m, self._sigmas)
        kf.set_gyro_bias(bias, sigma)
        self.reasons.clear("filter")

    def _recover(self, t_ns: int) -> None:
        """The covariance or the state is not finite: start again where the robot is not known to be."""
        self.counters["resets"] += 1
        self.reasons.set("filter", "the estimate was not finite and was reset", t_ns, Validity.INVALID)
        self._track.kf.restart(self._config.robot.tread_m, self._sigmas)
        self._preview.kf.copy_from(self._track.kf)
