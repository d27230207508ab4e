"""The noise of the rows, learned while driving. (95)"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.monitor.library import BIAS, OWN
from drd.monitor.scatter import Scatter

Kinds = npt.NDArray[np.integer]
Flags = npt.NDArray[np.bool_]

KINDS: Final = 3  # at rest, ahead, turning
TAIL_SIGMAS: Final = 3.0  # rows beyond are limited to this: slip comes in bursts
SHEET_ROWS: Final = 30.0  # weight of a datasheet's noise
MOST_ROWS: Final = 600.0  # memory in rows: a minute's
UNFIT: Final = 10.0  # times the stated variance, including the allowance for slip
FEWEST_ROWS: Final = 6  # of a kind in a block


class RowNoise:
    """`scale` (KINDS,): variance of a row over that of the datasheets. `scatter`: that of the constants.

    `skids`: the robot's wheels slip sideways in each turn. `before`: the same robot's noise under another assumption
    on its wheels, which have no influence at rest.
    """

    def __init__(self, skids: bool = False, before: "RowNoise | None" = None) -> None:
        self.scale, self._rows = np.ones(KINDS), np.full(KINDS, SHEET_ROWS)
        if before is not None:
            self.scale[0], self._rows[0] = before.scale[0], before._rows[0]
        self.scatter = Scatter(skids)

    @property
    def at_rest(self) -> float:
        """The gyro's noise over that of its datasheet, at least 1; its bias walks by as much more."""
        return math.sqrt(max(1.0, float(self.scale[0])))

    @property
    def is_fit(self) -> bool:
        """Whether the moving robot fits its configuration: else no name means anything."""
        return float(self.scale[1:].max()) * self.scatter.raises < UNFIT

    def weights(self, x: Array, rest: Array, variance: Array, kind: Kinds, good: Flags) -> Array:
        """Weights of the rows, (n,): inverse variances, smaller for outliers; learns from the rows.

        `x` (n, columns), `rest` (n,): residuals of the model; `variance`: by the datasheets.
        """
        sigma = np.sqrt(variance * self.scale[kind])
        w = good / sigma
        # A slow error is no outlier: a fit of a few columns to this block removes it.
        own = x[:, :OWN] * w[:, None]
        gram = own.T @ own
        ridge = 1e-3 * np.diagonal(gram) + 1e-12
        # In a short stop one row alone may determine the bias: a prior of no change weighs as much as one row.
        ridge[BIAS] = np.square(own[:, BIAS]).max() + 1e-12
        fit = np.linalg.solve(gram + np.diag(ridge), own.T)
        r = rest * w - own @ (fit @ (rest * w))
        # A row that nearly determines a column, as one that turns, draws the fit: its leverage scales its residual.
        left = np.sqrt(1.0 - (own * fit.T).sum(1))
        weight = np.minimum(1.0, (TAIL_SIGMAS * left / np.maximum(np.abs(r), 1e-9)) ** 2)
        found = good * weight / sigma**2
        for k in range(KINDS):
            mine = good & (kind == k)
            n = float(mine.sum())
            if n < FEWEST_ROWS:
                continue
            now = float((weight * r * r)[mine].sum()) / (n - 0.5 * OWN)
            weighs = self._rows[k]
            self.scale[k] *= (weighs + now * n) / (weighs + n)
            self._rows[k] = min(weighs + n, MOST_ROWS)
        return np.asarray(found)
