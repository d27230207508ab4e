"""Share of a mismatch that a curve over a covariate predicts in held-out blocks. (66)"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd_tools.compare.covariates import Covariate
from drd_tools.compare.noise import Expected

FOLDS: Final = 20
FLIPS: Final = 1999
WIDTHS: Final = (0.1, 0.3, 1.0, 3.0)  # prior sigma of a curve about its mean, in the mismatch's rms; the best counts


@dataclass(frozen=True)
class Whitened:
    """Whitened block means `y` (b,) of a channel, in sigmas, and the column (b,) of a constant mismatch."""

    y: Array
    one: Array
    expected: Expected
    rms: float

    @property
    def mean(self) -> tuple[float, float]:
        """Constant mismatch and its standard deviation, rad/s or m/s."""
        information = float(self.one @ self.one)
        return float(self.one @ self.y) / information, information**-0.5

    def about_mean(self) -> Array:
        """`y` minus the constant mismatch, (b,)."""
        return np.asarray(self.y - self.mean[0] * self.one)


def whitened(means: Array, expected: Expected) -> Whitened:
    """Whiten block means (b,)."""
    both = expected.whiten(np.column_stack([means, np.ones(len(means))]))
    return Whitened(both[:, 0], both[:, 1], expected, float(np.sqrt(np.mean(means**2))))


def _columns(w: Whitened, covariate: Covariate | None) -> Array:
    """Columns (b, 1 + k) of a constant and of the knots of a curve."""
    return w.one[:, None] if covariate is None else np.column_stack([w.one, w.expected.whiten(covariate.design)])


def _ridge(w: Whitened, columns: Array, width: float) -> Array:
    """Ridge penalties (1 + k, 1 + k): a curve about its mean has prior sigma `width` times the mismatch's rms."""
    size = columns.shape[1]
    penalties = np.full(size, 1.0 / (width * max(w.rms, 1e-300)) ** 2)
    penalties[0] = 1e-12 * float(w.one @ w.one)
    return np.diag(penalties)


def left_over(X: Array, ridge: Array) -> Array:
    """Matrix E (b, b): `E y` is the residual of y when each fold is predicted by the others. (66)"""
    n = len(X)
    E = np.eye(n)
    for fold in np.array_split(np.arange(n), min(FOLDS, n)):
        rest = np.setdiff1d(np.arange(n), fold)
        E[np.ix_(fold, rest)] = -X[fold] @ np.linalg.solve(X[rest].T @ X[rest] + ridge, X[rest].T)
    return E


@dataclass(frozen=True)
class Curve:
    """Mismatch at the knots (k,), rad/s or m/s, with its sigma by the residual scatter and that by noise alone."""

    value: Array
    sigma: Array
    noise_sigma: Array


def curve(w: Whitened, covariate: Covariate, left: float) -> Curve:
    """Fit a curve to all blocks. `left`: rms of the residual, in sigmas.

    Between knots that the blocks do not distinguish the curve is straight (prior on second differences).
    """
    X = _columns(w, covariate)
    k = X.shape[1] - 1
    penalty = _ridge(w, X, max(WIDTHS))
    if covariate.knots.ndim == 1:
        bends = np.diff(np.eye(k), n=2, axis=0) / max(w.rms, 1e-300)
        penalty[1:, 1:] += bends.T @ bends
    P = np.linalg.inv(X.T @ X + penalty)
    H = np.column_stack([np.ones(k), np.eye(k)])
    sigma = np.sqrt(np.einsum("ij,jk,ik->i", H, P, H))
    return Curve(H @ (P @ (X.T @ w.y)), sigma * max(left, 1.0), sigma)


@dataclass(frozen=True)
class Share:
    """Predicted `share` of the squared mismatch about its mean; `p`: probability that noise does as well anywhere.

    `left`: rms of the residual, in sigmas. `as_good`: indistinguishable from the best covariate of the channel.
    """

    share: float
    p: float
    left: float
    as_good: bool


def shares(
    channels: Sequence[Whitened], covariates: Sequence[Covariate], seed: int = 0, flips: int = FLIPS
) -> list[list[Share]]:
    """Shares for each channel and covariate. `p` is family-wise over all: from the largest shares of a channel with
    randomly flipped signs of its blocks, times the number of channels (Bonferroni)."""
    if not channels:
        return []
    n = len(channels[0].y)
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), (n, flips))
    result = []
    for w in channels:
        flipped = (w.about_mean()[:, None] * signs).astype(np.float32)
        X = _columns(w, None)
        base = left_over(X, _ridge(w, X, 1.0))
        total = _squares(base, flipped)
        largest = np.full(flips, -np.inf)
        rows = []
        for covariate in covariates:
            X, tried = _columns(w, covariate), []
            for width in WIDTHS:
                E = left_over(X, _ridge(w, X, width))
                tried.append(E @ w.y)
                largest = np.maximum(largest, 1.0 - _squares(E, flipped) / total)
            rows.append(min(tried, key=lambda r: float(r @ r)))
        result.append(_judged(base @ w.y, rows, largest, len(channels)))
    return result


def _squares(E: Array, columns: npt.NDArray[np.float32]) -> Array:
    """Sums of squares of `E columns`, one per column."""
    left = E.astype(np.float32) @ columns
    return np.asarray(np.einsum("ij,ij->j", left, left).astype(np.float64))


def _judged(nothing: Array, rows: list[Array], largest: Array, channels: int) -> list[Share]:
    total = float(nothing @ nothing)
    if not rows or total == 0.0:
        return []
    best = min(rows, key=lambda r: float(r @ r))
    result = []
    for r in rows:
        share = 1.0 - float(r @ r) / total
        p = min(1.0, channels * (1 + int((largest >= share).sum())) / (1 + len(largest)))
        worse = r**2 - best**2
        as_good = float(worse.sum()) <= 2.0 * float(worse.std()) * len(r) ** 0.5
        result.append(Share(share, p, float(np.sqrt(np.mean(r**2))), as_good))
    return result
