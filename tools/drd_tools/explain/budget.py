"""A covariance for each cause, moved by the filter's own linear steps. The sum over the causes is the filter's P."""

from typing import Final

import numpy as np
import numpy.typing as npt

from drd.filter import GYRO_HEADING, HEADING, Matrix, N
from drd_tools.explain.causes import CAUSES
from drd_tools.explain.parts import Parts

COUNT: Final = len(CAUSES)
POSE: Final = slice(0, 3)  # x, y, heading in the error state


class Budget:
    """P_i of each cause, shape (causes, 9, 9), in the filter's units.

    `delay`: the error state, shape (9,), that a gyro which is late by a constant time brings; a mean, not a variance.
    `parts`: followed too where it is wanted, for what an actual error is due to.
    """

    def __init__(self, parts: Parts | None = None):
        self.P: Matrix = np.zeros((COUNT, N, N))
        self.delay: Matrix = np.zeros(N)
        self.parts = parts
        self._T: Matrix = np.zeros((COUNT, N, N))

    def predict(self, FT: Matrix, Q: Matrix, delay_rad: float) -> None:
        """`FT` (9, 9) is F transposed, `Q` (causes, 9, 9); `delay_rad`: what the delay adds to the gyro's heading."""
        self._move(FT)  # (47)
        self.P += Q
        self.delay[GYRO_HEADING] += delay_rad
        if self.parts is not None:
            self.parts.predict(FT, Q)

    def update(self, K: Matrix, R: npt.NDArray[np.float64], z: float) -> None:
        """`K` (9,) is the filter's own gain, `R` (causes,) the variance of the comparison `z` by cause. (47)"""
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
        """One heading continues from the other and shares its error. (24)"""
        FT = np.eye(N)
        FT[:, target] = FT[:, source]
        self._move(FT)
        if self.parts is not None:
            self.parts.move(FT)

    def forget(self, *states: int) -> None:
        """These states are known from elsewhere: their old errors are gone."""
        for i in states:
            self.P[:, i, :] = 0.0
            self.P[:, :, i] = 0.0
            self.delay[i] = 0.0
            if self.parts is not None:
                self.parts.forget(i)

    def add(self, cause: int, i: int, j: int, covariance: float) -> None:
        """An element of one cause's covariance grows."""
        self.P[cause, i, j] += covariance
        if self.parts is not None:
            self.parts.add(cause, i, j, covariance)

    def rebase(self) -> None:
        """From now on errors count from the pose of this moment. (48)"""
        FT = np.eye(N)
        FT[:, POSE] = 0.0
        FT[HEADING, GYRO_HEADING] = -1.0
        self._move(FT)
        if self.parts is not None:
            self.parts.move(FT)

    def _move(self, FT: Matrix) -> None:
        T, P = self._T, self.P
        half = (P.reshape(-1, N) @ FT).reshape(COUNT, N, N)
        np.copyto(T, half.transpose(0, 2, 1))  # F P: P is symmetric
        np.matmul(T.reshape(-1, N), FT, out=P.reshape(-1, N))
        self.delay = self.delay @ FT
