"""Attribute an actual error to its most likely causes: the conditional mean of each cause's part, given the error."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import chdtrc  # importing scipy.stats takes 0.4 s

from drd.arrays import Array
from drd_tools.evaluate.consistency import start_jacobian

INSEPARABLE: Final = -0.7  # correlation
REGULAR: Final = 1e-10  # smaller eigenvalues of a correlation matrix are rounding


@dataclass(frozen=True)
class Attribution:
    """Parts of the last pose's error. With g groups, the reference's own noise being the last of them:

    `mean` (g, 3): the parts of x, y, heading, which sum to the error; `covariance` (g, g, 3, 3): that of part i with
    part j. `chi2` of the whole error with `dof` degrees of freedom, and `p`, the probability of one as large.
    """

    mean: Array
    covariance: Array
    chi2: float
    dof: int
    p: float


def attribute(mean: Array, covariance: Array, own: Array, error: Array) -> Attribution:
    """Attribute the error to the groups. (60)

    `mean` (m, g - 1, 3) and `covariance` (3 m (g - 1), 3 m (g - 1)): those of the groups' parts in m poses, given the
    filter's comparisons; `own` (3 m, 3 m): that of the reference; `error` (3 m,). If their sum is singular, only
    directions in which an error is expected at all count.
    """
    m, groups = mean.shape[:2]
    blocks = covariance.reshape(m, groups, 3, m, groups, 3)
    S = blocks.sum(axis=(1, 4)).reshape(3 * m, 3 * m) + own
    inverse, dof = _inverse(S)
    surprise = error - mean.sum(axis=1).ravel()
    last = np.zeros((groups + 1, 3, 3 * m))  # covariance of the last pose's parts with the whole error
    last[:-1] = blocks[-1].sum(axis=3).reshape(groups, 3, 3 * m)
    last[-1] = own[-3:]
    gain = last @ inverse
    parts = gain @ surprise
    parts[:-1] += mean[-1]
    after = -np.einsum("gij,hkj->ghik", gain, last)
    after[:-1, :-1] += blocks[-1, :, :, -1].transpose(0, 2, 1, 3)
    after[-1, -1] += own[-3:, -3:]
    chi2 = float(surprise @ inverse @ surprise)
    return Attribution(parts, after, chi2, dof, float(chdtrc(dof, chi2)) if dof else 1.0)


def _inverse(S: Array) -> tuple[Array, int]:
    """Pseudo-inverse, computed from the correlation matrix, and rank."""
    sigma = np.sqrt(np.maximum(np.diag(S), 0.0))
    scale = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0.0)
    values, vectors = np.linalg.eigh(S * np.outer(scale, scale))
    good = values > REGULAR
    inverse: Array = (vectors[:, good] / values[good]) @ vectors[:, good].T * np.outer(scale, scale)
    return inverse, int(good.sum())


def along(attribution: Attribution, direction: Array) -> tuple[Array, Array]:
    """Part of each group along a unit vector (3,) of the pose: values and their covariance, (g,), (g, g)."""
    covariance = np.einsum("ghij,i,j->gh", attribution.covariance, direction, direction)
    return attribution.mean @ direction, covariance


def reference_joint(xy_m: Array, position_sigma_m: float, heading_sigma_rad: float) -> Array:
    """Covariance of the reference's own noise in errors relative to its first row, shape (3 m, 3 m).

    `xy_m` (m, 2): positions relative to that row. Each row has its own noise; that of the first row shifts and rotates
    all others.
    """
    R = np.diag([position_sigma_m**2, position_sigma_m**2, heading_sigma_rad**2])
    J = start_jacobian(xy_m).reshape(-1, 3)
    return np.asarray(np.kron(np.eye(len(xy_m)), R) + J @ R @ J.T)


def inseparable(covariance: Array) -> list[tuple[int, int]]:
    """Pairs of parts that the error cannot distinguish: if one is larger, the other is smaller. `covariance` (g, g).

    Parts with less than a tenth of the largest standard deviation are left out.
    """
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    matters = np.flatnonzero(sigma > 0.1 * sigma.max(initial=0.0))
    return [
        (int(i), int(j))
        for n, i in enumerate(matters)
        for j in matters[n + 1 :]
        if covariance[i, j] < INSEPARABLE * sigma[i] * sigma[j]
    ]
