"""Errors of a recording around a path: a linear model, and the Kalman filter that whitens data and signatures alike.

What is true differs from what sensors, added up, say by a state of four: x, y, heading and the gyro's bias. It grows by
noise, and by causes. Passed through the same filter, the data's innovations and those of each cause's signature are
sequences in white noise, and what is left is linear regression. (55) to (58)
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from drd_tools.diagnose.evidence import Evidence, Noise

Array = npt.NDArray[np.float64]

STATES: Final = 4
PARTS: Final = 8  # of a step, in which the heading is followed
CHUNK: Final = 500  # steps for which inputs are laid out at once
NOWHERE_M2: Final = 1e4  # before the first fix
NO_HEADING_RAD2: Final = 10.0


@dataclass(frozen=True)
class Path:
    """Poses x_m, y_m, heading_rad at the edges of the steps, shape (n + 1, 3)."""

    pose: Array

    @property
    def middle_rad(self) -> Array:
        """Heading in the middle of each step, (n,)."""
        result: Array = 0.5 * (self.pose[1:, 2] + self.pose[:-1, 2])
        return result

    def steps(self) -> tuple[Array, Array, Array]:
        """Each step's way forward and to the left (m) and turn (rad), (n,) each."""
        d = np.diff(self.pose, axis=0)
        c, s = np.cos(self.middle_rad), np.sin(self.middle_rad)
        return d[:, 0] * c + d[:, 1] * s, d[:, 1] * c - d[:, 0] * s, d[:, 2]


@dataclass(frozen=True)
class Signature:
    """What a cause changes: increments of the sensors' sums, and of the body's own way to the left, (n,) each or 0.

    `fix`: of the reference's poses, (m, 3) or 0.
    """

    gyro_rad: Array | float = 0.0
    left_m: Array | float = 0.0
    right_m: Array | float = 0.0
    lateral_m: Array | float = 0.0
    fix: Array | float = 0.0

    def __add__(self, other: "Signature") -> "Signature":
        return Signature(*(a + b for a, b in zip(self.channels, other.channels, strict=True)))

    def __mul__(self, factor: float) -> "Signature":
        return Signature(*(a * factor for a in self.channels))

    @property
    def channels(self) -> tuple[Array | float, ...]:
        """All five."""
        return self.gyro_rad, self.left_m, self.right_m, self.lateral_m, self.fix


def dead_reckon(turn_rad: Array, forward_m: Array, start: Array) -> Path:
    """Add up turns and ways, (n,) each, from the pose `start` (3,). (7)"""
    heading = start[2] + np.concatenate([[0.0], np.cumsum(turn_rad)])
    middle = 0.5 * (heading[1:] + heading[:-1])
    x = start[0] + np.concatenate([[0.0], np.cumsum(forward_m * np.cos(middle))])
    y = start[1] + np.concatenate([[0.0], np.cumsum(forward_m * np.sin(middle))])
    return Path(np.column_stack([x, y, heading]))


def within_steps(e: Evidence, turn_rad: Array) -> tuple[Array, Array]:
    """What a step's way, bent as the heading is within it, has less along and more across the mean heading, m.

    Chords instead of arcs would pass for a wheel's radius where the robot weaves. `turn_rad` (n,) is for robots without
    a gyro.
    """
    edges = e.edges_s
    turn = turn_rad if e.gyro_rad is None else e.gyro_rad
    heading = CubicSpline(edges, np.concatenate([[0.0], np.cumsum(turn)]))
    inside = edges[:-1, None] + (np.arange(PARTS) + 0.5) / PARTS * np.diff(edges)[:, None]
    off = heading(inside) - 0.5 * (heading(edges[1:]) + heading(edges[:-1]))[:, None]
    way = 0.5 * (e.left_m + e.right_m)
    return way * (np.cos(off).mean(axis=1) - 1.0), way * np.sin(off).mean(axis=1)


