"""One filter cycle (two predictions, one update, feedback) of drd.estimation.filter against FilterPy's KalmanFilter."""

import dataclasses
import math
from itertools import repeat
from typing import Any, Final

import numpy as np
from filterpy.kalman import KalmanFilter

from bench.report import Figure, Refused, Report
from bench.timing import compare
from drd.config.keys import Noise
from drd.estimation.filter import Filter, Outcome
from drd.estimation.noise import make_noise
from drd.estimation.state import BB, DD, GYRO_BIAS, GYRO_HEADING, HEADING, TREAD, Matrix, N, Nominal, Sigmas

TREAD_M: Final = 0.6
STEP_S: Final = 0.05
LEFT_M, RIGHT_M, RATE_RAD_S = 0.02, 0.03, 0.335
SIGMAS: Final = Sigmas(
    position_m=0.02,
    heading_rad=0.01,
    wheel_scale=0.003,
    tread_m=0.006,
    gyro_scale=0.004,
    gyro_bias_rad_s=2e-4,
    wheel_lag_s=0.02,
)
# With every state in play, so that what both compute is compared in all of them.
LAG_S: Final = 0.3  # far from 0, below which the filter does not let it fall, and FilterPy would
CHECKED_SIGMAS: Final = dataclasses.replace(SIGMAS, slip_s=0.1)
CYCLES_PER_PAIR: Final = 200
CHECKED_CYCLES: Final = 200
TOLERANCE: Final = 1e-9


def run(quick: bool) -> Report:
    """Compare; raises Refused where the two filters do not compute the same."""
    _check_agreement()
    ours, theirs, bare = _Drd(), _FilterPy(), _BareFilterPy()
    pairs = 10 if quick else 200
    whole = compare(ours.cycles, theirs.cycles, pairs)
    constant = compare(ours.cycles, bare.cycles, pairs)
    us = 1e6 / CYCLES_PER_PAIR
    return Report(
        "filter: two predictions, one update with gate, feedback; 11 states",
        "how many times longer FilterPy takes; 'bare' gets constant matrices free and feeds nothing back",
        (
            Figure("drd, whole cycle", whole.first_s * us, "us"),
            Figure("FilterPy, the same cycle", whole.second_s * us, "us", whole.ratio),
            Figure("FilterPy, bare predict and update", constant.second_s * us, "us", constant.ratio),
        ),
    )


def _filter(kind: type[Filter], sigmas: Sigmas) -> Any:
    return kind(TREAD_M, sigmas, make_noise("physical", Noise(), TREAD_M))


class _Drd:
    """The daemon's filter."""

    def __init__(self, sigmas: Sigmas = SIGMAS) -> None:
        self.kf: Filter = _filter(Filter, sigmas)
        self.kf.nominal.wheel_lag_s = LAG_S

    def cycles(self) -> None:
        kf = self.kf
        kf.restart(TREAD_M, SIGMAS)
        kf.nominal.wheel_lag_s = LAG_S
        for _ in repeat(None, CYCLES_PER_PAIR):
            kf.predict(STEP_S, LEFT_M, RIGHT_M, RATE_RAD_S)
            kf.predict(STEP_S, LEFT_M, RIGHT_M, RATE_RAD_S)
            outcome = kf.update(RATE_RAD_S)
        if outcome is not Outcome.ACCEPTED:
            raise Refused("filter: the gate closed, and a rejected update is no whole cycle")


class _Propagation(Filter):
    """drd's own propagation of the nominal, F and Q without the covariance's products.

    FilterPy's steps are charged for all this does, since F and Q depend on the motion.
    """

    def _propagate(self) -> None:
        pass

    @property
    def transition(self) -> Matrix:
        """F of the last step."""
        return self._F

    @property
    def step_noise(self) -> Matrix:
        """Q of the last step."""
        return self._Q

    def know(self, P: Matrix) -> None:
        """Take over what F and Q depend on of the covariance."""
        self._p[DD], self._p[BB] = P[TREAD, TREAD], P[GYRO_BIAS, GYRO_BIAS]


