"""Consistency: whether the errors are as large as the covariance claims."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import chdtri

from drd.arrays import Array
from drd.estimation.uncertainty import BOUND_SIGMAS
from drd_tools.evaluate.alignment import Alignment, turned_covariance
from drd_tools.evaluate.trajectory import Pairs, Reference, least_eigenvalues

PARTS: Final = {"pose": [0, 1, 2], "position": [0, 1], "heading": [2]}
LEVEL: Final = 0.99
LEAST_VARIANCE: Final = 1e-14  # (0.1 um)^2 or rad^2: a perfect reference, and an estimate that has not begun
LEAST_EIGENVALUE: Final = 1e-12  # of a correlation matrix: leaves four digits in the inverse
LATE: Final = 0.1  # share of the final variance: more than this at the first common time makes NEES a tenth too small
SIGMA_99: Final = math.sqrt(float(chdtri(1, 1.0 - LEVEL)))  # half the width of a Gaussian's 99 % interval


@dataclass(frozen=True)
class Nees:
    """Average normalised error squared of one part over `rows`, worth `effective` independent ones."""

    part: str
    dof: int
    rows: int
    effective: float
    average: float
    low: float
    high: float

    @property
    def verdict(self) -> str:
        """Verdict on the average, in a word or two."""
        if self.average > self.high:
            return "overconfident"
        return "too cautious" if self.average < self.low else "consistent"


@dataclass(frozen=True)
class Consistency:
    """Result of the consistency test; `why_not`: why there is no NEES. `inside_99`: share of rows within the claimed
    99 % radius. `before`: standard deviations claimed for position (worst axis, m) and heading (rad) at the first
    common time, where the alignment start removes all error; None if negligible.
    """

    nees: list[Nees]
    why_not: str = ""
    inside_99: float | None = None
    before: tuple[float, float] | None = None


def consistency(aligned: Pairs, alignment: Alignment, reference: Reference) -> Consistency:
    """NEES of pose, position and heading, and the share inside the 99 % radius.

    `e^T S^-1 e` with S the sum of the estimate's covariance and the reference's, `total_covariance`. It is meaningful
    only if the alignment did not use the errors tested: none and start. Rows in which S has no inverse are left out.
    """
    if alignment.kind not in ("none", "start"):
        why = f"not meaningful with the alignment {alignment.kind}, which fits the poses to the reference"
        return Consistency([], why)
    if aligned.covariance is None and aligned.bound_m is None:
        return Consistency([], "not determined: the poses have no covariance")
    inside = _inside(aligned, alignment, reference)
    S = total_covariance(aligned, alignment, reference)
    if S is None:
        return Consistency([], "not determined: the poses have no covariance", inside)
    found = []
    begin = 1 if alignment.kind == "start" else 0  # the first error is zero by definition
    for part, axes in PARTS.items():
        part_S = S[begin:, axes][:, :, axes]
        regular = _has_inverse(part_S)
        if regular.any():
            found.append(nees(part, aligned.error[begin:][regular][:, axes], part_S[regular]))
    why = "" if found else "not determined: the covariance is singular in every row"
    return Consistency(found, why, inside, _before(aligned) if begin else None)


def _before(aligned: Pairs) -> tuple[float, float] | None:
    """Standard deviations of `Consistency.before`."""
    assert aligned.covariance is not None
    (first_m2, first_rad2), (last_m2, last_rad2) = (
        (float(np.linalg.eigvalsh(P[:2, :2])[-1]), float(P[2, 2])) for P in aligned.covariance[[0, -1]]
    )
    if first_m2 <= LATE * last_m2 and first_rad2 <= LATE * last_rad2:
        return None
    return math.sqrt(max(first_m2, 0.0)), math.sqrt(max(first_rad2, 0.0))


def _has_inverse(S: Array) -> npt.NDArray[np.bool_]:
    """Whether covariances (k, d, d) have an inverse that is not lost in rounding, (k,)."""
    known: npt.NDArray[np.bool_] = np.all(np.diagonal(S, axis1=1, axis2=2) > LEAST_VARIANCE, axis=1)
    return known & (least_eigenvalues(S) > LEAST_EIGENVALUE)


def total_covariance(aligned: Pairs, alignment: Alignment, reference: Reference) -> Array | None:
    """Covariance of the error (k, 3, 3): `S = P + R + J R J^T`, R the reference's own, the same for each row.

    The last term is for the alignment start: the noise of the first reference pose rotates and shifts the whole
    estimate, with `J = [1 0 -(y - y_0); 0 1 x - x_0; 0 0 1]`. P counts from the first common time if the filter began
    there.
    """
    if aligned.covariance is None:
        return None
    R = np.diag([reference.position_sigma_m**2, reference.position_sigma_m**2, reference.heading_sigma_rad**2])
    if alignment.kind != "start":
        return aligned.covariance + R
    J = start_jacobian(aligned.estimate[:, :2] - aligned.estimate[0, :2])
    return np.asarray(aligned.covariance + R + J @ R @ J.transpose(0, 2, 1))


def start_jacobian(xy_m: Array) -> Array:
    """Jacobians (k, 3, 3) of poses at `xy_m` (k, 2), relative to the start, with respect to the start pose."""
    J = np.tile(np.eye(3), (len(xy_m), 1, 1))
    J[:, 0, 2], J[:, 1, 2] = -xy_m[:, 1], xy_m[:, 0]
    return J


def _inside(aligned: Pairs, alignment: Alignment, reference: Reference) -> float:
    """Share of rows whose position error is within the bound, enlarged by the reference's own worst axis."""
    k = len(aligned.time_s)
    extra = total_covariance(replace(aligned, covariance=np.zeros((k, 3, 3))), alignment, reference)
    assert extra is not None
    if aligned.bound_m is not None:
        worst = np.linalg.eigvalsh(extra[:, :2, :2])[:, -1]
        radius_m = np.hypot(aligned.bound_m, BOUND_SIGMAS * np.sqrt(np.maximum(worst, 0.0)))
    else:
        assert aligned.covariance is not None
        worst = np.linalg.eigvalsh((aligned.covariance + extra)[:, :2, :2])[:, -1]
        radius_m = BOUND_SIGMAS * np.sqrt(np.maximum(worst, 0.0))
    begin = 1 if alignment.kind == "start" else 0
    return float(np.mean((np.hypot(*aligned.error[:, :2].T) <= radius_m)[begin:]))


