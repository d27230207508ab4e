"""The pose that a track stands for, with its uncertainty; a spread that is too large becomes a reason."""

import math

from drd.config import Config
from drd.health import Reasons
from drd.noise import NoiseProfile
from drd.samples import Pose, Validity
from drd.track import Track
from drd.uncertainty import (
    UNSEEN_ACCELERATION_M_S2,
    UNSEEN_TURN_RAD_S2,
    position_bound_m,
    rate_sigma_rad_s,
    speed_sigma_m_s,
)

# Standard deviations of the heading at which the pose is degraded, and invalid.
HEADING_DOUBTFUL_RAD = 0.5
HEADING_LOST_RAD = 1.5


class PoseMaker:
    """Makes poses from tracks whose filter is finite."""

    def __init__(self, config: Config, noise: NoiseProfile, reasons: Reasons):
        self._limit_m = config.estimation.max_position_bound_m
        self._noise, self._reasons = noise, reasons

    def make(
        self, track: Track, t_ns: int, sequence: int, wheel_interval_s: float, gyro_interval_s: float | None
    ) -> Pose:
        """The track's pose, for `t_ns`. `gyro_interval_s`: of the rate's samples; None: the rate is the wheels'."""
        reasons, n = self._reasons, track.kf.nominal
        xx, xy, xh, yy, yh, hh = track.kf.pose_covariance()
        covariance = (xx + self._noise.count_m2, xy, xh, yy + self._noise.count_m2, yh, hh)  # (26)
        bound_m = position_bound_m(covariance)
        self._watch_heading(math.sqrt(max(hh, 0.0)), t_ns)
        exceeded = self._limit_m is not None and bound_m > self._limit_m
        reasons.update("bound", "the position bound exceeds its limit" if exceeded else None, t_ns, Validity.INVALID)
        return Pose(
            t_ns=max(t_ns, track.t_ns),
            sequence=sequence,
            x_m=n.x_m,
            y_m=n.y_m,
            heading_rad=n.heading_rad,
            speed_m_s=track.speed_m_s,
            rate_rad_s=track.rate_rad_s,
            speed_sigma_m_s=self._speed_sigma_m_s(track, wheel_interval_s),
            rate_sigma_rad_s=self._rate_sigma_rad_s(track, wheel_interval_s, gyro_interval_s),
            covariance=covariance,
            position_bound_m=bound_m,
            validity=reasons.validity,
            reasons=reasons.active(),
        )

    def _watch_heading(self, sigma_rad: float, t_ns: int) -> None:
        """A heading known so badly leaves the linear covariance without a meaning."""
        severity = Validity.INVALID if sigma_rad > HEADING_LOST_RAD else Validity.DEGRADED
        text = "the heading is hardly known" if sigma_rad > HEADING_DOUBTFUL_RAD else None
        self._reasons.update("heading", text, t_ns, severity)

    def _speed_sigma_m_s(self, track: Track, interval_s: float) -> float:
        unseen = UNSEEN_ACCELERATION_M_S2 * track.unseen_s
        return speed_sigma_m_s(track.kf, self._noise, track.speed_m_s, interval_s) + unseen

    def _rate_sigma_rad_s(self, track: Track, wheel_interval_s: float, gyro_interval_s: float | None) -> float:
        gyro = gyro_interval_s is not None
        interval_s = wheel_interval_s if gyro_interval_s is None else gyro_interval_s
        unseen = UNSEEN_TURN_RAD_S2 * track.blind_s
        return rate_sigma_rad_s(track.kf, self._noise, track.rate_rad_s, interval_s, gyro) + unseen
