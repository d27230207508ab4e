"""Competing methods: sparse regressions of the residual increments on the diagnosis' own library, not whitened.

They get the same columns, summed over BLOCK_S (or between the reference's poses, if these are sparser). Each channel is
scaled by its own scatter, and the gyro's constant bias is projected out. They ignore correlation of the noise.
"""

import importlib.util
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.observe.evidence import Evidence, gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.select.library import library_of
from drd_tools.diagnose.selected import SCALE
from drd_tools.recordings.folder import Recording

BLOCK_S: Final = 2.0
FOLDS: Final = 5
PENALTIES: Final = 30
MODELS: Final = 10
THRESHOLD: Final = 0.1  # pysindy's default; of the residual's scatter, since columns and residual have unit rms
INCLUDED: Final = 0.6  # share of the models (Fasel et al. 2022)
MOST: Final = 8
PACKAGES: Final = {"lasso": "sklearn", "E-SINDy": "pysindy", "BIC": "numpy"}


class Regression(NamedTuple):
    """Residual `y` (n,) and columns `X` (n, p), each of unit rms, and the effect of each column."""

    y: Array
    X: Array
    effects: list[str]


def is_there(package: str) -> bool:
    """Whether a package is installed."""
    return importlib.util.find_spec(package) is not None


def installed() -> tuple[str, ...]:
    """Names of the methods whose packages are installed."""
    return tuple(name for name, package in PACKAGES.items() if is_there(package))


def baselines(
    recording: Recording, names: Sequence[str], learned: Mapping[str, Callable[[Regression], list[str]]] | None = None
) -> dict[str, list[str]]:
    """Effects that each method selects, the most important first. `learned`: further methods, which were trained."""
    if not names and not learned:
        return {}
    regression = regress(recording)
    methods: dict[str, Callable[[Regression], Array]] = {"lasso": _lasso, "E-SINDy": _e_sindy, "BIC": forward}
    found = {name: _named(methods[name](regression), regression.effects) for name in names}
    return found | {name: method(regression) for name, method in (learned or {}).items()}


def regress(recording: Recording) -> Regression:
    """The residual increments and the library's sensitivities in them."""
    problem = Problem(gather(recording))
    sensitivities: dict[int, tuple[str, Sensitivity]] = {}
    for c in library_of(problem).candidates:
        shape = {name: value for name, value in c.shape.items() if name != SCALE.name}
        if c.angle:
            units = [problem.unit(c.effect, {**shape, c.angle: a}, c.names[0]) for a in (0.0, 0.5 * math.pi)]
        else:
            units = [problem.unit(c.effect, shape, name) for name in c.names]
        sensitivities |= {i: (c.effect.id, unit) for i, unit in zip(c.columns, units, strict=True)}
    e = problem.evidence
    bias = Sensitivity(gyro_rad=e.step_s)
    rows, residual = _increments(e, [bias, *(unit for _, unit in sensitivities.values())])
    known, X = rows[:, :1], rows[:, 1:]
    if e.gyro_rad is not None:
        known = known / np.linalg.norm(known)
        residual, X = residual - known[:, 0] * (known[:, 0] @ residual), X - known @ (known.T @ X)
    scale = np.sqrt(np.mean(X**2, axis=0))
    seen = scale > 1e-9 * scale.max()
    names = [name for name, _ in sensitivities.values()]
    return Regression(
        residual / math.sqrt(float(np.mean(residual**2))),
        X[:, seen] / scale[seen],
        [n for n, s in zip(names, seen, strict=True) if s],
    )


def _increments(e: Evidence, sensitivities: Sequence[Sensitivity]) -> tuple[Array, Array]:
    """Columns (n, p) and residual (n,): gyro against wheels, turn and travel against the reference."""
    zero, D = np.zeros_like(e.time_s), e.tread_m
    gyro, left, right, lateral = (np.column_stack([s.channels[k] + zero for s in sensitivities]) for k in range(4))
    parts: list[tuple[Array, Array]] = []
    if e.gyro_rad is not None:
        starts = np.searchsorted(e.time_s, np.arange(e.time_s[0], e.time_s[-1], BLOCK_S))
        columns = np.add.reduceat(gyro - (right - left) / D, starts)
        parts.append((columns, np.add.reduceat(e.gyro_rad - (e.right_m - e.left_m) / D, starts)))
    if len(e.fix) > 1:
        has_gyro = e.gyro_rad is not None
        turn = gyro if has_gyro else (right - left) / D
        parts += _against_fixes(e, turn, 0.5 * (left + right), lateral)
    scaled = [(X / s, y / s) for X, y in parts if (s := float(np.std(y))) > 0.0]
    return np.concatenate([X for X, _ in scaled]), np.concatenate([y for _, y in scaled])


