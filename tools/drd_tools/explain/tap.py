"""Daemon's own filter, with every step repeated on the budget."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drd.config.keys import Config
from drd.estimation.filter import Filter, Outcome
from drd.estimation.learning import Drive, WheelNoise
from drd.estimation.noise import NoiseProfile
from drd.estimation.state import (
    GYRO_BIAS,
    GYRO_HEADING,
    GYRO_SCALE,
    HEADING,
    HH,
    SCALE_L,
    SCALE_R,
    SLIP,
    TREAD,
    WHEEL_LAG,
    XX,
    YY,
    Matrix,
    N,
    Nominal,
    Sigmas,
    X,
    Y,
)
from drd.estimation.steering import Steering
from drd.estimation.track import Track, make_track
from drd_tools.explain.budget import COUNT
from drd_tools.explain.interval import Interval
from drd_tools.limit import causes
from drd_tools.limit.process_noise import FilterByCause

# Cause of a state's uncertainty at the start, or after it was forgotten.
START_OF = {
    X: causes.START_POSE,
    Y: causes.START_POSE,
    SCALE_R: causes.WHEEL_SCALE_START,
    SCALE_L: causes.WHEEL_SCALE_START,
    TREAD: causes.TREAD_START,
    GYRO_SCALE: causes.GYRO_SCALE_START,
    GYRO_BIAS: causes.BIAS_START,
    WHEEL_LAG: causes.LAG_START,
    SLIP: causes.SIDEWAYS_SLIP,
}


def tapped_track(interval: Interval, config: Config, sigmas: Sigmas, noise: NoiseProfile) -> Track:
    """Make a track like the estimator's own, whose filter reports its steps to `interval`."""
    interval.begin_steering = lambda: Steering(config, WheelNoise(noise, config.estimation.profile == "physical"))
    interval.steering = interval.begin_steering()

    # A track that may take over from another continues the other's budget, see copy_from.
    is_first = interval.clock is None

    def tapped(*args: Any) -> TappedFilter:
        return TappedFilter(interval, *args, recorded=is_first)

    interval.clock = make_track(config, sigmas, noise, tapped)
    return interval.clock


class _View(Filter):
    """Read-only view of the filter for steering: the estimator's own steering already changes the filter."""

    def __init__(self, kf: Filter):
        self.nominal, self._p, self.flat_P = kf.nominal, kf._p, kf.flat_P

    def add_scale_variance(self, common: float, difference: float) -> None:
        """Do nothing."""

    def forget_slip(self) -> None:
        """Do nothing."""

    def add_lag_variance(self, variance_s2: float) -> None:
        """Do nothing."""