def nees(part: str, error: Array, S: Array) -> Nees:
    """Average of `e^T S^-1 e`, e (k, d), S (k, d, d), with the 99 % interval of a consistent estimate.

    Bar-Shalom, Li, Kirubarajan 2001, 5.4: the sum of n independent values is chi-square with n d degrees of freedom.
    Dead-reckoning errors are correlated over minutes, so n is the effective number from `effective_rows`.
    """
    z = np.linalg.solve(np.linalg.cholesky(S), error[:, :, None])[:, :, 0]
    n, dof = effective_rows(z), error.shape[1]
    return Nees(part, dof, len(z), n, float(np.mean(np.sum(z * z, axis=1))), *nees_interval(n, dof))


def nees_interval(n: float, dof: int, level: float = LEVEL) -> tuple[float, float]:
    """Interval that contains the mean of n independent values of `dof` degrees of freedom with probability `level`."""
    low, high = (chdtri(n * dof, beyond) / n for beyond in (0.5 + level / 2.0, 0.5 - level / 2.0))
    return float(low), float(high)


def effective_rows(z: Array) -> float:
    """Effective number of independent rows in the normalised errors `z` (k, d), from 1 to k.

    `n = k / (1 + 2 sum_l (1 - l/k) mean_i r_i(l)^2)`, r_i(l) the correlation of component i at lag l about zero, up to
    its first value <= 0 (Geyer 1992); squares of two Gaussians have correlation r^2. A common factor of three in all
    errors changes nothing, a constant bias gives n = 1. If a component's mean square v is below the claimed 1, the rest
    may be a constant that happened to be small in this run: r is then `v r + 1 - v`. So a single run hardly ever proves
    that an estimate is too cautious; several together can.
    """
    k = len(z)
    length = next_fast_len(2 * k, real=True)
    lags = np.arange(k)
    squares = np.zeros(k)
    for column in z.T:
        products = irfft(np.abs(rfft(column, length)) ** 2, length)[:k]
        power = float(products[0]) / k
        r = np.minimum(products / (k - lags) / power, 1.0) if power > 0.0 else np.ones(k)
        negative = np.flatnonzero(r <= 0.0)
        r[int(negative[0]) if negative.size else k :] = 0.0
        v = min(power, 1.0)
        squares += (v * r + 1.0 - v) ** 2 / z.shape[1]
    return k / (1.0 + 2.0 * float(np.sum((1.0 - lags[1:] / k) * squares[1:])))


def together(parts: Sequence[Nees]) -> Nees:
    """Combine one part over several independent runs: the mean of their averages.

    Runs have equal weight, whatever their effective rows n_i, which by chance are few if errors are large; N runs are
    worth `N^2 / sum(1/n_i)` rows.
    """
    dof, n = parts[0].dof, len(parts) ** 2 / sum(1.0 / p.effective for p in parts)
    average = sum(p.average for p in parts) / len(parts)
    return Nees(parts[0].part, dof, sum(p.rows for p in parts), n, average, *nees_interval(n, dof))


def track_sigmas(S: Array, heading_rad: Array) -> Array:
    """Standard deviations along and across the track (m) and of the heading (rad), shape (k, 3)."""
    turned = turned_covariance(S, -heading_rad)
    return np.asarray(np.sqrt(np.maximum(turned[:, range(3), range(3)], 0.0)))
