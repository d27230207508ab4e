"""The pose of a track, with its uncertainty; an excessive uncertainty becomes a reason."""

import math

from drd.config.keys import Config
from drd.estimation.health import Reasons
from drd.estimation.lead import Lead
from drd.estimation.track import Track
from drd.estimation.uncertainty import (
    HEADING_DOUBTFUL_RAD,
    UNSEEN_ACCELERATION_M_S2,
    UNSEEN_TURN_RAD_S2,
    covariance_after,
    position_bound_m,
    rate_sigma_rad_s,
    speed_sigma_m_s,
)
from drd.samples import Pose, Validity

# Standard deviation of the heading at which the pose is invalid.
HEADING_LOST_RAD = 1.5  # ahead may be backwards


class PoseMaker:
    """Makes poses from tracks whose filter is finite."""

    def __init__(self, config: Config, reasons: Reasons):
        self._limit_m = config.estimation.max_position_bound_m
        self._reasons = reasons

    def make(
        self, track: Track, lead: Lead, t_ns: int, sequence: int, wheel_interval_s: float, gyro_interval_s: float | None
    ) -> Pose:
        """The track's pose, for `t_ns`. `gyro_interval_s`: of the rate's samples; None: the rate is the wheels'."""
        reasons, kf = self._reasons, track.kf
        x_m, y_m, heading_rad = lead.onward(kf)
        has_gyro = gyro_interval_s is not None
        interval_s = gyro_interval_s if gyro_interval_s is not None else wheel_interval_s
        speed_m_s, rate_rad_s = track.speed_m_s, track.rate_rad_s
        # Where the gyro's last sample ends before the wheels' does, the turn is the wheels', which may slip.
        turning_rad_s = max(rate_rad_s, kf.wheels_rad_s if track.no_gyro_s else 0.0, key=abs)
        covariance = covariance_after(kf, lead, speed_m_s, turning_rad_s, heading_rad)
        bound_m = position_bound_m(covariance)
        exceeded = self._limit_m is not None and bound_m > self._limit_m
        if exceeded or covariance[5] > HEADING_DOUBTFUL_RAD**2 or reasons.active():
            self._watch(covariance[5], exceeded, t_ns)
        noise = kf.noise
        speed_sigma = speed_sigma_m_s(kf, noise, speed_m_s, wheel_interval_s)
        rate_sigma = rate_sigma_rad_s(kf, noise, rate_rad_s, interval_s, has_gyro)
        # Positional: keyword arguments take twice as long.
        return Pose(
            t_ns if t_ns > track.t_ns else track.t_ns,
            sequence,
            x_m,
            y_m,
            heading_rad,
            speed_m_s,
            rate_rad_s,
            speed_sigma + UNSEEN_ACCELERATION_M_S2 * track.unseen_s,
            rate_sigma + UNSEEN_TURN_RAD_S2 * track.blind_s,
            covariance,
            bound_m,
            reasons.validity,
            reasons.active(),
        )

    def _watch(self, variance_rad2: float, exceeded: bool, t_ns: int) -> None:
        """Set the reason of a heading so uncertain that the linear covariance loses its meaning."""
        reasons, sigma_rad = self._reasons, math.sqrt(max(variance_rad2, 0.0))
        if sigma_rad > HEADING_DOUBTFUL_RAD:
            severity = Validity.INVALID if sigma_rad > HEADING_LOST_RAD else Validity.DEGRADED
            reasons.set("heading", "the heading is too uncertain", t_ns, severity)
        else:
            reasons.clear("heading")
        reasons.update("bound", "the position bound exceeds its limit" if exceeded else None, t_ns, Validity.INVALID)
