"""Covariance recursion of the bound: the filter's own F, Q and R along a known drive, for many cases at once. (61)

A case is a weight for each cause's noise and an initial covariance. Each case has its own optimal gains, which also
propagate the errors relative to later poses of the drive, and the shares of the groups of causes.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.estimation.noise import NoiseProfile
from drd.estimation.state import GYRO_HEADING, HEADING, Matrix, N, Sigmas, X, Y
from drd_tools.limit import causes
from drd_tools.limit.causes import CAUSES
from drd_tools.limit.drive import Block, Drive
from drd_tools.limit.process_noise import FilterByCause

# KITTI's segments: a tenth to eight tenths of the path long, with starts a tenth apart.
TENTHS: Final = 10
LONGEST: Final = 8
KNOWN: Final = Sigmas(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class ErrorModel(FilterByCause):
    """Filter as a source of F and of Q by cause, linearised along the true drive."""

    def __init__(self, drive: Drive, noise: NoiseProfile, sigmas: Sigmas):
        super().__init__(drive.tread_m, sigmas, noise, along_gyro=drive.gyro_hz > 0.0)
        self._drive = drive
        self._heading_rad = 0.0
        self.pose = [X, Y, self.pose_heading]

    def step(self, block: Block) -> None:
        """Set F and Q to those of a block. P is meaningless here."""
        half = 0.5 * block.turn_rad * self.nominal.tread_m
        distance_m = 0.5 * (block.left_m + block.right_m)
        left_m, right_m = (0.0, 0.0) if block.is_rest else (distance_m - half, distance_m + half)
        n = self.nominal
        n.heading_rad = n.gyro_heading_rad = self._heading_rad
        self.P.fill(0.0)
        self.predict(block.dt_s, left_m, right_m, block.turn_rad / block.dt_s if self._drive.gyro_hz else None)
        self._heading_rad += block.turn_rad

    def comparison(self, block: Block) -> Array:
        """Variance of the mean of a block's comparisons, by cause. (25)"""
        k, R = self.noise, np.zeros(len(CAUSES))
        comparisons = max(1.0, block.dt_s * self._drive.gyro_hz)
        rate = block.turn_rad / block.dt_s
        R[causes.COUNTS] = 2.0 * k.count_m2 / self.nominal.tread_m**2
        R[causes.COMPARISON] = max(k.comparison_rad2 - R[causes.COUNTS], 0.0)
        R[causes.TIMING] = k.timing_s2 * rate * rate
        return R / comparisons


@dataclass(frozen=True)
class Case:
    """Weights of the causes' variances (causes,), and the initial covariance (N, N)."""

    weights: Array
    P: Matrix


@dataclass(frozen=True)
class Spread:
    """Result of the recursion for each covariance e, with errors relative to its start.

    `position_m2`, `heading_rad2`: means over time, shape (e,); `end` (e, 3, 3); `drift` (e,): mean over the segments
    of the standard deviation per length; `by_length` (e, 8): the same by length of the segments, in tenths of the path.
    """

    position_m2: Array
    heading_rad2: Array
    end: Array
    drift: Array
    by_length: Array


def spreads(model: ErrorModel, drive: Drive, cases: list[Case], shares: list[Case]) -> tuple[Spread, Spread]:
    """Run the recursion for all cases, and for shares of the first one, whose weights and starts sum to its own."""
    batch = _Batch(model, cases, shares, drive.distance_m)
    distance_m = time_s = 0.0
    for block in drive.blocks:
        model.step(block)
        batch.predict(model._F, model.Q_causes)
        if drive.gyro_hz:
            batch.update(model.comparison(block))
        else:
            batch.anchor()
        distance_m, time_s = distance_m + 0.5 * abs(block.left_m + block.right_m), time_s + block.dt_s
        batch.watch(distance_m, block.dt_s)
    return batch.result(time_s, len(cases))


