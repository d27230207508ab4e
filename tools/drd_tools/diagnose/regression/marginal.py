"""Marginal likelihood: white noise, and columns whose coefficients are integrated out. (74)"""

import numpy as np
import numpy.typing as npt

from drd.arrays import Array


class Marginal:
    """Data of covariance `I + N N'`: noise, and columns N (r, s) whose coefficients have the prior 1.

    Its inverse follows from `A = N'N + I`, (s, s), by Woodbury's identity: s columns are few, r rows many.
    """

    def __init__(self, columns: Array):
        self.columns = columns
        self.A: Array = columns.T @ columns + np.eye(columns.shape[1])

    def projected(self, rows: Array) -> Array:
        """The inverse covariance times rows (r, p)."""
        result: Array = rows - self.columns @ np.linalg.solve(self.A, self.columns.T @ rows)
        return result

    def beside(self, products: npt.NDArray[np.floating], own: Array, other: Array | None = None) -> Array:
        """Products `X'Y` (p, q) with N marginalised out; `own`: `N'X` (s, p), `other`: `N'Y`, if Y is not X."""
        return np.asarray(products - own.T @ np.linalg.solve(self.A, own if other is None else other), float)

    def nats(self, residual: Array) -> float:
        """Log likelihood of a residual (r,), up to a constant."""
        square = float(residual @ self.projected(residual))
        return -0.5 * square - 0.5 * float(np.linalg.slogdet(self.A)[1])
