"""Contribution of one recording to the normal equations of the shared unknowns."""

from dataclasses import dataclass

import numpy as np

from drd.arrays import Array


@dataclass(frozen=True)
class Scores:
    """One recording's score and information on p shared unknowns, with its own q eliminated.

    `information`, shape (p, p); `gradient`, shape (p,).
    """

    information: Array
    gradient: Array
    own_information: Array
    own_gradient: Array
    coupling: Array

    def own_move(self, shared_move: Array) -> Array:
        """Step of the recording's own unknowns for a given step of the shared ones, shape (q,)."""
        push: Array = self.own_gradient + self.coupling.T @ shared_move
        return np.asarray(-np.linalg.solve(self.own_information, push))


def score(r: Array, J: Array, weights: Array, own: Array, own_prior: Array) -> Scores:
    """Form the normal equations of one recording.

    `r`, shape (n, 3), and its derivatives `J`, shape (n, 3, p + q), at a drive's rows; `weights`, shape (n, 2).
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
    return Scores(
        A[:p, :p] - A[:p, p:] @ eliminate,
        g[:p] - eliminate.T @ g[p:],
        A[p:, p:],
        g[p:],
        A[:p, p:],
    )
