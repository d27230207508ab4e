"""Filter's Q, split by cause."""

from collections.abc import MutableSequence
from typing import Any

import numpy as np

from drd.estimation.filter import Filter
from drd.estimation.noise import NoiseProfile
from drd.estimation.process_noise import GT, HX, HY, RATE_ERROR_CORRELATION_S, TG, XH, YH, YX, ProcessNoise
from drd.estimation.state import BB, DD, GG, HH, LL, RR, SS, TT, XX, XY, YY, Matrix, N, Sigmas, Two, elements
from drd_tools.limit import causes

SIZE = N * N


class NoiseByCause(ProcessNoise):
    """Filter's Q and, in `by_cause`, (causes, N, N), each cause's part of it."""

    def __init__(self, Q: Matrix, sigmas: Sigmas):
        super().__init__(Q, sigmas)
        self.by_cause: Matrix = np.zeros((len(causes.CAUSES), N, N))
        self._q_causes = elements(self.by_cause)

    def fill_wheels(
        self, k: NoiseProfile, dt_s: float, travel_m: Two, turn_rad: float, c: float, s: float, bend: float, D: float,
        jitter: float,
    ) -> None:  # fmt: skip
        """Fill in the wheels' noise, also by cause. (24)"""
        super().fill_wheels(k, dt_s, travel_m, turn_rad, c, s, bend, D, jitter)
        q, (left_m, right_m) = self._q_causes, travel_m
        _pose(q, causes.SLIP_TRAVEL, k.wheel_m2_per_m * right_m, 0.5, bend / D, 1.0 / D, c, s)
        _pose(q, causes.SLIP_TRAVEL, k.wheel_m2_per_m * left_m, 0.5, -bend / D, -1.0 / D, c, s, add=True)
        _pose(q, causes.SLIP_HEADING, k.turn_rad2_per_rad * turn_rad + k.turn_rad2_per_s * dt_s, 0.0, bend, 1.0, c, s)
        _pose(q, causes.JITTER, jitter, 0.0, bend, 1.0, c, s)  # (25)
        _pose(q, causes.SLIP_SIDEWAYS, k.lateral_m2_per_m * 0.5 * (left_m + right_m), 0.0, 1.0, 0.0, c, s)
        anywhere = k.position_m2_per_rad * turn_rad + k.position_m2_per_s * dt_s
        q[causes.SLIP_POSITION * SIZE + XX] = q[causes.SLIP_POSITION * SIZE + YY] = anywhere
        q[causes.WHEEL_SCALE_WALK * SIZE + RR] = k.wheel_scale_per_m * right_m + k.wheel_scale_per_s * dt_s
        q[causes.WHEEL_SCALE_WALK * SIZE + LL] = k.wheel_scale_per_m * left_m + k.wheel_scale_per_s * dt_s
        q[causes.TREAD_WALK * SIZE + DD] = k.tread_m2_per_rad * turn_rad + k.tread_m2_per_s * dt_s

    def fill_gyro(self, k: NoiseProfile, dt_s: float, rate_sigma: float, rate_rad_s: float) -> None:
        """Fill in the gyro's noise and the lag's random walk, also by cause. (26), (30)"""
        super().fill_gyro(k, dt_s, rate_sigma, rate_rad_s)
        q = self._q_causes
        lag_walk, at = k.wheel_lag_s2_per_s * dt_s * self._estimates_lag, causes.LAG_WALK * SIZE
        q[at + TT], q[at + GG] = lag_walk, rate_rad_s * rate_rad_s * lag_walk
        q[at + GT] = q[at + TG] = -rate_rad_s * lag_walk
        q[causes.GYRO_NOISE * SIZE + GG] = k.gyro_rad2_per_s * dt_s
        q[causes.CALIBRATION * SIZE + GG] = 2.0 * RATE_ERROR_CORRELATION_S * rate_sigma * rate_sigma * dt_s
        q[causes.GYRO_SCALE_WALK * SIZE + SS] = k.gyro_scale_per_s * dt_s * self.estimates_gyro_scale
        q[causes.BIAS_WALK * SIZE + BB] = k.gyro_bias_rad2_s2_per_s * dt_s


class FilterByCause(Filter):
    """Filter with its Q split by cause in `Q_causes`, (causes, N, N)."""

    def __init__(self, tread_m: float, sigmas: Sigmas, *args: Any, **kwargs: Any):
        super().__init__(tread_m, sigmas, *args, **kwargs)
        self.process_noise = noise = NoiseByCause(self._Q, sigmas)
        self.Q_causes = noise.by_cause


def _pose(
    q: MutableSequence[float], cause: int, variance: float, ahead: float, left: float, turn: float, c: float, s: float,
    *, add: bool = False,
) -> None:  # fmt: skip
    """Set a noise that moves the robot `ahead` and `left` and turns it by `turn` per unit, fully correlated."""
    at, x, y = cause * SIZE, c * ahead - s * left, s * ahead + c * left
    xx, yy, hh = variance * x * x, variance * y * y, variance * turn * turn
    xy, xh, yh = variance * x * y, variance * x * turn, variance * y * turn
    if add:
        xx, yy, hh = xx + q[at + XX], yy + q[at + YY], hh + q[at + HH]
        xy, xh, yh = xy + q[at + XY], xh + q[at + XH], yh + q[at + YH]
    q[at + XX], q[at + YY], q[at + HH] = xx, yy, hh
    q[at + XY] = q[at + YX] = xy
    q[at + XH] = q[at + HX] = xh
    q[at + YH] = q[at + HY] = yh
