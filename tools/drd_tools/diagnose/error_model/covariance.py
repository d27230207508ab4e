"""Covariance and gains of the Kalman filter of x, y, heading (t) and bias (b), in scalar arithmetic.

For matrices this small, the calls of array products alone take several times as long. A covariance is stored as its
upper triangle, ten numbers: xx, xy, xt, xb, yy, yt, yb, tt, tb, bb.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array

_Numbers = tuple[float, ...]

FULL: Final = np.array([[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]])  # indices into the ten numbers
UPPER: Final = np.triu_indices(4)
MOST_RATIO: Final = 1e6  # of P to a fix's variance: a difference still has ten correct digits


@dataclass(frozen=True)
class Gains:
    """Gains of the filter. Wheels: K over sigma (n, 4), and sigma (n,), inf where the gyro is not compared. Fixes: K
    (m, 4, 3), whitener L (m, 3, 3). P after the wheels' update and after the step, each as ten numbers, (n, 10).
    """

    K_wheels: Array
    sigma: Array
    K: Array
    L: Array
    P_before: Array
    P_after: Array


def run(P: Array, steps: Array, fix_step: npt.NDArray[np.intp], H: Array, R: Array) -> Gains:
    """Propagate the covariance from P (4, 4).

    `steps` (n, 14): time by the gyro, variance of the wheels' turn, effect of a heading error on x and y, and Q's ten
    numbers. Fixes, each after the step `fix_step` (m,), have H (m, 3, 4), whose entries other than 1 are listed in
    `_fixed`, and variances R (m, 3).
    """
    n, m = len(steps), len(H)
    p: _Numbers = tuple(P[UPPER].tolist())
    # Written row by row: appending all numbers to lists would take as long as computing them.
    made, K, L = np.empty((n, 25)), np.empty((m, 12)), np.empty((m, 9))
    bounds = np.searchsorted(fix_step, np.arange(n + 1)).tolist()
    fixes = np.column_stack([H[:, 0, 2], H[:, 1, 2], H[:, 2, 3], R]).tolist()
    for i, row in enumerate(steps.tolist()):
        of_wheels, p = _step(p, row)
        made[i] = of_wheels + p
        for j in range(bounds[i], bounds[i + 1]):
            K[j], L[j], after = _fixed(p, fixes[j])
            is_sure = max(p[0], p[4]) < MOST_RATIO * fixes[j][3] and p[7] < MOST_RATIO * fixes[j][5]
            p = after if is_sure else _joseph(p, K[j].reshape(4, 3) @ L[j].reshape(3, 3), H[j], R[j])
    return Gains(made[:, :4], made[:, 4], K.reshape(m, 4, 3), L.reshape(m, 3, 3), made[:, 5:15], made[:, 15:])


def _step(p: _Numbers, row: Sequence[float]) -> tuple[_Numbers, _Numbers]:
    """From P before a step: gain K of the wheels over sigma, sigma, and P after their update; and P after the step."""
    xx, xy, xt, xb, yy, yt, yb, tt, tb, bb = p
    h, R_wheels, hx, hy, qxx, qxy, qxt, _, qyy, qyt, _, qtt, _, qbb = row
    sigma = math.sqrt(h * h * bb + R_wheels)
    share = -h / sigma
    kx, ky, kt, kb = share * xb, share * yb, share * tb, share * bb
    xx, xy, xt, xb = xx - kx * kx, xy - kx * ky, xt - kx * kt, xb - kx * kb
    yy, yt, yb = yy - ky * ky, yt - ky * kt, yb - ky * kb
    tt, tb, bb = tt - kt * kt, tb - kt * kb, bb - kb * kb
    # With m, the heading in the middle of the step: x' = x + hx m, y' = y + hy m, t' = t - h b.
    half = 0.5 * h
    xm, ym, tm, bm = xt - half * xb, yt - half * yb, tt - half * tb, tb - half * bb
    mm = tm - half * bm
    x_b, y_b, t_b = xb + hx * bm, yb + hy * bm, tb - h * bb
    return (kx, ky, kt, kb, sigma, xx, xy, xt, xb, yy, yt, yb, tt, tb, bb), (
        xx + hx * (2.0 * xm + hx * mm) + qxx, xy + hx * ym + hy * (xm + hx * mm) + qxy, xt + hx * tm - h * x_b + qxt,
        x_b, yy + hy * (2.0 * ym + hy * mm) + qyy, yt + hy * tm - h * y_b + qyt, y_b, tt - h * (tb + t_b) + qtt, t_b,
        bb + qbb,
    )  # fmt: skip


def _fixed(p: _Numbers, row: Sequence[float]) -> tuple[_Numbers, _Numbers, _Numbers]:
    """From P before a fix: gain on the whitened innovation (4, 3), whitener of the fix (3, 3), and P after it.

    The fix observes x + u t, y + v t and t + w b.
    """
    xx, xy, xt, xb, yy, yt, yb, tt, tb, bb = p
    u, v, w, Rx, Ry, Rt = row
    x0, y0, t0, b0 = xx + u * xt, xy + u * yt, xt + u * tt, xb + u * tb
    x1, y1, t1, b1 = xy + v * xt, yy + v * yt, yt + v * tt, yb + v * tb
    x2, y2, t2, b2 = xt + w * xb, yt + w * yb, tt + w * tb, tb + w * bb
    # The inverse of the lower Cholesky factor of the innovation's covariance.
    c00 = math.sqrt(x0 + u * t0 + Rx)
    c10, c20 = (y0 + v * t0) / c00, (t0 + w * b0) / c00
    c11 = math.sqrt(y1 + v * t1 + Ry - c10 * c10)
    c21 = (t1 + w * b1 - c20 * c10) / c11
    c22 = math.sqrt(t2 + w * b2 + Rt - c20 * c20 - c21 * c21)
    a, d, f = 1.0 / c00, 1.0 / c11, 1.0 / c22
    b = -c10 * a * d
    c, e = -(c20 * a + c21 * b) * f, -c21 * d * f
    x0, x1, x2 = x0 * a, x0 * b + x1 * d, x0 * c + x1 * e + x2 * f
    y0, y1, y2 = y0 * a, y0 * b + y1 * d, y0 * c + y1 * e + y2 * f
    t0, t1, t2 = t0 * a, t0 * b + t1 * d, t0 * c + t1 * e + t2 * f
    b0, b1, b2 = b0 * a, b0 * b + b1 * d, b0 * c + b1 * e + b2 * f
    return (x0, x1, x2, y0, y1, y2, t0, t1, t2, b0, b1, b2), (a, 0.0, 0.0, b, d, 0.0, c, e, f), (
        xx - x0 * x0 - x1 * x1 - x2 * x2, xy - x0 * y0 - x1 * y1 - x2 * y2,
        xt - x0 * t0 - x1 * t1 - x2 * t2, xb - x0 * b0 - x1 * b1 - x2 * b2,
        yy - y0 * y0 - y1 * y1 - y2 * y2, yt - y0 * t0 - y1 * t1 - y2 * t2, yb - y0 * b0 - y1 * b1 - y2 * b2,
        tt - t0 * t0 - t1 * t1 - t2 * t2, tb - t0 * b0 - t1 * b1 - t2 * b2, bb - b0 * b0 - b1 * b1 - b2 * b2,
    )  # fmt: skip


def _joseph(p: _Numbers, K: Array, H: Array, R: Array) -> _Numbers:
    """P after a fix of gain K in Joseph's form: before the first fix P is huge, and a difference would be rounding
    error.
    """
    kept = np.eye(4) - K @ H
    P = kept @ np.array(p)[FULL] @ kept.T + K * R @ K.T
    return tuple(P[UPPER].tolist())
