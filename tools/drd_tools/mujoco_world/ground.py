"""The ground: friction, patches of other friction, bumps."""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array

PATCH_M: Final = 2.0
PATCH_SHARE: Final = 1.0 / 3.0
PATCHES: Final = 64  # period of the pattern in each direction
BUMP_RADIUS_M: Final = (0.03, 0.08)
BUMP_HEIGHT_M: Final = (0.003, 0.012)
BUMP_ASIDE_M: Final = 0.45


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Coefficients of friction, and bumps per metre of the planned path.

    With `patch_friction` one square of PATCH_M in three has that friction instead.
    """

    friction: float = 0.8
    patch_friction: float | None = None
    bumps_per_m: float = 0.0


class Bump(NamedTuple):
    """The upper half of an ellipsoid."""

    x_m: float
    y_m: float
    radius_m: float
    height_m: float


class Friction:
    """Map of the friction coefficient, the same for the same seed."""

    def __init__(self, ground: Ground, random: np.random.Generator):
        other = random.random((PATCHES, PATCHES)) < PATCH_SHARE
        patch = ground.friction if ground.patch_friction is None else ground.patch_friction
        self._map = np.where(other, patch, ground.friction)

    def at(self, x_m: Array, y_m: Array) -> Array:
        """Coefficient at given places, shape of `x_m` and `y_m`."""
        row, column = (np.floor(value / PATCH_M).astype(int) % PATCHES for value in (x_m, y_m))
        return np.asarray(self._map[row, column])


def make_bumps(per_m: float, path_m: Array, random: np.random.Generator) -> tuple[Bump, ...]:
    """Place bumps on and beside a path, shape (n, 2) with n >= 2; a path of zero length gets none."""
    step_m = np.hypot(*np.diff(path_m, axis=0).T)
    count = round(per_m * float(step_m.sum()))
    place = random.choice(len(step_m), count, p=step_m / step_m.sum()) if count else np.zeros(0, dtype=int)
    aside = random.uniform(-BUMP_ASIDE_M, BUMP_ASIDE_M, (count, 2))
    radius, height = random.uniform(*BUMP_RADIUS_M, count), random.uniform(*BUMP_HEIGHT_M, count)
    rows = np.column_stack((path_m[place] + aside, radius, height)).tolist()
    return tuple(Bump(*row) for row in rows)
