"""The filter's state: quantities, the covariance of their errors, and changes of both outside of its steps."""

import math
from collections.abc import Callable, Mapping, MutableSequence, Sequence
from dataclasses import dataclass, replace
from math import cos, sin
from operator import itemgetter
from typing import Final, cast

import numpy as np
import numpy.typing as npt

# The error state x, computed minus true (8), in the order of (13), then (30) and (33); REP-103 axes.
X: Final = 0  # m, forward at heading 0
Y: Final = 1  # m, left at heading 0
HEADING: Final = 2  # rad, from the wheels
SCALE_R: Final = 3  # 1, right wheel
SCALE_L: Final = 4  # 1, left wheel
TREAD: Final = 5  # m
GYRO_HEADING: Final = 6  # rad, from the gyro
GYRO_SCALE: Final = 7  # 1
GYRO_BIAS: Final = 8  # rad/s
WHEEL_LAG: Final = 9  # s
SLIP: Final = 10  # s, sideways
N: Final = 11
# Flat positions in an N x N matrix: the variances, and covariances that are read often.
(XX, YY, HH, RR, LL, DD, GG, SS, BB, TT, VV) = (i * (N + 1) for i in range(N))
XY, RL = X * N + Y, SCALE_R * N + SCALE_L
HG, GH = HEADING * N + GYRO_HEADING, GYRO_HEADING * N + HEADING
# Variances that mean "unknown". Without a limit, a long time unseen makes P so large that R is rounding noise.
HEADING_UNKNOWN_RAD2: Final = (2.0 * math.pi) ** 2
POSITION_UNKNOWN_M2: Final = 1e8

Matrix = npt.NDArray[np.float64]
Two = tuple[float, float]
Four = tuple[float, float, float, float]
Six = tuple[float, float, float, float, float, float]


def elements(matrix: Matrix) -> MutableSequence[float]:
    """Flat access to a matrix in plain floats: a memoryview is several times faster than numpy's scalars."""
    # A float64 array's buffer holds floats; typeshed knows memoryviews of bytes only.
    return cast(MutableSequence[float], matrix.reshape(-1).data)


@dataclass(slots=True)
class Nominal:
    """The computed quantities that the error state corrects."""

    tread_m: float
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    scale_right: float = 0.0
    scale_left: float = 0.0
    gyro_heading_rad: float = 0.0
    gyro_scale: float = 1.0
    gyro_bias_rad_s: float = 0.0  # added to the scaled reading, as in (11)
    wheel_lag_s: float = 0.0  # delay of the wheels relative to the gyro; negative: the gyro is late
    slip_s: float = 0.0  # times speed and yaw rate: the body's own speed to its left
    origin_x_m: float = 0.0  # start of the path that led to the position
    origin_y_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Sigmas:
    """Standard deviations of the error state at the start, in its units."""

    position_m: float
    heading_rad: float
    wheel_scale: float
    tread_m: float
    gyro_scale: float  # 0 leaves the gyro's scale out: the paper's variant for a calibrated gyro
    gyro_bias_rad_s: float
    wheel_lag_s: float = 0.0  # 0 leaves the lag out: without a gyro it is not observable
    slip_s: float = 0.0  # not observable: considered in P, never corrected
    scale_difference: float = 0.0  # right less left, in addition to `wheel_scale`


