"""Uncertainty of the wheels, from the scatter of windows or recordings, and from datasheets. (54)"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri, stdtrit  # importing scipy.stats takes 0.4 s

from drd.arrays import Array
from drd_tools.calibrate.wheels.drive import Drive

QUANTILE: Final = 0.975
RANK: Final = 1e-9  # smaller eigenvalues of a start pose's information, relative to the largest, count as zero
FEWEST_FREEDOMS: Final = 3.0  # with fewer the scatter is left to chance: datasheets are used too
WHEELS: Final = 3  # the first shared unknowns are the wheels': mean scale, difference, tread
MANY_RECORDINGS: Final = 4
NOTABLE_DISAGREEMENT: Final = 1.5


class Evidence(NamedTuple):
    """One recording at the solution, with p shared unknowns and q of its own.

    `weighted`: derivatives of the n rows times their weights, shape (n, 3, p + q); `weights`: shape (n, 3). For each
    window, its start pose eliminated: `scores`, shape (w, p + q), and `information`, shape (w, p + q, p + q).
    """

    drive: Drive
    weighted: Array
    weights: Array
    scores: Array
    information: Array


class Covariances(NamedTuple):
    """Candidates for the covariance of mean scale, difference and tread, shape (3, 3); the largest is used.

    `plain`: the first is from the windows. `widened`: the same, allowing for few windows or recordings.
    `disagreement`: ratio of standard deviations between recordings to those between windows, the largest of the three;
    0 for few recordings.
    """

    plain: list[Array]
    widened: list[Array]
    disagreement: float


def evidence(drive: Drive, r: Array, J: Array, weights: Array, curvature: Array) -> Evidence:
    """Scores and information of a recording at the solution.

    `r`, shape (n, 3), and its derivatives `J`, shape (n, 3, p + q), at the drive's rows; `weights`, shape (n, 2);
    `curvature`, shape (n, 3, 3): second derivative of a row's cost by its residual. It differs from the weight: beyond
    Huber's bound the pull of a residual is constant, so it carries no information.
    """
    rows, starts = drive.windows
    rows_in = np.diff(starts, append=len(rows))
    placed = drive.reference_xy_m[rows] - r[:, :2]
    placed = placed - np.repeat(np.add.reduceat(placed, starts, axis=0) / rows_in[:, None], rows_in, axis=0)
    pose = np.tile(np.eye(3), (len(r), 1, 1))
    pose[:, 0, 2], pose[:, 1, 2] = -placed[:, 1], placed[:, 0]
    X = np.concatenate([J, pose], axis=2)
    H = np.add.reduceat(np.swapaxes(X, 1, 2) @ curvature @ X, starts, axis=0)
    k = J.shape[2]
    information = H[:, :k, :k] - H[:, :k, k:] @ np.linalg.pinv(H[:, k:, k:], RANK, hermitian=True) @ H[:, k:, :k]
    w = weights[:, (0, 0, 1)]
    weighted = J * w[:, :, None]
    scores = np.add.reduceat(np.einsum("nij,ni->nj", weighted, r), starts, axis=0)
    return Evidence(drive, weighted, w, scores, information)


def covariances(
    parts: Sequence[Evidence], prior: Array, own_prior: Array, free: npt.NDArray[np.bool_], belief: Array
) -> Covariances:
    """Covariance of mean scale, difference and tread. (54)

    From the scatter of the windows; from that of the recordings if they disagree; and from datasheet noise if the
    windows leave few degrees of freedom. Held unknowns have zeros. `prior`, `own_prior`: standard deviations of p
    shared and q own unknowns, the wheels' first. `belief`: standard deviations of nominal values, for those held.
    """
    p, q = len(prior), len(own_prior)
    own = [np.r_[:p, p + q * k : p + q * (k + 1)] for k in range(len(parts))]
    P = np.diag(np.concatenate([prior, *[own_prior] * len(parts)]) ** -2.0)
    A = P.copy()
    for part, of in zip(parts, own, strict=True):
        A[np.ix_(of, of)] += part.information.sum(axis=0)
    kept = np.concatenate([free, np.ones(q * len(parts), bool)])
    inverse, root = np.zeros_like(A), np.zeros_like(A)
    inverse[np.ix_(kept, kept)] = np.linalg.inv(A[np.ix_(kept, kept)])
    root[np.ix_(kept, kept)] = np.linalg.cholesky(inverse[np.ix_(kept, kept)])
    a = inverse[:, :WHEELS]  # influence of each score on the wheels' unknowns
    # Unknowns held at nominal are as uncertain as nominal values are, and this propagates to the others. The prior
    # gives the uncertainty that remains where the data are uninformative.
    held = a.T @ A[:, :p][:, ~free] * belief[~free]
    rest = held @ held.T + a.T @ P @ a
    moves = [part.scores @ a[of] for part, of in zip(parts, own, strict=True)]
    pulls = [part.information @ a[of] for part, of in zip(parts, own, strict=True)]
    weights = [np.einsum("jc,kjc->kc", a[of], pull) for pull, of in zip(pulls, own, strict=True)]
    takes = [np.einsum("jm,kjc->kmc", root[of], pull) for pull, of in zip(pulls, own, strict=True)]
    by_window = [np.concatenate(each) for each in (moves, weights, takes)]
    scatter, freedoms = _scatter(*by_window)
    plain, widened = [scatter + rest], [_widened(scatter, freedoms) + rest]
    disagreement = 0.0
    if len(parts) >= MANY_RECORDINGS:
        by_recording, count = np.stack([some.sum(axis=0) for some in moves]), len(parts)
        between = by_recording.T @ by_recording * count / (count - 1)
        told = free[:WHEELS]
        ratio = np.diag(between)[told] / np.maximum(np.diag(scatter)[told], 1e-300)
        disagreement = float(np.sqrt(ratio).max(initial=0.0))
        if disagreement > NOTABLE_DISAGREEMENT:
            plain.append(between + rest)
            widened.append(_widened(between, np.full(WHEELS, count - 1.0)) + rest)
    if freedoms[free[:WHEELS]].min(initial=np.inf) < FEWEST_FREEDOMS:
        stated = sum((_stated(part, a[of]) for part, of in zip(parts, own, strict=True)), rest)
        plain.append(stated)
        widened.append(stated)
    return Covariances(plain, widened, disagreement)


def _scatter(moves: Array, weights: Array, takes: Array) -> tuple[Array, Array]:
    """Covariance of c unknowns from the scatter of k clusters, shape (c, c), and its degrees of freedom, shape (c,).

    `moves`: influence of each cluster on the unknowns, shape (k, c); `weights`: its variance if scatter is
    proportional to information, shape (k, c). The fit follows each cluster, by `takes`, shape (k, all unknowns, c),
    which reduces the scatter. Under that assumption scale and degrees of freedom are exact (Bell and McCaffrey).
    """
    taken = (takes**2).sum(axis=1)
    together = np.einsum("kmc,knc->cmn", takes, takes)
    left = np.maximum((weights - taken).sum(axis=0), 1e-300)
    square = (weights**2 - 2.0 * weights * taken).sum(axis=0) + (together**2).sum(axis=(1, 2))
    scale = np.sqrt(np.maximum(weights.sum(axis=0), 0.0) / left)
    return moves.T @ moves * np.outer(scale, scale), left**2 / np.maximum(square, 1e-300)


def _widened(V: Array, freedoms: Array) -> Array:
    """Widen each deviation by the ratio of Student's to the normal quantile, since few clusters may agree by chance."""
    factor = stdtrit(np.maximum(freedoms, 1.0), QUANTILE) / ndtri(QUANTILE)
    return np.asarray(V * np.outer(factor, factor))