class _Batch:
    """Covariances of shape (cases and shares, starts, N, N): start 0 is the drive's own."""

    def __init__(self, model: ErrorModel, cases: list[Case], shares: list[Case], distance_m: float):
        every = [*cases, *shares]
        self._weights = np.array([case.weights for case in every])
        self._gain_of = np.array([*range(len(cases)), *([0] * len(shares))])
        starts = TENTHS - 1
        self.P = np.repeat(np.array([case.P for case in every])[:, None], starts, axis=1)
        self._pose, self._heading = model.pose, model.pose_heading
        self._tenth_m, self._passed = distance_m / TENTHS, 0
        self._position, self._heading2 = np.zeros(len(every)), np.zeros(len(every))
        self._drift, self._segments = np.zeros((len(every), LONGEST)), np.zeros(LONGEST)

    def predict(self, F: Matrix, Q: Matrix) -> None:
        """Predict over one block. (16)"""
        self._move(F)
        busy = np.flatnonzero(Q.any(axis=(1, 2)))
        self.P += np.tensordot(self._weights[:, busy], Q[busy], 1)[:, None]

    def update(self, R: Array) -> None:
        """Update each case with its own gain, shares and later starts with that of their case. (19), (58)"""
        P, R_each = self.P, self._weights @ R
        HP = P[..., HEADING, :] - P[..., GYRO_HEADING, :]
        HPH = HP[..., HEADING] - HP[..., GYRO_HEADING]
        S = HPH[:, 0] + R_each
        K = np.divide(HP[:, 0], S[:, None], out=np.zeros_like(HP[:, 0]), where=S[:, None] > 0.0)[self._gain_of]
        KHP = K[:, None, :, None] * HP[:, :, None, :]
        P -= KHP
        P -= KHP.swapaxes(-1, -2)
        P += (HPH + R_each[:, None])[..., None, None] * (K[:, :, None] * K[:, None, :])[:, None]

    def anchor(self) -> None:
        """Set the gyro's heading to the wheels', without a gyro. (35)"""
        self.P[..., GYRO_HEADING, :] = self.P[..., HEADING, :]
        self.P[..., :, GYRO_HEADING] = self.P[..., :, HEADING]

    def watch(self, distance_m: float, dt_s: float) -> None:
        """Add a block to the means over time and, at the end of a tenth of the path, to the segments."""
        diagonal = self.P[:, 0, self._pose, self._pose]
        self._position += (diagonal[:, 0] + diagonal[:, 1]) * dt_s
        self._heading2 += diagonal[:, 2] * dt_s
        tenth_m = self._tenth_m * (1.0 - 1e-9)
        while self._tenth_m and self._passed < TENTHS and distance_m >= (self._passed + 1) * tenth_m:
            self._passed += 1
            for start in range(max(0, self._passed - LONGEST), min(self._passed, self.P.shape[1])):
                variance, tenths = self.P[:, start, X, X] + self.P[:, start, Y, Y], self._passed - start
                self._drift[:, tenths - 1] += np.sqrt(np.maximum(variance, 0.0)) / (tenths * self._tenth_m)
                self._segments[tenths - 1] += 1.0
            if self._passed < self.P.shape[1]:
                self._rebase(self._passed)

    def _rebase(self, start: int) -> None:
        """Make errors of this start relative to the present pose. (59)"""
        T = np.eye(N)
        T[self._pose] = 0.0
        other = GYRO_HEADING if self._heading == HEADING else HEADING
        T[other, self._heading] = -1.0
        self.P[:, start] = T @ self.P[:, 0] @ T.T

    def _move(self, F: Matrix) -> None:
        shape = self.P.shape
        half = (self.P.reshape(-1, N) @ F.T).reshape(shape).swapaxes(-1, -2)
        self.P = (np.ascontiguousarray(half).reshape(-1, N) @ F.T).reshape(shape)

    def result(self, time_s: float, cases: int) -> tuple[Spread, Spread]:
        """Spreads of the cases, and of the shares."""
        end = self.P[:, 0][:, self._pose][:, :, self._pose]
        drift = self._drift.sum(axis=1) / max(self._segments.sum(), 1.0)
        by_length = self._drift / np.maximum(self._segments, 1.0)
        columns = (self._position / time_s, self._heading2 / time_s, end, drift, by_length)
        return Spread(*(c[:cases] for c in columns)), Spread(*(c[cases:] for c in columns))


def standing(model: ErrorModel, case: Case, gyro_hz: float, seconds: int) -> Matrix:
    """Initial covariance of a case after a longer standstill: the same for the pose, smaller for the bias. (63)"""
    drive = Drive([Block(1.0, 0.0, 0.0, 0.0)] * seconds, model.nominal.tread_m, gyro_hz, model.noise, 0.0)
    still = ErrorModel(drive, model.noise, KNOWN)
    batch = _Batch(still, [case], [], 0.0)
    for block in drive.blocks:
        still.step(block)
        batch.predict(still._F, still.Q_causes)
        batch.update(still.comparison(block))
    P: Matrix = np.array(batch.P[0, 0])
    for states in (model.pose, [HEADING, GYRO_HEADING]):
        P[states] = 0.0
        P[:, states] = 0.0
    P[X, X], P[Y, Y] = case.P[X, X], case.P[Y, Y]
    headings = np.ix_([HEADING, GYRO_HEADING], [HEADING, GYRO_HEADING])
    P[headings] = case.P[headings]
    return P