class State:
    """Computed quantities with the covariance P of their errors, (N, N). (8), (15)

    `given`: how often constants or their variances were set by anything but a comparison. `rate_rad_s`: the yaw rate
    of the last step, from both sensors. `pose_heading`: which of the two headings is the pose's.
    """

    def __init__(self, tread_m: float, sigmas: Sigmas, along_gyro: bool):
        self.P: Matrix = np.zeros((N, N))
        self.given, self.rate_rad_s = 0, 0.0
        self._along_gyro = along_gyro
        self.pose_heading = h = GYRO_HEADING if along_gyro else HEADING
        self._p, self._ones, self._P_vector = elements(self.P), np.ones(N * N), self.P.reshape(-1)
        self.flat_P: Sequence[float] = self._p
        lag = WHEEL_LAG * N
        self._take_pose: Callable[[Sequence[float]], Six] = itemgetter(XX, XY, X * N + h, YY, Y * N + h, h * (N + 1))
        self._take_lag: Callable[[Sequence[float]], Four] = itemgetter(lag + X, lag + Y, lag + h, TT)
        self.restart(tread_m, sigmas)

    def restart(self, tread_m: float, s: Sigmas) -> None:
        """Begin at the origin with these standard deviations; both headings share their error."""
        self.given += 1
        self.nominal, self._last_tread_m = Nominal(tread_m), tread_m
        diagonal = (s.position_m, s.position_m, s.heading_rad, s.wheel_scale, s.wheel_scale, s.tread_m,
                    s.heading_rad, s.gyro_scale, s.gyro_bias_rad_s, s.wheel_lag_s, s.slip_s)  # fmt: skip
        np.copyto(self.P, np.diag([sigma**2 for sigma in diagonal]))
        self.P[HEADING, GYRO_HEADING] = self.P[GYRO_HEADING, HEADING] = s.heading_rad**2
        self.add_scale_variance(0.0, s.scale_difference)

    def _copy_state(self, other: "State") -> None:
        a, b = self.nominal, other.nominal
        a.tread_m, a.x_m, a.y_m, a.heading_rad = b.tread_m, b.x_m, b.y_m, b.heading_rad
        a.scale_right, a.scale_left = b.scale_right, b.scale_left
        a.gyro_heading_rad, a.gyro_scale, a.gyro_bias_rad_s = b.gyro_heading_rad, b.gyro_scale, b.gyro_bias_rad_s
        a.wheel_lag_s, a.slip_s = b.wheel_lag_s, b.slip_s
        a.origin_x_m, a.origin_y_m = b.origin_x_m, b.origin_y_m
        self._last_tread_m, self.given, self.rate_rad_s = other._last_tread_m, other.given, other.rate_rad_s
        np.copyto(self.P, other.P)

    def anchor_gyro(self) -> None:
        """Continue the heading of a gyro that was absent from the wheels', sharing their error. (35)"""
        self.nominal.gyro_heading_rad = self.nominal.heading_rad
        self._copy_error(HEADING, GYRO_HEADING)

    def anchor_wheels(self) -> None:
        """Continue the heading of wheels that were absent from the gyro's, sharing its error. (35)"""
        self.nominal.heading_rad = self.nominal.gyro_heading_rad
        self._copy_error(GYRO_HEADING, HEADING)

    def _copy_error(self, source: int, target: int) -> None:
        self.P[target, :] = self.P[source, :]
        self.P[:, target] = self.P[:, source]

    def turn_by_gyro_alone(self, turn_rad: float) -> None:
        """Add the scale error of a turn seen by the gyro alone: without moving wheels F was taken at no turn. (15)"""
        self.spread_error(GYRO_SCALE, {GYRO_HEADING: turn_rad / self.nominal.gyro_scale})

    def spread_error(self, source: int, shares: Mapping[int, float]) -> None:
        """Add to each state's error its share of that of `source`; the share of `source` itself is what remains."""
        T = np.eye(N)
        for i, share in shares.items():
            T[i, source] = share
        np.copyto(self.P, T @ self.P @ T.T)

    def add_position_variance(self, variance_m2: float) -> None:
        """Widen the position by unseen motion, up to a variance that means "anywhere". (36)"""
        for i in (XX, YY):
            self._p[i] += min(variance_m2, max(0.0, POSITION_UNKNOWN_M2 - self._p[i]))

    def add_heading_variance(self, variance_rad2: float, both: bool = False) -> None:
        """Widen the wheels' heading (slip, unseen motion); `both`: the gyro's heading shares that error. (36)"""
        added = min(variance_rad2, max(0.0, HEADING_UNKNOWN_RAD2 - self._p[HH]))
        for i in (HH, GG, HG, GH) if both else (HH,):
            self._p[i] += added

    def add_gyro_bias_variance(self, variance_rad2_s2: float) -> None:
        """Widen the bias: the gyro was absent and may have come back with another one."""
        self._p[BB] += variance_rad2_s2

    def add_scale_variance(self, common: float, difference: float) -> None:
        """Widen the scales of the wheels: their common part, with which position and tread vary, and their
        difference. (34)
        """
        self.given += 1
        n, g = self.nominal, np.zeros(N)
        g[X], g[Y] = n.x_m - n.origin_x_m, n.y_m - n.origin_y_m
        g[SCALE_R], g[SCALE_L], g[TREAD] = 1.0, 1.0, n.tread_m
        self.P += common**2 * np.outer(g, g)
        g.fill(0.0)
        g[SCALE_R], g[SCALE_L] = 0.5, -0.5
        self.P += difference**2 * np.outer(g, g)

    def add_tread_variance(self, variance_m2: float) -> None:
        """Widen the tread: the effective one may differ from now on."""
        self.given += 1
        self._p[DD] += variance_m2

    def tell_turn_anew(self, turn_rad: float, tread_m: float) -> None:
        """Rescale a turn measured by the wheels alone by 1/D, after the tread D was corrected. (34)"""
        n = self.nominal
        share = tread_m / n.tread_m
        beyond_rad = turn_rad * (share + 1.0 / share - 2.0)
        n.heading_rad, n.gyro_heading_rad = n.heading_rad + beyond_rad, n.gyro_heading_rad + beyond_rad
        slope = turn_rad / tread_m * (1.0 - share)  # by `share` again in the next step, where dD/D stays
        self.spread_error(TREAD, {HEADING: slope, GYRO_HEADING: slope})

    def add_lag_variance(self, variance_s2: float) -> None:
        """Widen the lag and, while the robot turns, the headings at the wheels' time that vary with it. (30)"""
        self.given += 1
        g = np.zeros(N)
        g[WHEEL_LAG], g[GYRO_HEADING], g[HEADING] = 1.0, -self.rate_rad_s, -self.rate_rad_s
        self.P += variance_s2 * np.outer(g, g)

    def add_slip_variance(self, variance_s2: float) -> None:
        """Allow sideways slip from now on. (33)"""
        self.P[SLIP, SLIP] += variance_s2

    def forget_slip(self) -> None:
        """Condition P on zero sideways slip, now and in the past. (33)"""
        column = self.P[SLIP].tolist()
        if (variance := column[SLIP]) > 0.0:
            self.spread_error(SLIP, {i: 0.0 if i == SLIP else -column[i] / variance for i in range(N)})

    def set_pose(self, x_m: float, y_m: float, heading_rad: float, covariance: Matrix) -> None:
        """Take a pose from outside, with its 3x3 covariance (m^2, m rad, rad^2); what was learned stays."""
        n = self.nominal
        n.x_m, n.y_m, n.heading_rad, n.gyro_heading_rad = x_m, y_m, heading_rad, heading_rad
        n.origin_x_m, n.origin_y_m = x_m, y_m
        for i in (X, Y, HEADING):
            self.P[i, :] = self.P[:, i] = 0.0
        self.P[:3, :3] = covariance
        self._copy_error(HEADING, GYRO_HEADING)

    def lead_to_pose(self, speed_m_s: float, rate_rad_s: float) -> None:
        """Correlate the filter's pose with the lag, by which the pose that was set is ahead of it. (30)"""
        n = self.nominal
        dx, dy = -speed_m_s * cos(n.heading_rad), -speed_m_s * sin(n.heading_rad)
        self.spread_error(WHEEL_LAG, {X: dx, Y: dy, HEADING: -rate_rad_s, GYRO_HEADING: -rate_rad_s})

    def move(self, there: tuple[float, float, float], here: tuple[float, float, float]) -> None:
        """Turn and shift the plane so that the pose (x, y in m, heading in rad) `there` becomes `here`."""
        n, turned = self.nominal, here[2] - there[2]
        c, s, dx_m, dy_m = cos(turned), sin(turned), n.x_m - there[0], n.y_m - there[1]
        n.x_m, n.y_m = here[0] + c * dx_m - s * dy_m, here[1] + s * dx_m + c * dy_m
        n.heading_rad += turned
        n.gyro_heading_rad += turned

    def set_gyro_bias(self, bias_rad_s: float, sigma_rad_s: float) -> None:
        """Take a bias measured at standstill: `bias_rad_s` is added to readings, as in (11)."""
        self.nominal.gyro_bias_rad_s = bias_rad_s
        self.P[GYRO_BIAS, :] = self.P[:, GYRO_BIAS] = 0.0
        self.P[GYRO_BIAS, GYRO_BIAS] = sigma_rad_s**2

    def set_tread(self, tread_m: float) -> None:
        """Set the tread other than by a comparison: P keeps its error in metres."""
        self.nominal.tread_m = self._last_tread_m = tread_m

    def put(self, nominal: Nominal, P: Matrix) -> None:
        """Set the whole estimate."""
        self.given += 1
        self.nominal = replace(nominal)
        self.set_tread(nominal.tread_m)
        np.copyto(self.P, P)

    def forget(self, state: int, sigma: float) -> None:
        """Forget a state except for this standard deviation."""
        self.given += 1
        self.P[state, :] = self.P[:, state] = 0.0
        self.P[state, state] = sigma**2

    def set_covariance(self, states: Sequence[int], covariance: Matrix) -> None:
        """Set the covariance of some states, uncorrelated with the others."""
        for state in states:
            self.P[state, :] = self.P[:, state] = 0.0
        self.P[np.ix_(states, states)] = covariance

    def sigma(self, state: int) -> float:
        """Standard deviation of one state."""
        return math.sqrt(max(self._p[state * (N + 1)], 0.0))

    def is_finite(self) -> bool:
        """Whether pose and covariance are finite."""
        n = self.nominal
        return math.isfinite(n.x_m + n.y_m + n.heading_rad) and math.isfinite(self._P_vector.dot(self._ones))

    def pose_covariance(self) -> Six:
        """Upper triangle of the pose's covariance: xx, xy, xh, yy, yh, hh."""
        return self._take_pose(self._p)

    @property
    def heading_variance_rad2(self) -> float:
        """The variance of the pose's heading."""
        return self._p[self.pose_heading * (N + 1)]

    def lag_covariance(self) -> Four:
        """Covariance of the wheels' lag with the pose's x, y and heading, and its variance."""
        return self._take_lag(self._p)

    @property
    def heading_rad(self) -> float:
        """The pose's heading."""
        return self.nominal.gyro_heading_rad if self._along_gyro else self.nominal.heading_rad