class Linear:
    """The model around `path`, with noise of given sizes. `doubt` (m,) multiplies the variance of each fix."""

    def __init__(self, evidence: Evidence, path: Path, noise: Noise, doubt: Array | None = None):
        self.evidence, self.path, self.noise = evidence, path, noise
        self.doubt = np.ones(len(evidence.fix)) if doubt is None else doubt
        self._forward, self._left, self._turn = path.steps()
        self._c, self._s = np.cos(path.middle_rad), np.sin(path.middle_rad)
        # What a heading error does to x and y in a step.
        self._hx = -self._forward * self._s - self._left * self._c
        self._hy = self._forward * self._c - self._left * self._s
        self._gain()

    # ---- the data -----------------------------------------------------------------------------------------------

    def data(self) -> Signature:
        """The recording, less what the path would have given."""
        e, half = self.evidence, 0.5 * self.evidence.tread_m
        gyro = 0.0 if e.gyro_rad is None else e.gyro_rad - self._turn
        fix = e.fix - self.at_fixes(self.path.pose)
        fix[:, 2] = np.pi - np.mod(np.pi - fix[:, 2], 2.0 * np.pi)
        left, right = self._forward - half * self._turn, self._forward + half * self._turn
        shorter, aside = within_steps(e, self._turn)
        return Signature(gyro, e.left_m - left + shorter, e.right_m - right + shorter, self._left - aside, fix)

    def at_fixes(self, poses: Array) -> Array:
        """Poses (n + 1, 3) of the edges, at the times of the fixes (m, 3)."""
        e = self.evidence
        after = poses[e.fix_step + 1]
        result: Array = after + e.fix_share[:, None] * (poses[e.fix_step] - after)
        return result

    # ---- the filter ---------------------------------------------------------------------------------------------

    def _gain(self) -> None:
        """Run the covariance, which does not depend on the data, and keep the gains."""
        e, noise = self.evidence, self.noise
        n, m = len(e.step_s), len(e.fix)
        self.R_wheels, Q = noise.wheels(e, self._turn), noise.steps(e, self._turn, self._c, self._s, self._hx, self._hy)
        R = np.diag([noise.position_m**2, noise.position_m**2, noise.heading_rad**2])
        P = np.diag([NOWHERE_M2, NOWHERE_M2, NO_HEADING_RAD2, noise.bias_rad_s**2 if e.gyro_rad is not None else 0.0])
        self._F = np.tile(np.eye(STATES), (n, 1, 1))
        self._F[:, 0, 2], self._F[:, 1, 2], self._F[:, 2, 3] = self._hx, self._hy, -e.step_s
        self._F[:, 0, 3], self._F[:, 1, 3] = -0.5 * e.step_s * self._hx, -0.5 * e.step_s * self._hy
        self._H = np.zeros((m, 3, STATES))
        self._H[:, range(3), range(3)] = 1.0
        k, share = e.fix_step, e.fix_share
        self._H[:, 0, 2], self._H[:, 1, 2] = -share * self._hx[k], -share * self._hy[k]
        self._H[:, 2, 3] = share * e.step_s[k]
        self._K_wheels, self._sigma = np.zeros((n, STATES)), np.ones(n)
        self._K, self._L = np.zeros((m, STATES, 3)), np.zeros((m, 3, 3))
        self._P_after, self._P_before = np.zeros((n, STATES, STATES)), np.zeros((n, STATES, STATES))
        bounds: list[int] = np.searchsorted(k, np.arange(n + 1)).tolist()
        self._bounds = bounds
        has_gyro = e.gyro_rad is not None
        for i in range(n):
            if has_gyro:
                h = float(e.step_s[i])
                sigma = (h * h * float(P[3, 3]) + float(self.R_wheels[i])) ** 0.5
                K = P[:, 3] * (-h / sigma)
                self._K_wheels[i], self._sigma[i] = K, sigma
                P = P - K[:, None] * K
            self._P_before[i] = P
            F = self._F[i]
            P = F @ P @ F.T + Q[i]
            self._P_after[i] = P
            for j in range(bounds[i], bounds[i + 1]):
                H = self._H[j]
                PH = P @ H.T
                self._L[j] = L = _inverse_root(H @ PH + R * self.doubt[j])
                self._K[j] = K = PH @ L.T
                P = P - K @ K.T

    def inputs(self, signatures: Sequence[Signature], begin: int, end: int) -> tuple[Array, Array]:
        """For a chunk of steps: what is added to the state (c, 4, p), and the wheels' turn less the gyro's (c, p)."""
        c = end - begin

        def stacked(channel: int) -> Array:
            return np.stack(
                [np.broadcast_to(v[begin:end] if isinstance(v := s.channels[channel], np.ndarray) else v, c)
                 for s in signatures], axis=1)  # fmt: skip

        e, at = self.evidence, slice(begin, end)
        left, right, lateral = stacked(1), stacked(2), stacked(3)
        wheels = (right - left) / e.tread_m
        turn = wheels if e.gyro_rad is None else stacked(0)
        forward = 0.5 * (left + right)
        cos, sin, hx, hy = (v[at, None] for v in (self._c, self._s, self._hx, self._hy))
        u = np.empty((c, STATES, left.shape[1]))
        u[:, 0] = forward * cos + lateral * sin + 0.5 * hx * turn
        u[:, 1] = forward * sin - lateral * cos + 0.5 * hy * turn
        u[:, 2] = turn
        u[:, 3] = 0.0
        return u, (wheels - turn if e.gyro_rad is not None else np.zeros_like(turn))

    def rows(self, signatures: Sequence[Signature]) -> Iterator[tuple[Array, Array]]:
        """Pass p signatures through the filter, chunk by chunk of steps.

        Gives innovations over their standard deviations: of the wheels against the gyro (c, p), zero without a gyro,
        and of the chunk's fixes (f, 3, p).
        """
        e, bounds, p = self.evidence, self._bounds, len(signatures)
        X = np.zeros((STATES, p))
        for begin in range(0, len(e.step_s), CHUNK):
            end = min(begin + CHUNK, len(e.step_s))
            u, wheels = self.inputs(signatures, begin, end)
            wheels /= self._sigma[begin:end, None]
            first = bounds[begin]
            fixes = np.zeros((bounds[end] - first, 3, p))
            for j, signature in enumerate(signatures):
                if isinstance(signature.fix, np.ndarray):
                    fixes[:, :, j] = signature.fix[first : bounds[end]]
            per_sigma = (e.step_s / self._sigma)[begin:end].tolist()
            for i in range(begin, end):
                if e.gyro_rad is not None:
                    w = wheels[i - begin]
                    w += per_sigma[i - begin] * X[3]
                    X += self._K_wheels[i][:, None] * w
                X = self._F[i] @ X
                X += u[i - begin]
                for j in range(bounds[i], bounds[i + 1]):
                    w = self._L[j] @ (fixes[j - first] - self._H[j] @ X)
                    fixes[j - first] = w
                    X += self._K[j] @ w
            yield wheels, fixes

    def whiten(self, signatures: Sequence[Signature]) -> tuple[Array, Array]:
        """All rows at once: (n, p) and (m, 3, p)."""
        parts = list(self.rows(signatures))
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])

    def smoothed(self) -> Path:
        """The path, corrected by what the data say of it (Rauch, Tung and Striebel)."""
        e = self.evidence
        n = len(e.step_s)
        data = self.data()
        u, wheels = self.inputs([data], 0, n)
        X = np.zeros(STATES)
        after, before = np.zeros((n, STATES)), np.zeros((n + 1, STATES))
        for i in range(n):
            if e.gyro_rad is not None:
                X = X + self._K_wheels[i] * ((wheels[i, 0] + e.step_s[i] * X[3]) / self._sigma[i])
            before[i] = X
            X = self._F[i] @ X + u[i, :, 0]
            after[i] = X
            for j in range(self._bounds[i], self._bounds[i + 1]):
                X = X + self._K[j] @ (self._L[j] @ (data.fix[j] - self._H[j] @ X))  # type: ignore[index]
        state = before
        state[n] = X
        P = self._P_after + 1e-18 * np.eye(STATES)
        G = np.linalg.solve(P, self._F @ self._P_before).transpose(0, 2, 1)
        for i in range(n - 1, -1, -1):
            state[i] += G[i] @ (state[i + 1] - after[i])
        return Path(self.path.pose + state[:, :3])


def _inverse_root(S: Array) -> Array:
    """Inverse of the lower Cholesky factor of a 3 by 3 matrix, written out: several times faster than two calls."""
    (a, _, _), (b, c, _), (d, e, f) = S.tolist()
    l00 = math.sqrt(a)
    l10, l20 = b / l00, d / l00
    l11 = math.sqrt(c - l10 * l10)
    l21 = (e - l20 * l10) / l11
    l22 = math.sqrt(f - l20 * l20 - l21 * l21)
    i10 = -l10 / (l00 * l11)
    i21 = -l21 / (l11 * l22)
    i20 = -(l20 / l00 + l21 * i10) / l22
    return np.array(((1.0 / l00, 0.0, 0.0), (i10, 1.0 / l11, 0.0), (i20, i21, 1.0 / l22)))
