"""Align the estimate with the reference: always by a rigid motion of the plane, always stated."""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD
from drd_tools.evaluate.trajectory import Pairs
from drd_tools.recordings.folder import wrapped

KINDS: Final = ("none", "start", "first-metres", "se2")


@dataclass(frozen=True)
class Alignment:
    """Motion applied to the estimate: a rotation about the origin, then a shift. `metres`: those of first-metres."""

    kind: str
    rotation_deg: float
    x_m: float
    y_m: float
    metres: float = 0.0

    @property
    def short(self) -> str:
        """Kind, with the metres if it has any."""
        return f"{self.kind} {self.metres:g}" if self.metres else self.kind

    @property
    def sentence(self) -> str:
        """Sentence on the alignment, with its figures."""
        how = {
            "none": "none; the poses are taken as they are",
            "start": "start; the poses agree at the first common time, where the error is zero by definition",
            "first-metres": f"first {self.metres:g} metres; least squares over the positions there",
            "se2": "se2; least squares over all positions (Umeyama, without scale), which hides part of the drift",
        }[self.kind]
        moved = f" (turned by {self.rotation_deg:+.3f} deg, then shifted by {self.x_m:+.3f} m, {self.y_m:+.3f} m)"
        return how + (moved if self.kind != "none" else "")


def align(pairs: Pairs, kind: str, metres: float = 0.0) -> tuple[Pairs, Alignment]:
    """Move the estimate onto the reference.

    start: the SE(2) that makes the first rows equal. se2: `min sum |R p_i + t - q_i|^2` over all rows, in the plane
    `angle = atan2(sum dp x dq, sum dp . dq)` with dp, dq about their means (Umeyama 1991 without scale). first-metres:
    the same over the rows with at most `metres` of travel. Raises ConfigError if the positions fix no rotation.
    """
    if kind == "none":
        return pairs, Alignment(kind, 0.0, 0.0, 0.0)
    if kind == "start":
        turn = float(wrapped(pairs.reference[:1, 2] - pairs.estimate[:1, 2])[0])
        estimate_xy, reference_xy = pairs.estimate[0, :2], pairs.reference[0, :2]
    else:
        rows = pairs.travelled_m <= (metres if kind == "first-metres" else math.inf)
        p, q = pairs.estimate[rows, :2], pairs.reference[rows, :2]
        estimate_xy, reference_xy = p.mean(axis=0), q.mean(axis=0)
        dp, dq = p - estimate_xy, q - reference_xy
        dot, cross = float(np.sum(dp * dq)), float(np.sum(dp[:, 0] * dq[:, 1] - dp[:, 1] * dq[:, 0]))
        if math.hypot(dot, cross) < 1e-12:
            got = f"{int(rows.sum())} rows at one place"
            raise ConfigError("--align", kind, "positions that fix a rotation (use start, or more metres)", got)
        turn = math.atan2(cross, dot)
    R = rotation(turn)
    shift = reference_xy - R @ estimate_xy
    moved = replace(
        pairs,
        estimate=np.column_stack([pairs.estimate[:, :2] @ R.T + shift, pairs.estimate[:, 2] + turn]),
        covariance=None if pairs.covariance is None else turned_covariance(pairs.covariance, turn),
    )
    return moved, Alignment(kind, turn * DEG_PER_RAD, float(shift[0]), float(shift[1]), metres)


def rotation(angle_rad: float) -> Array:
    """Counter-clockwise 2 x 2 rotation matrix."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def turned_covariance(covariance: Array, angle_rad: float | Array) -> Array:
    """Covariances (n, 3, 3) of x, y, heading in axes turned by `angle_rad`, one angle or shape (n,)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    T = np.zeros_like(covariance)
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1], T[:, 2, 2] = c, -s, s, c, 1.0
    return np.asarray(T @ covariance @ T.transpose(0, 2, 1))