def _against_fixes(e: Evidence, turn: Array, forward: Array, lateral: Array) -> list[tuple[Array, Array]]:
    """Turn and displacement, forward and to the left, between poses: dead reckoning minus reference. (7)"""
    chosen = [0]
    for i, at_s in enumerate(e.fix_time_s):
        if at_s - e.fix_time_s[chosen[-1]] >= BLOCK_S - 1e-6:
            chosen.append(i)
    # Poses are at the edges of steps, or nearly so.
    steps, first_of = np.unique((e.fix_step + 1 - np.round(e.fix_share).astype(int))[chosen], return_index=True)
    fix = e.fix[chosen][first_of]
    if len(steps) < 2:
        return []
    own = (e.right_m - e.left_m) / e.tread_m if e.gyro_rad is None else e.gyro_rad
    travel = 0.5 * (e.left_m + e.right_m)
    starts, inside = steps[:-1], slice(0, steps[-1])
    interval = np.repeat(np.arange(len(starts)), np.diff(steps))
    first = slice(steps[0], steps[-1])

    def since_start(values: Array) -> Array:
        """Sum from the interval's start to the middle of each step."""
        total = np.cumsum(values[inside], axis=0) - 0.5 * values[inside]
        before = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])[starts]
        return np.asarray(total[first] - before[interval])

    def summed(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, starts - starts[0]))

    heading, off = since_start(own), since_start(turn)
    c, s, f = np.cos(heading), np.sin(heading), travel[first]
    moved = np.diff(fix, axis=0)
    c0, s0 = np.cos(fix[:-1, 2]), np.sin(fix[:-1, 2])
    ahead, aside = moved[:, 0] * c0 + moved[:, 1] * s0, moved[:, 1] * c0 - moved[:, 0] * s0
    C, S, F = c[:, None], s[:, None], f[:, None]
    # Only the reference sees the body's lateral slip.
    columns_ahead = summed(forward[first] * C - F * S * off + lateral[first] * S)
    columns_aside = summed(forward[first] * S + F * C * off - lateral[first] * C)
    return [
        (summed(turn[first]), summed(own[first]) - moved[:, 2]),
        (columns_ahead, summed(f * c) - ahead),
        (columns_aside, summed(f * s) - aside),
    ]


def _lasso(r: Regression) -> Array:
    from sklearn.linear_model import LassoCV  # noqa: PLC0415  # an optional extra

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the smallest penalties do not converge
        found: Any = LassoCV(alphas=PENALTIES, cv=FOLDS, fit_intercept=False, max_iter=2000, tol=1e-3).fit(r.X, r.y)
    return np.asarray(found.coef_, float)


def _e_sindy(r: Regression) -> Array:
    import pysindy  # noqa: PLC0415  # an optional extra

    np.random.seed(0)  # pysindy uses the global generator
    optimizer: Any = pysindy.EnsembleOptimizer(pysindy.STLSQ(threshold=THRESHOLD), bagging=True, n_models=MODELS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns if it drops all columns
        optimizer.fit(r.X, r.y[:, None])
    coefficients = np.array(optimizer.coef_list).reshape(MODELS, -1)
    included = (coefficients != 0.0).mean(axis=0) > INCLUDED
    return np.asarray(np.where(included, np.median(coefficients, axis=0), 0.0), float)


def forward(r: Regression) -> Array:
    """Forward selection by n ln(RSS) + k ln n (Schwarz 1978), as if the rows' noise were independent."""
    X, left, chosen = r.X.copy(), r.y.copy(), np.zeros(r.X.shape[1])
    n = len(left)
    for _ in range(MOST):
        norms = np.linalg.norm(X, axis=0)
        free = norms > 1e-3 * math.sqrt(n)
        if not free.any():
            break
        gain = np.where(free, (X.T @ left) ** 2 / np.where(free, norms, 1.0) ** 2, 0.0)
        best = int(gain.argmax())
        if n * math.log(1.0 - gain[best] / float(left @ left)) + math.log(n) >= 0.0:
            break
        q = X[:, best] / norms[best]
        left, X = left - q * (q @ left), X - np.outer(q, q @ X)
        chosen[best] = math.sqrt(gain[best])
    return chosen


def _named(coefficients: Array, effects: Sequence[str]) -> list[str]:
    """Effects with a nonzero coefficient, sorted by the largest one of each."""
    size: dict[str, float] = {}
    for name, value in zip(effects, np.abs(coefficients).tolist(), strict=True):
        if value:
            size[name] = max(size.get(name, 0.0), value)
    return sorted(size, key=lambda name: -size[name])
