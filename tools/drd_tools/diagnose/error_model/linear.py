"""Linear error model of a recording around a path, and the Kalman filter that whitens data and sensitivities alike.

The truth differs from the integrated sensor readings by a state of four: x, y, heading and the gyro's bias, driven by
noise and by causes. Passed through the same filter, the data's innovations are those of each cause's sensitivity in
white noise: the problem becomes linear regression. (67) to (69)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd_tools.diagnose.error_model.covariance import FULL, UPPER, Gains, run
from drd_tools.diagnose.error_model.path import Path, with_jumps, within_steps
from drd_tools.diagnose.error_model.recursion import Recursion, StateSpace
from drd_tools.diagnose.observe.evidence import Evidence, Noise
from drd_tools.recordings.folder import wrapped

STATES: Final = 4  # x, y, heading, the gyro's bias
INPUTS: Final = 7  # gyro, left, right, lateral, and a fix's three
OUTPUTS: Final = 4  # the wheels', and a fix's three
COLUMNS: Final = 8  # filtered at once: as many as fit the cache
NOWHERE_M2: Final = 1e4  # before the first fix
NO_HEADING_RAD2: Final = 10.0  # before the first fix: sigma of half a turn
NEAR_SHARE: Final = 0.005  # of the largest: gains are kept if the effect of a heading error changes by less


@dataclass(frozen=True)
class Sensitivity:
    """Changes by a cause in the sensors' increments, and in the body's own travel to the left, (n,) each or 0.

    `fix`: changes in the reference's poses, (m, 3) or 0.
    """

    gyro_rad: Array | float = 0.0
    left_m: Array | float = 0.0
    right_m: Array | float = 0.0
    lateral_m: Array | float = 0.0
    fix: Array | float = 0.0

    def __add__(self, other: "Sensitivity") -> "Sensitivity":
        return Sensitivity(*(a + b for a, b in zip(self.channels, other.channels, strict=True)))

    def __mul__(self, factor: float) -> "Sensitivity":
        return Sensitivity(*(a * factor for a in self.channels))

    @property
    def channels(self) -> tuple[Array | float, ...]:
        """All five channels."""
        return self.gyro_rad, self.left_m, self.right_m, self.lateral_m, self.fix


class Linear:
    """Linear model around `path`, with noise of given sizes. `fix_inflation` (m,) multiplies the variances of fixes."""

    def __init__(
        self,
        evidence: Evidence,
        path: Path,
        noise: Noise,
        fix_inflation: Array | None = None,
        like: "Linear | None" = None,
    ):
        self.evidence, self.path, self.noise = evidence, path, noise
        self.fix_inflation = np.ones(len(evidence.fix)) if fix_inflation is None else fix_inflation
        self._forward, self._left, self._turn = path.steps()
        self._c, self._s = np.cos(path.middle_rad), np.sin(path.middle_rad)
        # Effect of a heading error on x and y in a step.
        self._hx = -self._forward * self._s - self._left * self._c
        self._hy = self._forward * self._c - self._left * self._s
        self._gain(like)

    # ---- the data -----------------------------------------------------------------------------------------------

    def data(self) -> Sensitivity:
        """The recorded increments and fixes less those of the path."""
        e, half = self.evidence, 0.5 * self.evidence.tread_m
        # The path includes its jumps here: a jump has mean 0 in the model.
        forward, sideways, turn = self.path.steps(with_jumps=True)
        gyro = 0.0 if e.gyro_rad is None else e.gyro_rad - turn
        fix = e.fix - self.at_fixes()
        fix[:, 2] = wrapped(fix[:, 2])
        left, right = forward - half * turn, forward + half * turn
        shorter, aside = within_steps(e, self._turn)
        return Sensitivity(gyro, e.left_m - left + shorter, e.right_m - right + shorter, sideways - aside, fix)

    def at_fixes(self) -> Array:
        """Poses of the path at the times of the fixes, (m, 3)."""
        e = self.evidence
        result: Array = self.path.pose[e.fix_step + 1] - e.fix_share[:, None] * self.path.moved[e.fix_step]
        return result

    # ---- the filter ---------------------------------------------------------------------------------------------

    def _gain(self, like: "Linear | None") -> None:
        """Propagate the covariance, which does not depend on the data, and keep the gains; or reuse `like`'s."""
        e = self.evidence
        n, m = len(e.step_s), len(e.fix)
        self._F = np.tile(np.eye(STATES), (n, 1, 1))
        by_gyro_s = np.where(e.gyroless, 0.0, e.step_s)
        self._F[:, 0, 2], self._F[:, 1, 2], self._F[:, 2, 3] = self._hx, self._hy, -by_gyro_s
        self._F[:, 0, 3], self._F[:, 1, 3] = -0.5 * by_gyro_s * self._hx, -0.5 * by_gyro_s * self._hy
        self._H = np.zeros((m, 3, STATES))
        self._H[:, range(3), range(3)] = 1.0
        k, share = e.fix_step, e.fix_share
        self._H[:, 0, 2], self._H[:, 1, 2] = -share * self._hx[k], -share * self._hy[k]
        self._H[:, 2, 3] = share * by_gyro_s[k]
        if like is not None and self._is_near(like):
            self._gains: Gains = like._gains
        else:
            self._gains = self._run_covariance()

    def _is_near(self, like: "Linear") -> bool:
        """Whether the gains of `like` can be reused: same noise, nearly the same path."""
        if like.noise != self.noise or not np.array_equal(like.fix_inflation, self.fix_inflation):
            return False
        largest = max(float(np.abs(h).max()) for h in (self._hx, self._hy))
        return all(
            float(np.abs(h - was).max()) <= NEAR_SHARE * largest
            for h, was in ((self._hx, like._hx), (self._hy, like._hy))
        )

    def _run_covariance(self) -> Gains:
        e, noise = self.evidence, self.noise
        # If the gyro is not compared, the wheels carry no information on it.
        R_wheels = np.where(e.gyroless, np.inf, noise.wheels(e))
        Q = noise.steps(e, self._c, self._s, self._hx, self._hy)[:, *UPPER]
        steps = np.column_stack([-self._F[:, 2, 3], R_wheels, self._hx, self._hy, Q])
        R = np.array([noise.position_m**2, noise.position_m**2, noise.heading_rad**2]) * self.fix_inflation[:, None]
        P = np.diag([NOWHERE_M2, NOWHERE_M2, NO_HEADING_RAD2, noise.bias_rad_s**2 if e.gyro_rad is not None else 0.0])
        return run(P, steps, e.fix_step, self._H, R)

    @cached_property
    def _events(self) -> "_Events":
        """The filter as one recursion. A second fix in a step is a separate event of zero duration."""
        e = self.evidence
        n, m = len(e.step_s), len(e.fix)
        first = np.concatenate([[True], np.diff(e.fix_step) > 0])[:m]
        # Events before a fix: one for each step up to its own, and one for each further fix of a step.
        later = np.cumsum(~first)
        of_fix = e.fix_step + later
        count = n + int((~first).sum())
        of_step = np.delete(np.arange(count), of_fix[~first])
        A = np.tile(np.eye(STATES), (count, 1, 1))
        B, C = np.zeros((count, STATES, INPUTS)), np.zeros((count, OUTPUTS, STATES))
        D = np.zeros((count, OUTPUTS, INPUTS))
        A[of_step], B[of_step, :, :4] = self._F, self._inputs()
        sigma = self._gains.sigma
        C[of_step, 0, 3] = e.step_s / sigma
        D[of_step, 0, :3] = np.array([-1.0, -1.0 / e.tread_m, 1.0 / e.tread_m]) / sigma[:, None]
        FK = np.einsum("nij,nj->ni", self._F, self._gains.K_wheels)
        A[of_step] += FK[:, :, None] * C[of_step, :1]
        B[of_step] += FK[:, :, None] * D[of_step, :1]
        LH = self._gains.L @ self._H
        C[of_fix, 1:], D[of_fix, 1:] = -LH @ A[of_fix], -LH @ B[of_fix]
        D[of_fix, 1:, 4:] = self._gains.L
        A[of_fix] += self._gains.K @ C[of_fix, 1:]
        B[of_fix] += self._gains.K @ D[of_fix, 1:]
        return _Events(A, B, C, D, of_step, of_fix)

    @cached_property
    def _filter(self) -> StateSpace:
        v = self._events
        return StateSpace(v.A, v.B, v.C, v.D)

    def _inputs(self) -> Array:
        """Input matrix: change of the state per increment of gyro, left, right and lateral, (n, 4, 4)."""
        e, c, s = self.evidence, self._c, self._s
        turn = np.where(e.gyroless[:, None], [0.0, -1.0 / e.tread_m, 1.0 / e.tread_m, 0.0], [1.0, 0.0, 0.0, 0.0])
        forward, lateral = np.array([0.0, 0.5, 0.5, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])
        u = np.zeros((len(c), STATES, 4))
        u[:, 0] = np.outer(c, forward) + np.outer(s, lateral) + 0.5 * self._hx[:, None] * turn
        u[:, 1] = np.outer(s, forward) - np.outer(c, lateral) + 0.5 * self._hy[:, None] * turn
        u[:, 2] = turn
        return u

    def _channels(self, sensitivities: Sequence[Sensitivity]) -> Array:
        """Inputs of each event, (q, p, events): channels up to the last in use; the last three possible are a fix's."""
        v = self._events
        inputs = np.zeros((max(map(_used, sensitivities)), len(sensitivities), len(v.A)))
        for j, sensitivity in enumerate(sensitivities):
            for i in range(4):
                if isinstance(channel := sensitivity.channels[i], np.ndarray):
                    inputs[i, j, v.of_step] = channel
            if isinstance(sensitivity.fix, np.ndarray):
                inputs[4:, j, v.of_fix] = sensitivity.fix.T
        return inputs

    def rows(self, sensitivities: Sequence[Sensitivity], dtype: type = np.float64) -> Array:
        """Innovations over their standard deviations, (n + 3 m, p): of the wheels against the gyro, 0 without one, then
        of the fixes.
        """
        v, n = self._events, len(self.evidence.step_s)
        rows: Array = np.empty((len(sensitivities), n + 3 * len(self.evidence.fix)), dtype)
        order = sorted(range(len(sensitivities)), key=lambda j: _used(sensitivities[j]))
        for i in range(0, len(sensitivities), COLUMNS):
            some = order[i : i + COLUMNS]
            y = self._filter.outputs(self._channels([sensitivities[j] for j in some]))
            for j, own in zip(some, y, strict=True):  # one by one: a take from all at once is three times as slow
                rows[j, :n] = own[:, 0].take(v.of_step)
                rows[j, n:] = own[:, 1:].take(v.of_fix, axis=0).ravel()
        return rows.T

    def adjoint(self, rows: Array) -> Array:
        """Transpose of `rows`: projection of whitened rows (n + 3 m,) on the response to a unit of each step's gyro,
        left, right and lateral increment, (n, 4).
        """
        v, n = self._events, len(self.evidence.step_s)
        y = np.zeros((len(v.A), OUTPUTS))
        y[v.of_step, 0] = rows[:n]
        y[v.of_fix, 1:] = rows[n:].reshape(-1, 3)
        sums = np.einsum("noi,no->ni", v.C, y)[::-1, :, None]
        after = Recursion(v.A.transpose(0, 2, 1)[::-1]).states(sums)[0][::-1, :, 0]
        projected = np.einsum("nki,nk->ni", v.B, after) + np.einsum("noi,no->ni", v.D, y)
        result: Array = projected[v.of_step, :4]
        return result

    @property
    def log_likelihood(self) -> float:
        """Log determinant of the fixes' whitener, nats: their log likelihood without the term of the whitened rows."""
        return float(np.log(np.einsum("mii->mi", self._gains.L)).sum())

    def smoothed(self) -> Path:
        """The path corrected by the smoothed error state (Rauch, Tung and Striebel)."""
        v, s = self._events, self._channels([self.data()])[:, 0]
        X, last = Recursion(v.A).states(np.einsum("nij,jn->ni", v.B[:, :, : len(s)], s)[:, :, None])
        x, s = X[v.of_step, :, 0], s[:4, v.of_step]
        wheels = self._events.C[v.of_step, 0, 3] * x[:, 3] + np.einsum("nj,jn->n", v.D[v.of_step, 0, :4], s)
        before = x + self._gains.K_wheels * wheels[:, None]
        after = np.einsum("nij,nj->ni", self._F, before) + np.einsum("nij,jn->ni", self._inputs(), s)
        P_before, P_after = self._gains.P_before[:, FULL], self._gains.P_after[:, FULL] + 1e-18 * np.eye(STATES)
        G = np.linalg.solve(P_after, self._F @ P_before).transpose(0, 2, 1).astype(np.float64, copy=False)
        v = before - np.einsum("nij,nj->ni", G, after)
        states, first = Recursion(G[::-1]).states(v[::-1, :, None], last)
        return with_jumps(self.evidence, self.path.pose + np.concatenate([first[None], states[::-1]])[:, :3, 0])


def _used(sensitivity: Sensitivity) -> int:
    """Number of inputs up to the last in use."""
    if isinstance(sensitivity.fix, np.ndarray):
        return INPUTS
    return max((i for i, channel in enumerate(sensitivity.channels, 1) if isinstance(channel, np.ndarray)), default=1)


@dataclass(frozen=True)
class _Events:
    """The recursion of events: x' = A x + B s, with outputs C x + D s: the wheels', and a fix's three. Indices of the
    events that are steps (n,) and fixes (m,).
    """

    A: Array
    B: Array
    C: Array
    D: Array
    of_step: npt.NDArray[np.intp]
    of_fix: npt.NDArray[np.intp]
