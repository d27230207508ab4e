"""What one recording says about the shared unknowns: its share of the normal equations, window by window."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from drd.arrays import Array
from drd_tools.calibrate.wheels.drive import Drive


@dataclass(frozen=True)
class Scores:
    """One recording's score and information on p shared unknowns, its q own ones eliminated.

    `information`, shape (p, p); `gradient`, shape (p,); `by_window`: the gradient's parts, shape (windows, p), whose
    scatter gives the uncertainty; `expected`: the scatter that noise of the reference and slip should give, (p, p).
    """

    information: Array
    gradient: Array
    by_window: Array
    expected: Array
    own_information: Array
    own_gradient: Array
    coupling: Array

    def own_move(self, shared_move: Array) -> Array:
        """The step of the recording's own unknowns that goes with a step of the shared ones, shape (q,)."""
        push: Array = self.own_gradient + self.coupling.T @ shared_move
        return np.asarray(-np.linalg.solve(self.own_information, push))


def score(drive: Drive, r: Array, J: Array, weights: Array, own: Array, own_prior: Array) -> Scores:
    """Form the normal equations of one recording.

    `r`, shape (n, 3), and its derivatives `J`, shape (n, 3, p + q), at the drive's rows; `weights`, shape (n, 2).
    `own`, `own_prior`, shape (q,): value and standard deviation of the own unknowns.
    """
    q = len(own)
    p = J.shape[2] - q
    w = weights[:, (0, 0, 1)]
    JW = J * w[:, :, None]
    A = np.einsum("nij,nik->jk", JW, J)
    A[p:, p:] += np.diag(own_prior**-2.0)
    g = np.einsum("nij,ni->j", JW, r)
    g[p:] += own / own_prior**2
    eliminate = np.linalg.solve(A[p:, p:], A[p:, :p])  # (q, p)
    effective = JW[:, :, :p] - JW[:, :, p:] @ eliminate
    by_window: Array = np.add.reduceat(np.einsum("nij,ni->nj", effective, r), drive.windows[1], axis=0)
    white = np.einsum("nij,nik,ni->jk", effective, effective, 1.0 / w)
    return Scores(
        A[:p, :p] - A[:p, p:] @ eliminate,
        g[:p] - eliminate.T @ g[p:],
        by_window,
        white + drive.slip_m_per_sqrt_m**2 * _slip_scatter(drive, effective),
        A[p:, p:],
        g[p:],
        A[:p, p:],
    )


def _slip_scatter(drive: Drive, effective: Array) -> Array:
    """Scatter of the score for slip of 1 m/sqrt(m) on each wheel, independent from metre to metre, shape (p, p).

    A slip in one step moves all later poses of its window: along the heading, and turned about the place of the slip.
    """
    D = drive.nominal.tread_m
    left_m = drive.nominal.left_radius_m * np.interp(drive.reference_s, drive.time_s, drive.left_rad)
    right_m = drive.nominal.right_radius_m * np.interp(drive.reference_s, drive.time_s, drive.right_rad)
    scatter = np.zeros((effective.shape[2], effective.shape[2]))
    all_rows, starts = drive.windows
    for start, end in pairwise([*starts, len(all_rows)]):
        rows, E = all_rows[start:end], effective[start:end]
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
