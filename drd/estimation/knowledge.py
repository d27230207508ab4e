"""Learned knowledge besides the filter's state: noise, kind of steering, agreement of the headings."""

import math

from drd.config.keys import Config
from drd.estimation.agreement import Agreement
from drd.estimation.applied import Applied
from drd.estimation.estimate import forget_gyro, forget_lag, forget_wheels
from drd.estimation.filter import LEAST_LAG_S, MOST_LAG_S, USUAL2, Filter
from drd.estimation.health import Reasons
from drd.estimation.learning import Drive, Learned, RestNoise, WheelNoise
from drd.estimation.noise import NoiseProfile
from drd.estimation.state import Sigmas
from drd.estimation.steering import Steering
from drd.estimation.timeline import Segment
from drd.estimation.track import Track
from drd.estimation.uncertainty import OneSided
from drd.samples import Validity
from drd.units import S_PER_NS


class Knowledge:
    """Learns from the comparisons of a track's headings, made by `compare`. `counters` are the estimator's."""

    def __init__(
        self,
        config: Config,
        sigmas: Sigmas,
        noise: NoiseProfile,
        track: Track,
        reasons: Reasons,
        counters: dict[str, int],
    ):
        self._config, self._sigmas, self._stated, self._track = config, sigmas, noise, track
        self._reasons, self._counters = reasons, counters
        is_learned = config.estimation.profile == "physical"  # the paper's Q and R are fixed
        self.rest_noise = RestNoise(noise.gyro_rad2_per_s, is_learned)
        # The gyro's turn at rest that is not believed, and the part of it undone before the noise was known.
        self._unbelieved_rad, self._taken_back_rad = OneSided(), 0.0
        self._count_rad = math.sqrt(12.0 * noise.count_m2) / config.robot.tread_m  # turn by one count of one wheel
        self.wheel_noise = WheelNoise(noise, is_learned, is_known=config.robot.drive == "differential")
        self.agreement = Agreement(config.estimation.rejections_before_release, reasons, counters)
        self.applied = Applied()
        self._begin_wheels()

    def _begin_wheels(self) -> None:
        self.steering = Steering(self._config, self.wheel_noise)
        self.steering.begin(self._track.kf)
        self.wheel_noise.put_into(self._track.kf.noise)

    def compare(self, t_ns: int, wheels: Segment, gyro: Segment) -> None:
        """Compare the headings at the end of a gyro sample; at rest, first learn the noise that weights them."""
        track, kf = self._track, self._track.kf
        if wheels.a == wheels.b == 0.0:
            was_known = self.rest_noise.known
            self.rest_noise.add(gyro.a, (gyro.end_ns - gyro.start_ns) * S_PER_NS)
            kf.noise.gyro_rad2_per_s = self.rest_noise.variance_rad2_per_s
            if not was_known:
                self._stand(kf)
                return
        else:
            self.rest_noise.interrupt()
            self._unbelieved_rad.forget()
            self._taken_back_rad = 0.0
            if track.gyro_heading:
                return
        if not self.agreement.update(track, t_ns, self.steering.drive):
            self.recover(t_ns)
        else:
            if kf.stands and not track.rejected_rad and kf.z * kf.z > USUAL2 * kf.S:
                # Turned by hand, too slowly for the gate.
                kf.add_heading_variance(self._unbelieved_rad.growth_to(self._taken_back_rad + kf.z), both=True)
            # Slip that the gate found is no noise, and must not pass for it.
            self.wheel_noise.take(kf, is_usual=not self._reasons.has("agreement"))
            if self.steering.drive is Drive.UNKNOWN:
                track.tell_turn_anew()
            if not self.steering.watch(kf):
                self.agreement.slip(track, t_ns, 0.0)

    def _stand(self, kf: Filter) -> None:
        """Undo the gyro's turn at rest, unless wheels may have turned so far between two counts. If the robot does
        turn, because the wheels are late or slip, both headings are wrong by this. (29)
        """
        part_rad = kf.nominal.heading_rad - kf.nominal.gyro_heading_rad
        unbelieved_rad, is_known = self._taken_back_rad + part_rad, self.rest_noise.known
        if abs(unbelieved_rad) > self._count_rad:
            kf.add_heading_variance(self._unbelieved_rad.growth_to(unbelieved_rad), both=True)
        # P has this part by the stated noise: it must not teach anything once the noise is known.
        if not kf.is_turned or abs(part_rad) > 2.0 * self._count_rad or is_known:
            self._taken_back_rad += part_rad
            kf.anchor_gyro()

    def begin_anew(self) -> None:
        """Restart the filter: only the gyro's noise stays known."""
        self._track.kf.restart(self._config.robot.tread_m, self._sigmas)
        self._track.alone_rad = 0.0
        self._track.hindsight.begin(self._track.kf, self._track.t_ns)
        self.agreement = self.agreement.anew(self._track)
        self.applied = Applied()
        self.wheel_noise = self.wheel_noise.anew()
        self._begin_wheels()

    def pose_was_set(self) -> None:
        """Forget earlier errors of the pose: they are no longer in it."""
        self._track.alone_rad = 0.0
        self.steering.pose_was_set()
        self.agreement.pose_was_set(self._track)
        self._track.hindsight.begin(self._track.kf, self._track.t_ns)

    def recover(self, t_ns: int) -> None:
        """Start again with an unknown pose: the covariance or the state is not finite."""
        self._counters["resets"] += 1
        self.begin_anew()
        self._reasons.set("filter", "the estimate was not finite and was reset", t_ns, Validity.INVALID)

    @property
    def learned(self) -> Learned:
        """Learned noise and drive."""
        k, rest = self._track.kf.noise, self.rest_noise
        wheels = (k.wheel_m2_per_m, k.turn_rad2_per_rad, k.jitter_s2) if self.wheel_noise.is_known else (0.0, 0.0, 0.0)
        return Learned(self.steering.drive.value, rest.differences, rest.mean_rad2_per_s, *wheels)

    def recall(self, learned: Learned) -> None:
        """Continue with what was learned before a restart."""
        self._recall_wheels(learned)
        self._recall_gyro(learned)

    def _recall_wheels(self, learned: Learned) -> None:
        self.steering.recall(learned)
        self.steering.begin(self._track.kf)
        self.wheel_noise.recall(learned)
        self.wheel_noise.put_into(self._track.kf.noise)

    def _recall_gyro(self, learned: Learned) -> None:
        self.rest_noise.recall(learned)
        self._track.kf.noise.gyro_rad2_per_s = self.rest_noise.variance_rad2_per_s

    def take_over(self, other: "Knowledge", same_wheels: bool, same_gyro: bool, same_lag: bool) -> None:
        """Continue with another's knowledge, which the track has taken over, as far as it concerns the same sensors."""
        kf, same_noise = self._track.kf, self._stated == other._stated
        if same_wheels and same_gyro:
            self.applied = other.applied
            self.agreement.take_over(other.agreement)
        if not same_wheels:
            if self.steering.scale < other.steering.scale:  # the path so far was driven with the old wheels
                kf.add_scale_variance(other.steering.scale, 0.0)
            forget_wheels(kf, self._config.robot.tread_m, self._sigmas)
            self._track.alone_rad = 0.0
            kf.add_position_variance(other.steering.wander_m2)
            self.steering.begin(kf)
        elif same_noise:
            self.wheel_noise, self.steering = other.wheel_noise, other.steering
            self.wheel_noise.put_into(kf.noise)
        else:
            self._recall_wheels(other.learned)
            if self.steering.scale < other.steering.scale:  # it cannot be found out any more
                kf.add_scale_variance(other.steering.scale, 0.0)
            kf.add_position_variance(other.steering.wander_m2)
        if not same_gyro:
            forget_gyro(kf, self._sigmas)
        elif same_noise:
            self.rest_noise = other.rest_noise
            kf.noise.gyro_rad2_per_s = self.rest_noise.variance_rad2_per_s
        else:
            self._recall_gyro(other.learned)
        if not same_lag:
            self._begin_lag(other._config)

    def _begin_lag(self, then: Config) -> None:
        """Allow for new time stamps: the lag shifts with the gyro's latency, and a change of the wheels' latency makes
        as much of the motion be seen twice, or not at all.
        """
        track, now = self._track, self._config
        kf, other_s = track.kf, now.encoders.latency_s - then.encoders.latency_s
        lag_s = kf.nominal.wheel_lag_s + now.fog.latency_s - then.fog.latency_s
        kf.nominal.wheel_lag_s = min(max(lag_s, LEAST_LAG_S), MOST_LAG_S)
        forget_lag(kf, self._sigmas)
        kf.add_position_variance((track.speed_m_s * other_s) ** 2)
        kf.add_heading_variance((track.rate_rad_s * other_s) ** 2, both=True)
