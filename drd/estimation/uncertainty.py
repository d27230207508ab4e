"""Uncertainties that the covariance does not hold by itself: position bound, speed, rate, motion that was not seen."""

import math

from drd.estimation.filter import BB, DD, LL, RL, RR, SS, Filter
from drd.estimation.noise import NoiseProfile

# How much a robot that is not seen may accelerate and turn. (36)
UNSEEN_ACCELERATION_M_S2 = 1.0
UNSEEN_TURN_RAD_S2 = 0.5
# Radius of the 99 % circle in standard deviations of the worst axis: chi-square, 2 degrees of freedom. (37)
BOUND_SIGMAS = math.sqrt(9.210340371976182)


def unseen_growth(unseen_s: float, dt_s: float, speed: float, acceleration: float) -> float:
    """Variance that the next `dt_s` of unseen motion add: sigma(t) = speed t + acceleration t^2 / 2. (36)"""
    before = unseen_s * (speed + 0.5 * acceleration * unseen_s)
    after_s = unseen_s + dt_s
    after = after_s * (speed + 0.5 * acceleration * after_s)
    return after * after - before * before


class OneSided:
    """Errors of one cause that have one sign while it lasts: the variance has the square of their sum. (18)"""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """The cause is over."""
        self.sum = self._covered = 0.0

    def growth(self, part: float) -> float:
        """Variance to add for a further error; none where the sum has been as large before."""
        self.sum += part
        before, self._covered = self._covered, max(self._covered, abs(self.sum))
        return self._covered**2 - before**2


def position_bound_m(covariance: tuple[float, float, float, float, float, float]) -> float:
    """Radius that holds 99 % of a Gaussian position error, from the worst axis. (37)"""
    xx, xy, _, yy, _, _ = covariance
    half, difference = 0.5 * (xx + yy), 0.5 * (xx - yy)
    worst = half + math.hypot(difference, xy)
    return BOUND_SIGMAS * math.sqrt(max(worst, 0.0)) if math.isfinite(worst) else math.inf


def covariance_after(
    kf: Filter,
    lag_s: float,
    speed_m_s: float,
    rate_rad_s: float,
    heading_rad: float,
    scale: float,
    interval_s: float,
) -> tuple[float, float, float, float, float, float]:
    """The pose's covariance (upper triangle) at the time of the newest samples, `lag_s` after the filter's. (37)

    A wrong lag or stamp puts the pose ahead, along `heading_rad`, by speed and rate times its error; while the lag is
    hardly known, a robot that seems to stand may have moved off; it turns unseen for `interval_s` at most, that of the
    rate's samples. `scale`: standard deviation of the scale of all ways
    beyond P's. (30), (34)
    """
    xx, xy, xh, yy, yh, hh = kf.pose_covariance()
    k, n = kf.noise, kf.nominal
    lx, ly, lh, lag = kf.lag_covariance()
    lag2 = lag_s * lag_s
    lag4 = lag2 * lag2 + 6.0 * lag2 * lag + 3.0 * lag * lag
    reading = k.count_m2 + 0.25 * UNSEEN_ACCELERATION_M_S2**2 * lag4
    turned = 2.0 * k.count_m2 / (n.tread_m * n.tread_m) + 0.25 * UNSEEN_TURN_RAD_S2**2 * min(lag4, interval_s**4)
    variance = lag + k.jitter_s2
    vx, vy = speed_m_s * math.cos(heading_rad), speed_m_s * math.sin(heading_rad)
    gx, gy = scale * (n.x_m - n.origin_x_m), scale * (n.y_m - n.origin_y_m)
    return (
        xx + 2.0 * vx * lx + vx * vx * variance + reading + gx * gx,
        xy + vx * ly + vy * lx + vx * vy * variance + gx * gy,
        xh + vx * lh + rate_rad_s * lx + vx * rate_rad_s * variance,
        yy + 2.0 * vy * ly + vy * vy * variance + reading + gy * gy,
        yh + vy * lh + rate_rad_s * ly + vy * rate_rad_s * variance,
        hh + 2.0 * rate_rad_s * lh + rate_rad_s * rate_rad_s * variance + turned,
    )


def speed_sigma_m_s(kf: Filter, noise: NoiseProfile, speed_m_s: float, interval_s: float) -> float:
    """Of the mean speed over a wheel sample of `interval_s`: two wheels' noise and scales, time stamps. (38)"""
    travel = 0.5 * noise.wheel_m2_per_m * abs(speed_m_s) / interval_s
    count = noise.count_m2 / interval_s**2
    timing = 2.0 * noise.timing_s2 / interval_s**2  # both ends of the interval
    p = kf.flat_P
    scale = 0.25 * (p[RR] + p[LL] + 2.0 * p[RL])
    return math.sqrt(max(travel + count + (scale + timing) * speed_m_s * speed_m_s, 0.0))


def rate_sigma_rad_s(kf: Filter, noise: NoiseProfile, rate_rad_s: float, interval_s: float, gyro: bool) -> float:
    """Of the mean yaw rate over the sample of `interval_s` that it came from, a gyro's or the wheels'. (38)"""
    p, rate2 = kf.flat_P, rate_rad_s * rate_rad_s
    if gyro:
        variance = noise.gyro_rad2_per_s / interval_s + p[BB]
        variance += rate2 * p[SS]
    else:
        variance = noise.turn_rad2_per_rad * abs(rate_rad_s) / interval_s
        variance += 4.0 * noise.count_m2 / (interval_s * kf.nominal.tread_m) ** 2
        variance += rate2 * p[DD] / kf.nominal.tread_m**2
    return math.sqrt(max(variance, 0.0))