class _FilterPy:
    """FilterPy doing all that drd's filter does, except for the gate."""

    def __init__(self, sigmas: Sigmas = SIGMAS) -> None:
        self.sigmas = sigmas
        self.motion: _Propagation = _filter(_Propagation, sigmas)
        self.noise = make_noise("physical", Noise(), TREAD_M)
        self.kf: Any = KalmanFilter(dim_x=N, dim_z=1)
        self.kf.F, self.kf.Q = self.motion.transition, self.motion.step_noise
        self.kf.H[0, HEADING], self.kf.H[0, GYRO_HEADING] = 1.0, -1.0
        self.z: Matrix = np.zeros((1, 1))
        self.restart()

    def restart(self) -> None:
        self.motion.restart(TREAD_M, self.sigmas)
        self.motion.nominal.wheel_lag_s = LAG_S
        self.kf.P, self.kf.x = self.motion.P.copy(), np.zeros((N, 1))

    def predict(self, dt_s: float, left_m: float, right_m: float, rate_rad_s: float) -> None:
        self.motion.know(self.kf.P)
        self.motion.predict(dt_s, left_m, right_m, rate_rad_s)
        self.kf.predict()

    def update(self, rate_rad_s: float) -> None:
        kf, n, k = self.kf, self.motion.nominal, self.noise
        self.z[0, 0] = n.heading_rad - n.gyro_heading_rad
        kf.R[0, 0] = k.comparison_rad2 + k.timing_s2 * rate_rad_s * rate_rad_s
        kf.update(self.z)
        # Sideways slip, the last, is never corrected.
        x, y, heading, scale_right, scale_left, tread, gyro_heading, gyro_scale, gyro_bias, lag, _ = (
            kf.x.ravel().tolist()
        )
        n.x_m -= x
        n.y_m -= y
        n.heading_rad -= heading
        n.scale_right += scale_right
        n.scale_left += scale_left
        n.tread_m -= tread
        n.gyro_heading_rad -= gyro_heading
        n.gyro_scale -= gyro_scale
        n.gyro_bias_rad_s -= gyro_bias
        n.wheel_lag_s -= lag
        kf.x.fill(0.0)

    def cycles(self) -> None:
        self.restart()
        for _ in repeat(None, CYCLES_PER_PAIR):
            self.predict(STEP_S, LEFT_M, RIGHT_M, RATE_RAD_S)
            self.predict(STEP_S, LEFT_M, RIGHT_M, RATE_RAD_S)
            self.update(RATE_RAD_S)


class _BareFilterPy:
    """FilterPy with the matrices of one step for all, and no feedback: less than the job."""

    def __init__(self) -> None:
        whole = _FilterPy()
        whole.predict(STEP_S, LEFT_M, RIGHT_M, RATE_RAD_S)
        whole.update(RATE_RAD_S)
        self.kf: Any = whole.kf
        self.kf.F, self.kf.Q = self.kf.F.copy(), self.kf.Q.copy()
        self.start_P: Matrix = self.kf.P.copy()
        self.z: Matrix = whole.z

    def cycles(self) -> None:
        kf, z = self.kf, self.z
        kf.P, kf.x = self.start_P.copy(), np.zeros((N, 1))
        for _ in repeat(None, CYCLES_PER_PAIR):
            kf.predict()
            kf.predict()
            kf.update(z)


def _check_agreement() -> None:
    """Both compute the same covariance and the same corrections on a winding path. Raises Refused."""
    ours, theirs = _Drd(CHECKED_SIGMAS).kf, _FilterPy(CHECKED_SIGMAS)
    errors = []
    for i in range(1, CHECKED_CYCLES):
        rate, travel_m = 0.5 * math.sin(0.1 * i), 0.05 * math.cos(0.03 * i)
        turn_m = 0.5 * TREAD_M * rate * STEP_S + 1e-4 * math.sin(i)
        for _ in range(2):
            ours.predict(STEP_S, travel_m - turn_m, travel_m + turn_m, rate)
            theirs.predict(STEP_S, travel_m - turn_m, travel_m + turn_m, rate)
        before = _states(ours.nominal), _states(theirs.motion.nominal)
        if ours.update(rate) is not Outcome.ACCEPTED:
            raise Refused("filter: an update of the check was not accepted")
        theirs.update(rate)
        # Every state in units of its own standard deviation.
        sigma = np.sqrt(np.diag(ours.P))
        correction = (_states(ours.nominal) - before[0]) / sigma
        correction_error = (_states(theirs.motion.nominal) - before[1]) / sigma - correction
        covariance_error = np.abs(ours.P - theirs.kf.P) / np.outer(sigma, sigma)
        errors += [np.max(np.abs(correction_error)) / np.max(np.abs(correction)), np.max(covariance_error)]
    worst = np.max(errors)  # NaN if one is
    if not worst < TOLERANCE:
        raise Refused(f"filter: drd and FilterPy differ by {worst:.1e} of a standard deviation")


def _states(nominal: Nominal) -> Matrix:
    """The quantities that the error state stands for, in its order."""
    n = nominal
    heading, gyro = (n.heading_rad, n.scale_right, n.scale_left, n.tread_m), (n.gyro_heading_rad, n.gyro_scale)
    return np.array((n.x_m, n.y_m, *heading, *gyro, n.gyro_bias_rad_s, n.wheel_lag_s, n.slip_s))
