"""Uncertainties that are not in the covariance: position bound, speed, rate, unseen motion."""

import math

from drd.estimation.filter import Filter
from drd.estimation.lead import Lead
from drd.estimation.noise import NoiseProfile
from drd.estimation.state import BB, DD, LL, RL, RR, SS

# Accelerations, along and in turn, that an unseen robot may have. (36)
UNSEEN_ACCELERATION_M_S2 = 1.0
UNSEEN_TURN_RAD_S2 = 0.5
# Standard deviation of the heading beyond which the pose is degraded: 1 m ahead is then 0.5 m aside.
HEADING_DOUBTFUL_RAD = 0.5
# Radius of the 99 % circle in standard deviations of the worst axis: chi-square, 2 degrees of freedom. (37)
BOUND_SIGMAS = math.sqrt(9.210340371976182)
# Beyond four standard deviations from 0 the sign of the lag is certain: the other sign's probability is 3e-5.
CERTAIN_SIGN_SIGMAS2 = 16.0


def unseen_growth(unseen_s: float, dt_s: float, speed: float, acceleration: float) -> float:
    """Variance that the next `dt_s` of unseen motion add: sigma(t) = speed t + acceleration t^2 / 2. (36)"""
    before = unseen_s * (speed + 0.5 * acceleration * unseen_s)
    after_s = unseen_s + dt_s
    after = after_s * (speed + 0.5 * acceleration * after_s)
    return after * after - before * before


class OneSided:
    """Errors that keep one sign while their cause lasts: their variance is the square of their sum. (18)"""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Note that the cause is over."""
        self.sum = self._covered = 0.0

    def growth(self, part: float) -> float:
        """Variance to add for a further error; none where the sum has been as large before."""
        return self.growth_to(self.sum + part)

    def growth_to(self, total: float) -> float:
        """Variance to add where the sum is known."""
        self.sum = total
        before, self._covered = self._covered, max(self._covered, abs(self.sum))
        return self._covered**2 - before**2


class UncertainHeading:
    """Error of travel along a hardly known heading that the linear covariance leaves out. (36)

    A heading error d shortens the way ahead by 1 - cos d of the distance; a later correction of the heading should
    rotate all of it, which the filter's linear one does not.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Restart at another position."""
        self.x_m = self.y_m = self._covered_m2 = 0.0

    def copy_from(self, other: "UncertainHeading") -> None:
        """Copy the path so far."""
        self.x_m, self.y_m, self._covered_m2 = other.x_m, other.y_m, other._covered_m2

    def growth(self, x_m: float, y_m: float, heading_variance_rad2: float) -> float:
        """Variance of each axis to add for a further step."""
        share = min(0.5 * math.sqrt(3.0) * heading_variance_rad2, 2.0)  # E[d^4] = 3 sigma^4
        self.x_m, self.y_m = self.x_m + share * x_m, self.y_m + share * y_m
        before, self._covered_m2 = self._covered_m2, max(self._covered_m2, self.x_m**2 + self.y_m**2)
        return self._covered_m2 - before


def position_bound_m(covariance: tuple[float, float, float, float, float, float]) -> float:
    """Radius that holds 99 % of a Gaussian position error, from the worst axis. (37)"""
    xx, xy, _, yy, _, _ = covariance
    half, difference = 0.5 * (xx + yy), 0.5 * (xx - yy)
    worst = half + math.hypot(difference, xy)
    return BOUND_SIGMAS * math.sqrt(max(worst, 0.0)) if math.isfinite(worst) else math.inf


def lead_moments(lag_s: float, variance_s2: float) -> tuple[float, float]:
    """Moments of the lead's error for a Gaussian lag, where only late wheels need a lead: its covariance with the lag's
    error, over the lag's variance, and its mean square, s^2. (30)
    """
    if lag_s * lag_s >= CERTAIN_SIGN_SIGMAS2 * variance_s2:
        return (1.0, variance_s2) if lag_s > 0.0 else (0.0, 0.0)
    sigma = math.sqrt(variance_s2)
    u, taken_s = lag_s / sigma, max(lag_s, 0.0)
    below = 0.5 * math.erfc(-u / math.sqrt(2.0))
    density = math.exp(-0.5 * u * u) / math.sqrt(2.0 * math.pi)
    mean = lag_s * below + sigma * density
    square = (lag_s * lag_s + variance_s2) * below + lag_s * sigma * density
    return below, square - 2.0 * taken_s * mean + taken_s * taken_s


