"""Effect of noise alone on each channel: nominal recordings, simulated along the same path, treated alike. (65)"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.optimize import nnls
from tqdm import tqdm

from drd.arrays import Array, cumulative
from drd_tools.compare.blocks import Blocks
from drd_tools.compare.mismatch import Standstill, kinds_of, mismatches, reference_errors, white
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.error_model.nominal_path import follow
from drd_tools.diagnose.error_model.path import Path
from drd_tools.diagnose.observe.evidence import Evidence

BLOCKS_WANTED: Final = 480  # in all draws together: gives sigmas to about 3 %
FEWEST_DRAWS: Final = 4
MOST_DRAWS: Final = 12
LAGS: Final = 24
LEAST: Final = 0.3  # of the median sigma in motion: no block outweighs about ten others


class Expected:
    """Expected covariance of a channel's block means, by noise and by a late, turned or displaced reference.

    `noise` (b, b): covariance by noise alone. `reference` (b, k): effect of one sigma of each error of the reference.
    `independent`: effective number of independent blocks for the size of the noise.
    """

    def __init__(self, noise: Array, reference: Array, independent: float):
        self.noise, self.reference, self.independent = noise, reference, independent
        self._L = cholesky(noise + reference @ reference.T, lower=True)

    def whiten(self, rows: Array) -> Array:
        """Whiten: L^-1 rows, L L^T the whole covariance; the part of each block that earlier ones do not predict."""
        return np.asarray(solve_triangular(self._L, rows, lower=True))

    def fit_reference(self, means: Array) -> tuple[Array, Array]:
        """Estimate the reference's errors (k,) from block means (b,), in prior sigmas, with covariance (k, k)."""
        N = self.whiten(self.reference)
        return N.T @ self.whiten(means), np.eye(N.shape[1]) - N.T @ N


def expected(e: Evidence, path: Path, blocks: Blocks, still: Standstill, seed: int = 0) -> dict[str, Expected]:
    """Expected covariance of each channel of the recording."""
    count = int(np.clip(BLOCKS_WANTED // len(blocks.time_s), FEWEST_DRAWS, MOST_DRAWS))
    rng = np.random.default_rng(seed)
    names = [kind.id for kind in kinds_of(e)]
    draws: dict[str, list[Array]] = {name: [] for name in names}
    for drawn, its_path in _simulated(e, path, rng, count):
        found = mismatches(drawn, its_path, Sensitivity(), 0.0)
        for name in names:
            draws[name].append(blocks.means(found[name]))
    variances, disturbed = white(e), reference_errors(e, path)
    result = {}
    for name in names:
        C = _fast(np.array(draws[name]), blocks.sums(variances[name]) / blocks.duration_s**2)
        R = C / np.sqrt(np.outer(np.diag(C), np.diag(C)))
        independent = len(C) ** 2 / float((R * R).sum())
        if name in ("gyro", "wheels_gyro"):
            C = C + _slow(e, blocks, still)
        columns = [blocks.means(steps) for _, steps in disturbed.get(name, [])]
        result[name] = Expected(C, np.array(columns).reshape(-1, len(C)).T, independent)
    return result


def _simulated(e: Evidence, path: Path, rng: np.random.Generator, count: int) -> Iterator[tuple[Evidence, Path]]:
    for _ in tqdm(range(count), desc="simulating noise", leave=False, disable=None):
        drawn = draw(e, path, rng)
        yield drawn, follow(drawn)


def draw(e: Evidence, path: Path, rng: np.random.Generator) -> Evidence:
    """Simulate the nominal robot on this path, with the noise of its datasheets and no gyro bias."""
    sheet, n = e.datasheet, len(e.time_s)
    moves = e.travel_m > 0.0
    forward, _, turn = path.steps()
    forward, turn = forward * moves, turn * moves
    lateral = sheet.lateral_m_per_sqrt_m * np.sqrt(0.5 * e.travel_m) * rng.standard_normal(n)
    heading = path.pose[0, 2] + cumulative(turn)
    c, s = np.cos(heading[1:] - 0.5 * turn), np.sin(heading[1:] - 0.5 * turn)
    x = path.pose[0, 0] + cumulative(forward * c - lateral * s)
    y = path.pose[0, 1] + cumulative(forward * s + lateral * c)
    pose = np.column_stack([x, y, heading])
    half = 0.5 * e.tread_m
    wheels = []
    for travel, recorded in ((forward - half * turn, e.left_m), (forward + half * turn, e.right_m)):
        slip = sheet.slip_m_per_sqrt_m * np.sqrt(np.abs(recorded)) * rng.standard_normal(n)
        # A counter's reading is off by up to half a count until it changes again.
        off = sheet.count_m * rng.uniform(-0.5, 0.5, n + 1)
        newest = np.concatenate([[0], np.maximum.accumulate(np.where(moves, np.arange(1, n + 1), 0))])
        wheels.append(travel + slip + np.diff(off[newest]))
    after = pose[e.fix_step + 1]
    fix = after + e.fix_share[:, None] * (pose[e.fix_step] - after)
    fix = fix + rng.standard_normal(fix.shape) * (sheet.position_m, sheet.position_m, sheet.heading_rad)
    gyro = None if e.gyro_rad is None else turn + np.sqrt(sheet.gyro(e)) * rng.standard_normal(n)
    return replace(e, gyro_rad=gyro, left_m=wheels[0], right_m=wheels[1], fix=fix)


def _fast(draws: Array, q: Array) -> Array:
    """Covariance (b, b) from draws (k, b): each block's variance is a multiple of its `q` (b,) plus a constant.

    The correlation depends only on the distance of two blocks; a Bartlett window keeps it positive definite.
    """
    count, n = draws.shape
    variance = np.mean(draws**2, axis=0)
    scale = float(variance.mean())
    if scale == 0.0:
        return 1e-18 * np.eye(n)
    weight = 1.0 / (variance + scale)
    share, _ = nnls(np.column_stack([q, np.full(n, scale)]) * weight[:, None], variance * weight)
    sigma = np.sqrt(share[0] * q + share[1] * scale)
    # Wheels at rest are exact; trusted as such, they would outweigh all blocks with motion.
    moves = q > 0.0 if q.any() else np.ones(n, bool)
    sigma = np.maximum(sigma, LEAST * float(np.median(sigma[moves])))
    sigma = np.maximum(sigma, 1e-3 * scale**0.5)
    u = draws / sigma
    lags = np.arange(min(LAGS, n))
    r = np.array([float((u[:, : n - k] * u[:, k:]).sum()) / (count * n) for k in lags])
    r *= 1.0 - lags / LAGS
    full = np.zeros(n)
    full[: len(r)] = r
    C: Array = toeplitz(full) * np.outer(sigma, sigma)
    return C + 1e-6 * scale * np.eye(n)


def _slow(e: Evidence, blocks: Blocks, still: Standstill) -> Array:
    """Covariance by the gyro bias: its uncertainty after the standstill, and its random walk from there on."""
    sheet = e.datasheet
    variance = sheet.walk_rad_per_sqrt_s**2 / still.seen_s if still.seen_s > 0.0 else sheet.bias_rad_s**2
    since = np.maximum(blocks.time_s - float(e.time_s[0]) - 0.5 * still.seen_s, 0.0)
    walk = sheet.bias_walk_rad_s_per_sqrt_s**2 * np.minimum.outer(since, since)
    return np.full(walk.shape, variance) + walk
