"""The noise of the rows, learned on the way: of a single one, and how they hang together over seconds. (95)"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.monitor.library import BIAS, OWN, TURN

Kinds = npt.NDArray[np.integer]
Flags = npt.NDArray[np.bool_]

KINDS: Final = 3  # at rest, ahead, turning
TAIL_SIGMAS: Final = 3.0  # rows beyond count as if they were here: slip comes in bursts
SHEET_ROWS: Final = 30.0  # what a data sheet's noise weighs
MOST_ROWS: Final = 600.0  # so many rows are remembered: a minute's
SHEET_BLOCKS: Final = 8.0  # what it weighs that rows are independent
MOST_BLOCKS: Final = 200.0
# A tread whose steps are by so many deviations above what the rows' noise makes wanders: it is looked at in each block.
WANDERS_SIGMAS: Final = 5.0
SPANS: Final = (1, 2, 4)  # blocks; what wanders over longer is an effect
UNFIT: Final = 10.0  # times the stated variance, with what has been allowed for slip
FEWEST_ROWS: Final = 6  # of a kind in a block
COMPARED: Final = (BIAS, TURN)
TURNS: Final = COMPARED.index(TURN)


class RowNoise:
    """`scale` (KINDS,): variance of a row over that of the data sheets. `together` (KINDS,): over a block, besides."""

    def __init__(self) -> None:
        self.scale, self._rows = np.ones(KINDS), np.full(KINDS, SHEET_ROWS)
        shape = (KINDS, 2, len(SPANS))
        self._squares, self._blocks, self._largest = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self._sums: list[list[list[_Pair]]] = [[[_Pair() for _ in SPANS] for _ in range(2)] for _ in range(KINDS)]

    @property
    def together(self) -> Array:
        """Inflation where spans one after the other differ by more than their rows say: Allan's variance. (78)

        The largest difference of each is not counted: what changes once is no noise.
        """
        counted = np.maximum(self._blocks - 1.0, 0.0)
        ratio = (SHEET_BLOCKS + self._squares - self._largest) / (SHEET_BLOCKS + counted)
        return np.asarray(np.maximum(ratio.max((1, 2)), 1.0))

    @property
    def at_rest(self) -> float:
        """The gyro's noise over that of its data sheet, at least 1: its bias then walks by so much more, too."""
        return math.sqrt(max(1.0, float(self.scale[0] * self.together[0])))

    @property
    def tread_wanders(self) -> bool:
        """Whether the effective tread changes all the time, as that of wheels that slip sideways does. (33)"""
        turning = KINDS - 1, TURNS
        counted = np.maximum(self._blocks[turning] - 1.0, 1.0)
        excess = self._squares[turning] - self._largest[turning] - counted
        return bool((excess > WANDERS_SIGMAS * np.sqrt(2.0 * counted)).any())

    @property
    def is_fit(self) -> bool:
        """Whether the robot, while it moves, is the one that its configuration states: else no name means anything."""
        return float((self.scale * self.together)[1:].max()) < UNFIT

    def weights(self, x: Array, rest: Array, variance: Array, kind: Kinds, good: Flags) -> Array:
        """One over the variance of each row, (n,), but for outliers; learns from them.

        `x` (n, columns), `rest` (n,): what the model leaves of the data; `variance`: by the data sheets.
        """
        sigma = np.sqrt(variance * self.scale[kind])
        w = good / sigma
        # A slow error is no outlier: a few columns of this block alone take it off.
        own = x[:, :OWN] * w[:, None]
        gram = own.T @ own
        ridge = 1e-3 * np.diag(np.diagonal(gram)) + 1e-12 * np.eye(OWN)
        r = rest * w - own @ np.linalg.solve(gram + ridge, own.T @ (rest * w))
        weight = np.minimum(1.0, (TAIL_SIGMAS / np.maximum(np.abs(r), 1e-9)) ** 2)
        found = good * weight / (sigma**2 * self.together[kind])
        for k in range(KINDS):
            mine = good & (kind == k)
            n = float(mine.sum())
            if n < FEWEST_ROWS:
                continue
            now = float((weight * r * r)[mine].sum()) / (n - 0.5 * OWN)
            weighs = self._rows[k]
            self.scale[k] *= (weighs + now * n) / (weighs + n)
            self._rows[k] = min(weighs + n, MOST_ROWS)
            self._compare(k, x[mine], rest[mine], (weight / sigma**2)[mine])
        return np.asarray(found)

    def _compare(self, kind: int, x: Array, rest: Array, w: Array) -> None:
        """Bias and turn of a span with those of the one before."""
        for i, column in enumerate(COMPARED):
            score, information = float(w @ (x[:, column] * rest)), float(w @ x[:, column] ** 2)
            if information <= 0.0:
                continue
            for j, span in enumerate(SPANS):
                square = self._sums[kind][i][j].add(span, score, information)
                if square is None:
                    continue
                at = kind, i, j
                self._squares[at] += square
                self._blocks[at] += 1.0
                self._largest[at] = max(self._largest[at], square)
                if self._blocks[at] > MOST_BLOCKS / span:
                    self._squares[at] *= 0.5
                    self._blocks[at] *= 0.5
                    self._largest[at] *= 0.5


class _Pair:
    """Sums of a span of blocks beside those of the one before."""

    def __init__(self) -> None:
        self._before = self._now = (0.0, 0.0)
        self._blocks = 0

    def add(self, span: int, score: float, information: float) -> float | None:
        """A block; the square of how two spans differ, over its variance, when one is full."""
        self._now = self._now[0] + score, self._now[1] + information
        self._blocks += 1
        if self._blocks < span:
            return None
        (a, i), (b, j) = self._before, self._now
        self._before, self._now, self._blocks = self._now, (0.0, 0.0), 0
        return None if i <= 0.0 else (a / i - b / j) ** 2 / (1.0 / i + 1.0 / j)
