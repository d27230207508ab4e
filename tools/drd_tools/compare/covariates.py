"""Covariates on which a mismatch may depend, and the design matrices of curves over them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d

from drd.arrays import Array
from drd.units import DEG_PER_RAD
from drd_tools.compare.blocks import Blocks
from drd_tools.diagnose.error_model.path import Path
from drd_tools.diagnose.error_model.sensitivities import SUB, motion_along
from drd_tools.diagnose.observe.evidence import Evidence

MOST_KNOTS: Final = 9
BLOCKS_PER_KNOT: Final = 6
MOST_TIME_KNOTS: Final = 18  # events in time are narrower than dependences on speed or temperature
BLOCKS_PER_TIME_KNOT: Final = 5
FEWEST_KNOTS: Final = 3
TURN_DEG: Final = 360.0
ACCELERATION_SMOOTHING_S: Final = 0.3
# Spread below which a covariate counts as constant.
SMALLEST: Final = {"temperature": 0.3, "speed": 0.02, "yaw rate": 0.5}


@dataclass(frozen=True)
class Covariate:
    """A covariate. `knots` (k,), or (k, 2) for the place. `design` (b, k): share of each block's time at each knot.

    A mismatch that is a piecewise linear curve of the covariate, with values c at the knots, has the block means
    `design @ c`.
    """

    name: str
    unit: str
    knots: Array
    design: Array


def covariates_of(e: Evidence, path: Path, blocks: Blocks) -> list[Covariate]:
    """Covariates that vary in this recording."""
    motion = motion_along(e, path)
    typical_s = float(np.median(e.step_s)) / SUB
    rate = gaussian_filter1d(motion.rate_rad_s, ACCELERATION_SMOOTHING_S / typical_s)
    values = (
        ("time", "s", motion.time_s),
        ("yaw rate", "deg/s", motion.rate_rad_s * DEG_PER_RAD),
        ("yaw acceleration", "deg/s2", np.gradient(rate, motion.time_s) * DEG_PER_RAD),
        ("speed", "m/s", motion.speed_m_s),
        ("acceleration", "m/s2", motion.acceleration_m_s2),
        ("temperature", "degC", motion.temperature_c),
        ("heading", "deg", np.mod(motion.heading_rad * DEG_PER_RAD, TURN_DEG)),
    )
    weight = np.repeat(e.step_s, SUB) / SUB
    index = np.repeat(blocks.index, SUB)
    fine = Blocks(blocks.length_s, index, blocks.duration_s, blocks.time_s)
    usual = int(np.clip(len(blocks.time_s) // BLOCKS_PER_KNOT, FEWEST_KNOTS, MOST_KNOTS))

    def design(shares: Array) -> Array:
        return fine.means(shares * weight[:, None])

    found = []
    for name, unit, value in values:
        if not np.isfinite(value).all():
            continue
        low, high = np.percentile(value, (0.5, 99.5)).tolist()
        if high - low <= SMALLEST.get(name, 1e-6):
            continue
        is_circle = name == "heading"
        many = min(len(blocks.time_s) // BLOCKS_PER_TIME_KNOT, MOST_TIME_KNOTS) if name == "time" else 0
        count = max(usual, many)
        knots: Array = np.linspace(0.0, TURN_DEG, count, endpoint=False) if is_circle else np.linspace(low, high, count)
        kept, shares = _kept(knots, partial(_hat_design, design, value, is_circle))
        if len(kept) >= FEWEST_KNOTS:
            found.append(Covariate(name, unit, kept, shares))
    x, y = (np.interp(motion.time_s, e.time_s, path.pose[1:, k]) for k in (0, 1))
    place = _places(x, y, usual, design)
    return [*found, place] if place is not None else found


def _hat_design(design: Callable[[Array], Array], value: Array, is_circle: bool, knots: Array) -> Array:
    return design(_hats(value, knots, is_circle))


def _hats(value: Array, knots: Array, is_circle: bool) -> Array:
    """Hat functions (n, k): 1 at a knot, 0 at its neighbours, with sum 1."""
    eye = np.eye(len(knots))
    period = TURN_DEG if is_circle else None
    return np.column_stack([np.interp(value, knots, row, period=period) for row in eye])


def _kept(knots: Array, design: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Drop knots at which the robot spent less than a block in total."""
    while True:
        shares = design(knots)
        total = shares.sum(axis=0)
        poorest = int(total.argmin())
        if total[poorest] >= 1.0 or len(knots) <= FEWEST_KNOTS:
            return (knots, shares) if total[poorest] >= 0.5 else (knots[:0], shares[:, :0])
        knots = np.delete(knots, poorest, axis=0)


def _places(x: Array, y: Array, count: int, design: Callable[[Array], Array]) -> Covariate | None:
    """Bell functions on a square grid over the area, with sum 1."""
    width, height = float(np.ptp(x)), float(np.ptp(y))
    if max(width, height) <= 0.0:
        return None
    cell = max((width * height / (count + 3)) ** 0.5, max(width, height) / (count + 3))
    gx, gy = (np.arange(v.min() + 0.5 * cell, v.max() + 0.5 * cell, cell) for v in (x, y))
    grid = np.array([(a, b) for a in gx for b in gy])

    def bells(knots: Array) -> Array:
        d2 = (x[:, None] - knots[:, 0]) ** 2 + (y[:, None] - knots[:, 1]) ** 2
        d2 -= d2.min(axis=1, keepdims=True)
        w = np.exp(-2.0 * d2 / cell**2)
        result: Array = w / w.sum(axis=1, keepdims=True)
        return design(result)

    knots, shares = _kept(grid, bells)
    return Covariate("place", "m", knots, shares) if len(knots) >= FEWEST_KNOTS else None
