"""Interval of a recording that is explained: its ends, and the data kept on the way."""

import math
from array import array
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from drd.estimation.filter import Filter
from drd.estimation.hindsight import Hindsight
from drd.estimation.state import TT, WHEEL_LAG, Matrix, N, X, Y
from drd.estimation.steering import Steering
from drd.estimation.track import Track
from drd.estimation.uncertainty import UNSEEN_ACCELERATION_M_S2, lead_moments
from drd.units import NS_PER_S, S_PER_NS
from drd_tools.explain.budget import Budget
from drd_tools.explain.parts import Parts
from drd_tools.limit.causes import COUNTS, JITTER, LAG_START, NOT_SEEN, SKID_SCALE, SLIP_FOUND

SNAPSHOTS: Final = 1200  # twice as many as are drawn at most
FIRST_INTERVAL_S: Final = 0.1
DELAY_S: Final = 0.01
XY: Final = (0, 1)


class Snapshot(NamedTuple):
    """Time, travel since the interval's start, heading, covariance by cause (causes, 3, 3), error by the delay (3,)."""

    time_s: float
    distance_m: float
    heading_rad: float
    covariance: Matrix
    delay: Matrix


class Interval:
    """Observer of each step of the filter.

    Times are in seconds of the recording, whose 0 is `zero_ns` on the filter's clock. `from_s`: errors are relative to
    the pose there (None: to the filter's own start, with its uncertainty). `to_s`: None is the end. `keep_s`: ascending
    times whose poses are kept in `budget.parts`.
    """

    def __init__(self, zero_ns: int, from_s: float | None, to_s: float | None, keep_s: tuple[float, ...] = ()):
        self.budget = Budget(Parts() if keep_s else None)
        self.clock: Track | None = None
        self.steering: Steering | None = None  # has the uncertainty of the scale of all travel
        self.begin_steering: Callable[[], Steering] | None = None
        self.delay_s = DELAY_S
        self.reading_m2 = 0.0  # variance of the wheels' reading between two counts
        self.snapshots: list[Snapshot] = []
        self.poses = array("d")  # time_s, x_m, y_m, heading_rad of each step, as published
        self.kept_ways: list[Matrix] = []  # (3,), change of each kept pose by one sigma of the unknown scale
        self.set_at_s: list[float] = []  # times in the interval at which a pose was set from outside
        self.done = self.begun = False
        self._zero_ns = zero_ns
        self._from_ns = None if from_s is None else self._ns(from_s)
        self._to_ns = None if to_s is None else self._ns(to_s)
        self._keep_ns = [self._ns(t_s) for t_s in keep_s]
        self._kept = 0
        self._interval_ns, self._next_ns = round(FIRST_INTERVAL_S * NS_PER_S), 0
        self._distance_m = 0.0
        self._from_m, self._from_wander_m2, self._from_slipped_m2 = (0.0, 0.0), 0.0, 0.0
        self._nothing_seen = Hindsight()

    def _ns(self, time_s: float) -> int:
        return round(time_s * NS_PER_S) + self._zero_ns

    def table(self) -> Matrix:
        """Poses of the filter, shape (n, 4): time_s, x_m, y_m, heading_rad."""
        return np.array(self.poses).reshape(-1, 4)

    def before_step(self, kf: Filter) -> None:
        """Record the last step, complete with its comparison, before the next one begins."""
        assert self.clock is not None
        t_ns = self.clock.t_ns
        time_s = (t_ns - self._zero_ns) * S_PER_NS
        velocity, lag_s = self._velocity(kf), self._lag_s
        turn_rad = velocity[2] * lag_s
        c, s = math.cos(-0.5 * turn_rad), math.sin(-0.5 * turn_rad)  # travel is along the middle of the turn
        lead = lag_s * np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ velocity
        pose = np.array((kf.nominal.x_m, kf.nominal.y_m, kf.heading_rad)) + lead
        self.poses.extend((time_s, *pose.tolist()))
        if self.done:
            return
        if not self.begun and (self._from_ns is None or t_ns >= self._from_ns):
            self.begun, self._distance_m = True, 0.0
            if self._from_ns is not None:
                late, _ = _lead_moments(kf)
                self.budget.rebase(kf.pose_heading, late * velocity)
                self._from_m, self._from_wander_m2 = (kf.nominal.x_m, kf.nominal.y_m), self._wander_m2
                self._from_slipped_m2 = self._slipped_m2
        if not self.begun:
            return
        while self._kept < len(self._keep_ns) and t_ns >= self._keep_ns[self._kept]:
            self._keep(kf, velocity)
        at_end = self._to_ns is not None and t_ns >= self._to_ns
        if t_ns >= self._next_ns or at_end:
            self._next_ns = t_ns + self._interval_ns
            self._snapshot(time_s, kf, velocity)
        self.done = at_end

    def finish(self, kf: Filter) -> None:
        """Record the last step, at the end of the recording."""
        if self.clock is not None and self.clock.t_ns and not self.done:
            self._next_ns = 0
            self.before_step(kf)
            if self.begun and self._kept < len(self._keep_ns):  # the last pose is slightly later than the last step
                self._keep(kf, self._velocity(kf))

    def moved(self, dx_m: float, dy_m: float) -> None:
        """Add the travel of one step, without the filter's corrections."""
        self._distance_m += math.hypot(dx_m, dy_m)

    def pose_was_set(self) -> None:
        """Note that a pose was set from outside."""
        if self.clock is not None and self.begun:
            self.set_at_s.append((self.clock.t_ns - self._zero_ns) * S_PER_NS)

    @property
    def _lag_s(self) -> float:
        return max(getattr(self.clock, "lag_ns", 0), 0) * S_PER_NS

    def _velocity(self, kf: Filter) -> Matrix:
        """Velocity of x, y and heading: lead of the published pose per second of lag. (30)"""
        speed_m_s, rate_rad_s = getattr(self.clock, "speed_m_s", 0.0), getattr(self.clock, "rate_rad_s", 0.0)
        heading_rad = kf.heading_rad + rate_rad_s * self._lag_s
        return np.array((speed_m_s * math.cos(heading_rad), speed_m_s * math.sin(heading_rad), rate_rad_s))

    def _unknown_way(self, kf: Filter) -> Matrix:
        """Change of the pose by one sigma of the scale of all travel, beyond P's. (34)"""
        scale, n = self.steering.scale if self.steering is not None else 0.0, kf.nominal
        from_m = (n.origin_x_m, n.origin_y_m) if self._from_ns is None else self._from_m
        return scale * np.array((n.x_m - from_m[0], n.y_m - from_m[1], 0.0))

    @property
    def _wander_m2(self) -> float:
        return self.steering.wander_m2 if self.steering is not None else 0.0

    @property
    def _hindsight(self) -> Hindsight:
        return getattr(self.clock, "hindsight", self._nothing_seen)

    @property
    def _slipped_m2(self) -> float:
        return self._hindsight.slipped_m**2

    def _keep(self, kf: Filter, velocity: Matrix) -> None:
        assert self.budget.parts is not None
        self.budget.parts.keep(published(kf, velocity))
        self.kept_ways.append(self._unknown_way(kf))
        self._kept += 1

    def _snapshot(self, time_s: float, kf: Filter, velocity: Matrix) -> None:
        J, travel = published(kf, velocity), self._unknown_way(kf)
        covariance = J @ self.budget.P @ J.T
        readings = 1.0 if self._from_ns is None else 2.0  # (37)
        unseen_m = 0.5 * UNSEEN_ACCELERATION_M_S2 * self._lag_s**2
        covariance[COUNTS, XY, XY] += self.reading_m2 * readings
        covariance[NOT_SEEN, XY, XY] += unseen_m**2 * readings
        covariance[JITTER] += kf.noise.jitter_s2 * np.outer(velocity, velocity) * readings
        covariance[SKID_SCALE] += np.outer(travel, travel)
        covariance[SKID_SCALE, XY, XY] += self._wander_m2 - min(self._from_wander_m2, self._wander_m2)
        covariance[SLIP_FOUND, XY, XY] += self._slipped_m2 - min(self._from_slipped_m2, self._slipped_m2)
        if self._from_ns is None:  # else it is equal in both poses
            corrected_m2, corrected_rad2 = self._hindsight.corrected(kf)  # (18)
            covariance[SLIP_FOUND] += np.diag((corrected_m2, corrected_m2, corrected_rad2))
            late, lead_s2 = _lead_moments(kf)
            lead_s2 += self._hindsight.lag_doubt_s2(kf)  # (18)
            covariance[LAG_START] += (lead_s2 - late * late * kf.flat_P[TT]) * np.outer(velocity, velocity)
        delay = J @ self.budget.delay
        self.snapshots.append(Snapshot(time_s, self._distance_m, kf.heading_rad, covariance, delay))
        if len(self.snapshots) > SNAPSHOTS:
            del self.snapshots[1::2]
            self._interval_ns *= 2


def published(kf: Filter, velocity: Matrix) -> Matrix:
    """Jacobian of the published pose with respect to the error state, (3, N): its own errors, and its lead by a wrong
    lag, which counts only in part near 0. (30)
    """
    J = np.zeros((3, N))
    J[(0, 1, 2), (X, Y, kf.pose_heading)] = 1.0
    J[:, WHEEL_LAG] = _lead_moments(kf)[0] * velocity
    return J


def _lead_moments(kf: Filter) -> tuple[float, float]:
    return lead_moments(kf.nominal.wheel_lag_s, kf.flat_P[TT])
