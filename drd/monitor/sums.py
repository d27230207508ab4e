"""Sums of the rows' products since each moment, and the nuisance components in them. (96), (97)"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from drd.arrays import Array, cumulative
from drd.monitor.library import BIAS, CHANGE, TRAVEL, TURN
from drd.monitor.segments import Segment

LEAST_SHARE: Final = 1e-3  # of the most informative segment's information: with less, the noise is not observable
# Standard deviations for wheels that slip sideways in each turn, of tread times gyro scale, the radii's difference and
# the lag (in 10 ms), and of their random walks per sqrt(s); that of the initial bias, rad/s.
SKIDDING: Final = {TURN: 0.5, TRAVEL: 0.03, CHANGE: 10.0}
WANDERS: Final = {TURN: 0.02, TRAVEL: 0.005}
FIRST_BIAS_RAD_S: Final = 0.02
LEAST: Final = 1e-30


@dataclass(frozen=True)
class Component:
    """A nuisance of prior deviation `sigma`, in the segments from `begin` until before `end`.

    `weights`: weight of each column of the rows.
    """

    weights: Mapping[int, float]
    sigma: float
    begin: int
    end: int


class Sums:
    """Products of the rows from each segment's begin on, and their residuals after the components.

    `free` (segments + 1,): number of informative segments before each, and in all.
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        bias_walk: float,
        constants: Mapping[int, float],
        skids: bool,
        components: Sequence[Component],
        edges: Collection[int] = (),
    ):
        """`constants`: deviations of the constants from their calibration, for a robot that does not skid.

        `edges`: segments within which something begins or ends at an unknown time, and that are not used.
        """
        tells = np.array([i not in edges for i in range(len(segments))])
        self.each: Array = np.stack([s.products for s in segments]) * tells[:, None, None]
        self.begins_s = np.array([s.begin_s for s in segments])
        self.length_s = np.array([s.end_s - s.begin_s for s in segments])
        n = len(segments)
        self.rolled_m, self.turning_m = (
            np.array([getattr(s, name) for s in segments]) for name in ("rolled_m", "turning_m")
        )
        self.free: Array = cumulative(tells)
        self._components = [*_usual(self.begins_s, bias_walk, constants, skids), *components]
        self._fit(n)

    @staticmethod
    def since(each: Array) -> Array:
        """Sums over the segments from each one on; none after the last."""
        return np.concatenate([np.cumsum(each[::-1], 0)[::-1], np.zeros_like(each[:1])])

    def _fit(self, n: int) -> None:
        parts, s = self._components, np.arange(n + 1)
        sigma, begin, end = (np.array([getattr(p, name) for p in parts]) for name in ("sigma", "begin", "end"))
        used = sorted({c for p in parts for c in p.weights})
        weights = np.array([[p.weights.get(c, 0.0) for c in used] for p in parts])
        kinds, kind = np.unique(weights, axis=0, return_inverse=True)
        # numpy 2.0 has the inverse as a column, all others as a row.
        own, kind = np.tensordot(kinds, self.since(self.each[:, used]), (1, 1)), kind.reshape(-1, 1)
        # (components, onsets, columns): products with each column from each onset on.
        self.beside: Array = own[kind, np.maximum(s, begin[:, None])] - own[kind, np.maximum(s, end[:, None])]
        self.beside *= sigma[:, None, None]
        gram = np.eye(len(parts))
        for c, weight in zip(used, weights.T, strict=True):  # products over the segments that both have in common
            gram += (self.beside[:, begin, c] - self.beside[:, end, c]) * (weight * sigma)
        # numpy has no triangular solver, and there are few of them.
        self._whiten: Array = np.linalg.inv(np.linalg.cholesky(0.5 * (gram + gram.T)))
        self.vy: Array = self._whiten @ self.beside[:, 0, -1]
        self.coefficients: Array = self._whiten.T @ self.vy
        self.theta: Array = np.zeros((n, self.each.shape[1] - 1))
        for part, x in zip(parts, sigma * self.coefficients, strict=True):
            for c, w in part.weights.items():
                self.theta[part.begin : part.end, c] += w * x

    def constant(self, column: int) -> tuple[float, float]:
        """Value and deviation of the component that holds a column all along."""
        n = len(self.length_s)
        at = max(i for i, p in enumerate(self._components) if p.weights == {column: 1.0} and (p.begin, p.end) == (0, n))
        sigma = self._components[at].sigma
        return sigma * float(self.coefficients[at]), sigma * math.sqrt(float(self._whiten[:, at] @ self._whiten[:, at]))

    def whitened(self, columns: Array) -> Array:
        """Products with the components (m, ...), so that their squares are what the components explain."""
        return np.asarray((self._whiten @ columns.reshape(len(columns), -1)).reshape(columns.shape))

    def scatter(self) -> tuple[Array, Array]:
        """Sum of the segments' squared normalised scores by column, and number of informative segments. (97)"""
        scores = self.each[:, :-1, -1] - (self.each[:, :-1, :-1] @ self.theta[:, :, None])[:, :, 0]
        information = np.diagonal(self.each, axis1=1, axis2=2)[:, :-1]
        tells = information > np.maximum(LEAST_SHARE * information.max(0), LEAST)
        squares = np.where(tells, scores**2 / np.maximum(information, LEAST), 0.0)
        return squares.sum(0), tells.sum(0).astype(float)


def _usual(begins_s: Array, bias_walk: float, constants: Mapping[int, float], skids: bool) -> list[Component]:
    """The gyro's bias, with random walk `bias_walk` (rad/s/sqrt(s)), and the constants' calibration errors."""
    n = len(begins_s)
    found = [Component({BIAS: 1.0}, FIRST_BIAS_RAD_S, 0, n)]
    walks = {BIAS: bias_walk, **(WANDERS if skids else {})}
    roots = np.sqrt(np.diff(begins_s)).tolist()
    found += [Component({c: 1.0}, walk * root, i, n) for c, walk in walks.items() for i, root in enumerate(roots, 1)]
    return found + [Component({c: 1.0}, sigma, 0, n) for c, sigma in (SKIDDING if skids else constants).items()]