def _stated(part: Evidence, a: Array) -> Array:
    """Covariance from datasheet values of reference noise and slip, shape (c, c)."""
    influence = part.weighted @ a
    white = np.einsum("nij,nik,ni->jk", influence, influence, 1.0 / part.weights)
    return np.asarray(white + part.drive.slip_m_per_sqrt_m**2 * _slip_scatter(part.drive, influence))


def _slip_scatter(drive: Drive, influence: Array) -> Array:
    """Covariance from slip of 1 m/sqrt(m) on each wheel, white over distance, shape (c, c).

    A slip in one step shifts all later poses of its window along the heading, and rotates them about the slip's place.
    """
    D = drive.nominal.tread_m
    left_m = drive.nominal.left_radius_m * np.interp(drive.reference_s, drive.time_s, drive.left_rad)
    right_m = drive.nominal.right_radius_m * np.interp(drive.reference_s, drive.time_s, drive.right_rad)
    scatter = np.zeros((influence.shape[2], influence.shape[2]))
    all_rows, starts = drive.windows
    for start, end in pairwise([*starts, len(all_rows)]):
        rows, E = all_rows[start:end], influence[start:end]
        x, y = drive.reference_xy_m[rows].T
        heading = drive.reference_heading_rad[rows]
        moment = -y[:, None] * E[:, 0] + x[:, None] * E[:, 1] + E[:, 2]
        later = [np.cumsum(part[::-1], axis=0)[::-1][1:] for part in (E[:, 0], E[:, 1], moment)]
        turn = later[2] + y[:-1, None] * later[0] - x[:-1, None] * later[1]
        ahead = np.cos(heading[:-1, None]) * later[0] + np.sin(heading[:-1, None]) * later[1]
        for travel_m, sign in ((left_m, -1.0), (right_m, 1.0)):
            v = sign * turn / D + 0.5 * ahead
            scatter += np.einsum("i,ij,ik->jk", np.abs(np.diff(travel_m[rows])), v, v)
    return scatter
