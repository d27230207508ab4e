"""Covariances in files: upper triangles, and a test of whether a matrix is a covariance."""

from typing import Final

import numpy as np
import numpy.typing as npt

# Rounding, in computation or in a written file, makes a matrix slightly indefinite.
INDEFINITE = 1e-6

# Row and column of a pose's six numbers in its covariance.
UPPER: Final = np.triu_indices(3)


def of_upper(numbers: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Covariances (n, 3, 3) from their upper triangles, row by row, (n, 6)."""
    found = np.empty((len(numbers), 3, 3))
    found[:, *UPPER] = found[:, *UPPER[::-1]] = numbers
    return found


def unfit(P: npt.NDArray[np.float64]) -> tuple[str, str] | None:
    """Expected and got if finite `P` is no covariance; None if it is one: symmetric, positive semidefinite."""
    variances = np.diag(P)
    if variances.min() < 0.0:
        return "variances of at least 0 on the diagonal", f"{variances.min():g}"
    if P[variances == 0.0].any():
        return "no covariance where the variance is 0", "one"
    sigma = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    with np.errstate(all="ignore"):  # overflow and underflow of extreme values
        correlation = P / np.outer(sigma, sigma)
        skew = float(np.abs(correlation - correlation.T).max())
    if not skew < INDEFINITE:
        return "a symmetric matrix", f"correlations that differ by {skew:.2g}"
    lowest = float(np.linalg.eigvalsh(correlation)[0])
    if not lowest > -INDEFINITE:
        return "a positive semidefinite matrix", f"an eigenvalue of {lowest:.2g} of the correlation"
    return None
