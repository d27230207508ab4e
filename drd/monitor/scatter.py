"""Scatter of the robot's constants from block to block, as caused by wheels that slip on the ground. (95)"""

import math
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.monitor.constants import KNOWN_SIGMAS
from drd.monitor.library import BIAS, CHANGE, OWN, TRAVEL, TURN

SPANS: Final = (1, 2, 4, 8)  # blocks; what wanders over longer is an effect
MOST_BLOCKS: Final = 200.0  # memory in blocks
FEWEST_ROWS: Final = 6  # of a block, that inform about a constant
# Which rows inform about which constant: all, those in motion, those that turn (least kind of RowNoise).
TOLD_BY: Final = ((0, (BIAS,)), (1, (TRAVEL,)), (2, (TURN, CHANGE)))
# Usual deviations: of the gyro's bias 2 deg/h, of the rest as from day to day.
USUAL: Final = np.array([1e-5, *(KNOWN_SIGMAS[c] for c in (TURN, TRAVEL, CHANGE))])
# Deviations that are compared: from invisible ones (rad/s, 1, 1, 10 ms) to 3,000 times as much.
LEAST: Final = np.array([1e-6, 1e-4, 1e-4, 1e-2])
STEPS: Final = 2.0 ** np.arange(0.0, 12.0, 0.5)
STEADY: Final = 0.5  # prior probability that a constant does not scatter
# Share of the differences that are due to the begin or end of an effect or ground, of any size. The scatter of wheels
# that skid comes in bursts, so that no difference is too large for it.
CHANGES: Final = np.full(OWN, 0.01)
CHANGES_SKIDDING: Final = np.where(np.arange(OWN) == BIAS, CHANGES, 0.0)
RANK: Final = 1e-9  # relative: a direction of less information is ignored


class Scatter:
    """`variances` (OWN,): those of the constants from block to block, columns BIAS, TURN, TRAVEL and CHANGE.

    `skids`: the robot's wheels slip sideways in each turn.
    """

    def __init__(self, skids: bool = False) -> None:
        # A wandering tread competes with the effects instead, (98), unless it is known to wander.
        self._whitens = np.where((np.arange(OWN) == TURN) & (not skids), 0.0, 1.0)
        self._changes = CHANGES_SKIDDING if skids else CHANGES
        self._grid = np.column_stack([np.zeros(OWN), LEAST[:, None] * STEPS]) ** 2
        likely = 1.0 / (1.0 + self._grid[:, 1:] / USUAL[:, None] ** 2) ** 2  # so that the variance has a mean
        likely *= (1.0 - STEADY) / likely.sum(1, keepdims=True)
        self._prior = np.log(np.column_stack([np.full(OWN, STEADY), likely]))
        self._nats = np.zeros((len(SPANS), OWN, len(STEPS) + 1))
        self._seen = np.zeros((len(TOLD_BY), len(SPANS)))
        self._information = np.zeros(OWN)  # mean over the blocks that inform
        self._told = np.zeros(len(TOLD_BY))
        self._pairs = [[_Pair(span) for span in SPANS] for _ in TOLD_BY]
        self.variances = self._mean()

    @property
    def raises(self) -> float:
        """Variance inflation, in a block in motion, of the constant that scatters most."""
        return 1.0 + float((self.variances * self._information)[[TURN, TRAVEL, CHANGE]].max())

    def white(self, products: Array) -> Array:
        """Whiten the products of a block's rows `(X y)`: their noise then includes this scatter."""
        sigma = np.sqrt(self.variances * self._whitens)
        own = sigma[:, None] * products[:OWN]
        return np.asarray(products - own.T @ np.linalg.solve(np.eye(OWN) + own[:, :OWN] * sigma, own))

    def learn(self, gram: Array, score: Array, rows: Array) -> None:
        """Add a block: products of its own columns (OWN, OWN), with the residuals (OWN,); rows of each kind."""
        for chain, (least, columns) in enumerate(TOLD_BY):
            if rows[least:].sum() < FEWEST_ROWS:
                continue
            self._told[chain] = min(self._told[chain] + 1.0, MOST_BLOCKS)
            at = list(columns)
            self._information[at] += (np.diagonal(gram)[at] - self._information[at]) / self._told[chain]
            for j, span in enumerate(SPANS):
                pair = self._pairs[chain][j].add(gram, score)
                if pair is None:
                    continue
                for c in columns:
                    self._compare(j, c, *pair)
                self._seen[chain, j] += 1.0
                if self._seen[chain, j] > MOST_BLOCKS / span:
                    self._seen[chain, j] *= 0.5
                    self._nats[j, columns] *= 0.5
        self.variances = self._mean()

    def _compare(self, j: int, c: int, information: Array, score: Array) -> None:
        """Update the likelihood of each deviation by the difference of a constant between two spans."""
        sigma = np.sqrt(2.0 * self.variances / SPANS[j])
        sigma[c] = 0.0
        beside = information * sigma
        k = np.linalg.solve(np.eye(OWN) + sigma[:, None] * beside, beside[c])
        own = float(information[c, c] - beside[c] @ k)
        if own <= RANK * information[c, c]:
            return
        square = float(score[c] - (sigma * score) @ k) ** 2 / own
        inflated = 1.0 + 2.0 / SPANS[j] * self._grid[c] * own
        scatters, changes = (-0.5 * (square / v + np.log(v)) for v in (inflated, inflated[-1]))
        p = float(self._changes[c])
        self._nats[j, c] += np.logaddexp(math.log(1.0 - p) + scatters, math.log(p) + changes) if p else scatters

    def _mean(self) -> Array:
        """Posterior mean; the largest of all spans, so that correlation over several blocks counts."""
        nats = self._nats + self._prior
        p = np.exp(nats - nats.max(-1, keepdims=True))
        return np.asarray(((p * self._grid).sum(-1) / p.sum(-1)).max(0))


class _Pair:
    """Sums over a span of blocks and over the one before."""

    def __init__(self, span: int) -> None:
        self._span, self._blocks = span, 0
        self._before = self._now = (np.zeros((OWN, OWN)), np.zeros(OWN))

    def add(self, gram: Array, score: Array) -> tuple[Array, Array] | None:
        """Add a block; returns information and score of the difference of two spans when one is full."""
        self._now = self._now[0] + gram, self._now[1] + score
        self._blocks += 1
        if self._blocks < self._span:
            return None
        (a, y), (b, z) = self._before, self._now
        self._before, self._now, self._blocks = self._now, (np.zeros((OWN, OWN)), np.zeros(OWN)), 0
        scale = 1.0 / np.sqrt(np.maximum(np.diagonal(a + b), np.finfo(float).tiny))
        unit = np.linalg.pinv((a + b) * scale[:, None] * scale, rcond=RANK, hermitian=True)
        k = a @ (scale[:, None] * unit * scale)
        return k @ b, y - k @ (y + z)