class TappedFilter(FilterByCause):
    """Filter that repeats each of its steps on the covariance of each cause."""

    def __init__(
        self, interval: Interval, tread_m: float, sigmas: Sigmas, noise: NoiseProfile, *args: Any, recorded: bool = True
    ):
        self._interval, self._budget, self._watches = interval, interval.budget, recorded
        self._R = np.zeros(COUNT)
        self._R[causes.COUNTS] = 2.0 * noise.count_m2 / tread_m**2  # (25)
        self._R[causes.COMPARISON] = noise.comparison_rad2 - self._R[causes.COUNTS]
        interval.reading_m2 = noise.count_m2
        self._rate_rad_s: float | None = None
        self._unseen = False
        super().__init__(tread_m, sigmas, noise, *args)

    @property
    def _is_recorded(self) -> bool:
        return self._watches and not self._interval.done

    def copy_from(self, other: Filter) -> None:
        """Continue in place of another filter, and from then on record to the budget."""
        super().copy_from(other)
        self._watches = True

    def restart(self, tread_m: float, s: Sigmas) -> None:
        """Restart; each initial standard deviation is assigned to its cause."""
        if self._is_recorded:
            self._budget.forget(*range(N))
            if self._interval.begin_steering is not None:
                self._interval.steering = self._interval.begin_steering()
        super().restart(tread_m, s)
        self._rate_rad_s = None
        if not self._is_recorded:
            return
        sigmas = {X: s.position_m, Y: s.position_m, SCALE_R: s.wheel_scale, SCALE_L: s.wheel_scale, TREAD: s.tread_m}
        sigmas |= {GYRO_SCALE: s.gyro_scale, GYRO_BIAS: s.gyro_bias_rad_s, WHEEL_LAG: s.wheel_lag_s, SLIP: s.slip_s}
        for i, sigma in sigmas.items():
            self._budget.add(START_OF[i], i, i, sigma**2)
        self._budget.add_matrix(causes.START_POSE, s.heading_rad**2, (HEADING, GYRO_HEADING))

    def predict(
        self, dt_s: float, left_m: float, right_m: float, rate_rad_s: float | None, *args: Any, **kwargs: Any
    ) -> None:
        self._unseen = False
        self._interval.before_step(self)
        n = self.nominal
        x_m, y_m = n.x_m, n.y_m
        super().predict(dt_s, left_m, right_m, rate_rad_s, *args, **kwargs)
        self._interval.moved(n.x_m - x_m, n.y_m - y_m)
        before, self._rate_rad_s = self._rate_rad_s, rate_rad_s
        if self._is_recorded:
            change = 0.0 if before is None or rate_rad_s is None else n.gyro_scale * (rate_rad_s - before)
            self._budget.predict(self._FT, self.Q_causes, -self._interval.delay_s * change)

    def update(self, rate_rad_s: float) -> Outcome:
        outcome = super().update(rate_rad_s)
        if outcome is Outcome.ACCEPTED and self._is_recorded:
            self._R[causes.TIMING] = self.noise.timing_s2 * rate_rad_s * rate_rad_s  # (25)
            self._budget.update(self.gain, self._R, self.z)  # (19)
            if (steering := self._interval.steering) is not None and steering.drive is Drive.UNKNOWN:
                steering.watch(_View(self))
        return outcome

    def anchor_gyro(self) -> None:
        super().anchor_gyro()
        self._unseen = False
        if self._is_recorded:
            self._budget.copy_error(HEADING, GYRO_HEADING)

    def anchor_wheels(self) -> None:
        super().anchor_wheels()
        self._unseen = False
        if self._is_recorded:
            self._budget.copy_error(GYRO_HEADING, HEADING)

    def spread_error(self, source: int, shares: Mapping[int, float]) -> None:
        super().spread_error(source, shares)
        if self._is_recorded:
            self._budget.spread_error(source, shares)

    def add_position_variance(self, variance_m2: float) -> None:
        """Add variance of unobserved motion."""
        xx, yy = self._p[XX], self._p[YY]
        super().add_position_variance(variance_m2)
        self._unseen = True
        if self._is_recorded:
            self._budget.add(causes.NOT_SEEN, X, X, self._p[XX] - xx)
            self._budget.add(causes.NOT_SEEN, Y, Y, self._p[YY] - yy)

    def add_heading_variance(self, variance_rad2: float, both: bool = False) -> None:
        """Add variance of slip or, right after the position's, of an unobserved turn."""
        hh = self._p[HH]
        super().add_heading_variance(variance_rad2, both)
        cause = causes.NOT_SEEN if self._unseen and both else causes.SLIP_FOUND
        if self._is_recorded:
            self._budget.add_matrix(cause, self._p[HH] - hh, (HEADING, GYRO_HEADING) if both else (HEADING,))

    def add_gyro_bias_variance(self, variance_rad2_s2: float) -> None:
        super().add_gyro_bias_variance(variance_rad2_s2)
        if self._is_recorded:
            self._budget.add(causes.BIAS_SILENCE, GYRO_BIAS, GYRO_BIAS, variance_rad2_s2)

    def set_pose(self, x_m: float, y_m: float, heading_rad: float, covariance: Matrix) -> None:
        super().set_pose(x_m, y_m, heading_rad, covariance)
        if not self._is_recorded:
            return
        self._interval.pose_was_set()
        self._budget.forget(X, Y, HEADING, GYRO_HEADING)
        pose = (X, Y, HEADING)
        self._budget.add_matrix(causes.START_POSE, self.P[np.ix_(pose, pose)], pose)
        self._budget.copy_error(HEADING, GYRO_HEADING)

    def set_gyro_bias(self, bias_rad_s: float, sigma_rad_s: float) -> None:
        super().set_gyro_bias(bias_rad_s, sigma_rad_s)
        if self._is_recorded:
            self._budget.forget(GYRO_BIAS)
            self._budget.add(causes.BIAS_START, GYRO_BIAS, GYRO_BIAS, sigma_rad_s**2)

    def add_scale_variance(self, common: float, difference: float) -> None:
        """Add variance of the wheel scales, since the wheels skid."""
        before = self.P.copy()
        super().add_scale_variance(common, difference)
        if self._is_recorded:
            self._budget.add_matrix(causes.SKID_SCALE, self.P - before)

    def add_slip_variance(self, variance_s2: float) -> None:
        super().add_slip_variance(variance_s2)
        if self._is_recorded:
            self._budget.add(causes.SIDEWAYS_SLIP, SLIP, SLIP, variance_s2)

    def add_lag_variance(self, variance_s2: float) -> None:
        """Add variance of the lag, which was learned with a wrong tread."""
        before = self.P.copy()
        super().add_lag_variance(variance_s2)
        if self._is_recorded:
            self._budget.add_matrix(causes.LAG_START, self.P - before)

    def set_covariance(self, states: Sequence[int], covariance: Matrix) -> None:
        """Revert what was learned while the wheels slipped."""
        super().set_covariance(states, covariance)
        if self._is_recorded:
            self._budget.forget(*states)
            self._budget.add_matrix(causes.SLIP_FOUND, covariance, states)

    def put(self, nominal: Nominal, P: Matrix) -> None:
        """Take over an estimate from elsewhere; its uncertainty becomes a single cause."""
        super().put(nominal, P)
        if self._is_recorded:
            self._budget.forget(*range(N))
            self._budget.add_matrix(causes.HANDED_OVER, P)

    def forget(self, state: int, sigma: float) -> None:
        super().forget(state, sigma)
        if self._is_recorded:
            self._budget.forget(state)
            self._budget.add(START_OF[state], state, state, sigma**2)
