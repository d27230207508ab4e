"""Covariance by cause, propagated by the filter's own linear steps. The sum over the causes is the filter's P."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.estimation.state import GYRO_HEADING, HEADING, WHEEL_LAG, Matrix, N, X, Y
from drd_tools.explain.parts import Parts
from drd_tools.limit.causes import CAUSES

COUNT: Final = len(CAUSES)


class Budget:
    """P_i of each cause, shape (causes, N, N), in the filter's units.

    `delay`: error state, shape (N,), due to a gyro with a constant delay; a mean, not a variance. `parts`: propagated
    as well, if given, to attribute an actual error.
    """

    def __init__(self, parts: Parts | None = None):
        self.P: Matrix = np.zeros((COUNT, N, N))
        self.delay: Matrix = np.zeros(N)
        self.parts = parts
        self._T: Matrix = np.zeros((COUNT, N, N))

    def predict(self, FT: Matrix, Q: Matrix, delay_rad: float) -> None:
        """Predict. `FT` (N, N) is F transposed, `Q` (causes, N, N); `delay_rad`: heading error due to the delay."""
        self._move(FT)  # (58)
        self.P += Q
        self.delay[GYRO_HEADING] += delay_rad
        if self.parts is not None:
            self.parts.predict(FT, Q)

    def update(self, K: Matrix, R: npt.NDArray[np.float64], z: float) -> None:
        """Update by a comparison `z`: `K` (N,) is the filter's own gain, `R` (causes,) its variance by cause. (58)"""
        P = self.P
        HP = P[:, HEADING] - P[:, GYRO_HEADING]
        HPH = HP[:, HEADING] - HP[:, GYRO_HEADING]
        KHP = K[None, :, None] * HP[:, None, :]
        P -= KHP
        P -= KHP.transpose(0, 2, 1)
        P += (HPH + R)[:, None, None] * np.outer(K, K)
        self.delay -= K * (self.delay[HEADING] - self.delay[GYRO_HEADING])
        if self.parts is not None:
            self.parts.update(K, R, z)

    def copy_error(self, source: int, target: int) -> None:
        """Let one heading continue from the other and share its error. (35)"""
        FT = np.eye(N)
        FT[:, target] = FT[:, source]
        self._step(FT)

    def spread_error(self, source: int, shares: Mapping[int, float]) -> None:
        """Add to each state's error its share of that of `source`; the share of `source` is what it keeps."""
        FT = np.eye(N)
        for i, share in shares.items():
            FT[source, i] = share
        self._step(FT)

    def forget(self, *states: int) -> None:
        """Drop the old errors of states set from elsewhere."""
        for i in states:
            self.P[:, i, :] = 0.0
            self.P[:, :, i] = 0.0
            self.delay[i] = 0.0
            if self.parts is not None:
                self.parts.forget(i)

    def add(self, cause: int, i: int, j: int, covariance: float) -> None:
        """Add to an element of one cause's covariance."""
        self.P[cause, i, j] += covariance
        if self.parts is not None:
            self.parts.add(cause, i, j, covariance)

    def add_matrix(self, cause: int, covariance: Matrix | float, states: Sequence[int] = range(N)) -> None:
        """Add `covariance`, (k, k) or one value throughout, to one cause's covariance of some states."""
        block = np.broadcast_to(covariance, (len(states), len(states)))
        for a, b in np.argwhere(block):
            self.add(cause, states[a], states[b], float(block[a, b]))

    def rebase(self, pose_heading: int, velocity: Matrix) -> None:
        """Make errors relative to the pose published now. (59)

        `velocity` (3,): that of x, y and heading; times the lag, it is the lead of the published pose. (30)
        """
        FT = np.eye(N)
        other = GYRO_HEADING if pose_heading == HEADING else HEADING
        FT[:, [X, Y, pose_heading]] = 0.0
        FT[pose_heading, other] = -1.0
        FT[WHEEL_LAG, [X, Y, pose_heading]] = -velocity
        FT[WHEEL_LAG, other] = -velocity[2]
        self._step(FT)

    def _step(self, FT: Matrix) -> None:
        self._move(FT)
        if self.parts is not None:
            self.parts.move(FT)

    def _move(self, FT: Matrix) -> None:
        T, P = self._T, self.P
        half = (P.reshape(-1, N) @ FT).reshape(COUNT, N, N)
        np.copyto(T, half.transpose(0, 2, 1))  # F P: P is symmetric
        np.matmul(T.reshape(-1, N), FT, out=P.reshape(-1, N))
        self.delay = self.delay @ FT
