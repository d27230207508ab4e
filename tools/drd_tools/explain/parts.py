"""Most likely part of each group of causes in the error state, given the comparisons of the two headings.

The filter knows only the sum of all errors. If the headings differ, some cause must be responsible, and its share of
that determines its share of the pose error: so the parts are propagated jointly, with their covariances.
"""

from typing import Final

import numpy as np

from drd.arrays import Array
from drd.estimation.state import GYRO_HEADING, HEADING, Matrix, N
from drd_tools.limit.causes import CAUSES, GROUPS

COUNT: Final = len(GROUPS)
FIRST: Final = [[cause.group for cause in CAUSES].index(group) for group in GROUPS]  # causes of a group are neighbours
GROUP_OF: Final = [GROUPS.index(cause.group) for cause in CAUSES]


class Parts:
    """Mean of each group's part of the error state, shape (groups, N), and the joint covariance of all.

    `kept_mean` (n, groups, 3) and `kept_covariance` (3 n groups, 3 n groups) are those of the kept poses.
    """

    def __init__(self) -> None:
        self.mean: Matrix = np.zeros((COUNT, N))
        self.covariance: Matrix = np.zeros((COUNT * N, COUNT * N))
        self.kept_mean: Matrix = np.zeros((0, COUNT, 3))
        self.kept_covariance: Matrix = np.zeros((0, 0))
        self._kept: Matrix = np.zeros((0, COUNT * N))  # covariance of the kept parts with the present ones

    def predict(self, FT: Matrix, Q: Matrix) -> None:
        """Predict: `FT` (N, N), `Q` (causes, N, N). (60)"""
        self.move(FT)
        self._add_blocks(np.add.reduceat(Q, FIRST, axis=0))

    def update(self, K: Array, R: Array, z: float) -> None:
        """Update by an accepted comparison z, which is fed back with the gain `K` (N,) and observes the parts. (60)"""
        R = np.add.reduceat(R, FIRST)
        MT = np.eye(N)
        MT[HEADING] -= K
        MT[GYRO_HEADING] += K
        blocks = self.covariance.reshape(COUNT, N, COUNT, N)
        PH = (blocks[..., HEADING] - blocks[..., GYRO_HEADING]).sum(axis=2)
        kept_PH = (self._kept.reshape(-1, COUNT, N) @ _H).sum(axis=1)
        total = self.mean.sum(axis=0)
        S = float(np.sum(PH @ _H) + R.sum())
        gain = (PH @ MT - R[:, None] * K) / S
        surprise = z - float(total @ _H)
        self.move(MT)
        self._add_blocks(R[:, None, None] * np.outer(K, K))
        self.mean += gain * surprise
        self.kept_mean += (kept_PH * (surprise / S)).reshape(self.kept_mean.shape)
        flat = gain.ravel()
        self.covariance -= np.outer(S * flat, flat)
        self._kept -= np.outer(kept_PH, flat)
        self.kept_covariance -= np.outer(kept_PH / S, kept_PH)

    def move(self, FT: Matrix) -> None:
        """Apply the same linear step to every part."""
        size = COUNT * N
        half = (self.covariance.reshape(-1, N) @ FT).reshape(size, size)
        self.covariance = (np.ascontiguousarray(half.T).reshape(-1, N) @ FT).reshape(size, size)
        self._kept = (self._kept.reshape(-1, N) @ FT).reshape(self._kept.shape)
        self.mean = self.mean @ FT

    def forget(self, i: int) -> None:
        """Drop the errors of a state set from elsewhere."""
        for columns in (self.covariance, self.covariance.T, self._kept, self.mean):
            columns[:, i::N] = 0.0

    def add(self, cause: int, i: int, j: int, covariance: float) -> None:
        """Add to an element of one cause's covariance."""
        at = GROUP_OF[cause] * N
        self.covariance[at + i, at + j] += covariance

    def keep(self, J: Matrix) -> None:
        """Keep the parts of the present pose; `J` (3, N): Jacobian of its error with respect to the error state."""
        picked = np.kron(np.eye(COUNT), J)
        now, old = picked @ self.covariance, self._kept @ picked.T
        self.kept_covariance = np.block([[self.kept_covariance, old], [old.T, now @ picked.T]])
        self.kept_mean = np.concatenate([self.kept_mean, (self.mean @ J.T)[None]])
        self._kept = np.concatenate([self._kept, now])

    def _add_blocks(self, blocks: Array) -> None:
        groups = np.arange(COUNT)
        self.covariance.reshape(COUNT, N, COUNT, N)[groups, :, groups, :] += blocks


_H: Final = np.zeros(N)
_H[HEADING], _H[GYRO_HEADING] = 1.0, -1.0