def covariance_after(
    kf: Filter, lead: Lead, speed_m_s: float, rate_rad_s: float, heading_rad: float
) -> tuple[float, float, float, float, float, float]:
    """The pose's covariance (upper triangle) at the time of the newest samples, after `lead`. (37)

    An error of lag or stamp moves the pose along `heading_rad` by speed and rate times that error; while the lag is
    hardly known, a robot that seems to stand may have moved off, and one that goes straight may have begun to turn.
    (30), (34)
    """
    xx, xy, xh, yy, yh, hh = kf.pose_covariance()
    k, n = kf.noise, kf.nominal
    lx, ly, lh, lag = kf.lag_covariance()
    lag2 = lead.lag_s * lead.lag_s
    unsure_s2 = lag + lead.doubt_s2
    lag4 = lag2 * lag2 + 6.0 * lag2 * unsure_s2 + 3.0 * unsure_s2 * unsure_s2
    reading = k.count_m2 + lead.wander_m2 + 0.25 * UNSEEN_ACCELERATION_M_S2**2 * lag4
    turned = 2.0 * k.count_m2 / (n.tread_m * n.tread_m) + 0.25 * UNSEEN_TURN_RAD_S2**2 * min(lag4, lead.unseen_s**4)
    late, lead_s2 = lead_moments(n.wheel_lag_s, lag)
    lx, ly, lh = late * lx, late * ly, late * lh
    variance = lead_s2 + k.jitter_s2 + lead.doubt_s2
    vx, vy = speed_m_s * math.cos(heading_rad), speed_m_s * math.sin(heading_rad)
    gx, gy = lead.scale * (n.x_m - n.origin_x_m), lead.scale * (n.y_m - n.origin_y_m)
    return (
        xx + 2.0 * vx * lx + vx * vx * variance + reading + gx * gx,
        xy + vx * ly + vy * lx + vx * vy * variance + gx * gy,
        xh + vx * lh + rate_rad_s * lx + vx * rate_rad_s * variance,
        yy + 2.0 * vy * ly + vy * vy * variance + reading + gy * gy,
        yh + vy * lh + rate_rad_s * ly + vy * rate_rad_s * variance,
        hh + 2.0 * rate_rad_s * lh + rate_rad_s * rate_rad_s * variance + turned + lead.corrected_rad2,
    )


def speed_sigma_m_s(kf: Filter, noise: NoiseProfile, speed_m_s: float, interval_s: float) -> float:
    """Deviation of the mean speed over a wheel sample of `interval_s`: wheel noise and scales, stamps. (38)"""
    travel = 0.5 * noise.wheel_m2_per_m * abs(speed_m_s) / interval_s
    count = noise.count_m2 / interval_s**2
    timing = 2.0 * noise.timing_s2 / interval_s**2  # both ends of the interval
    p = kf.flat_P
    scale = 0.25 * (p[RR] + p[LL] + 2.0 * p[RL])
    return math.sqrt(max(travel + count + (scale + timing) * speed_m_s * speed_m_s, 0.0))


def rate_sigma_rad_s(kf: Filter, noise: NoiseProfile, rate_rad_s: float, interval_s: float, gyro: bool) -> float:
    """Deviation of the mean yaw rate over a sample of `interval_s`, the gyro's or the wheels'. (38)"""
    p, rate2 = kf.flat_P, rate_rad_s * rate_rad_s
    if gyro:
        variance = noise.gyro_rad2_per_s / interval_s + p[BB]
        variance += rate2 * p[SS]
    else:
        variance = noise.turn_rad2_per_rad * abs(rate_rad_s) / interval_s
        variance += 4.0 * noise.count_m2 / (interval_s * kf.nominal.tread_m) ** 2
        variance += rate2 * p[DD] / kf.nominal.tread_m**2
    return math.sqrt(max(variance, 0.0))
