"""Figures of merit of a trajectory: return error, absolute and relative trajectory error, KITTI drift."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.units import DEG_PER_RAD
from drd_tools.evaluate.alignment import align, rotation
from drd_tools.evaluate.trajectory import Pairs
from drd_tools.recordings.folder import wrapped

Indices = npt.NDArray[np.intp]

FRACTIONS: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)  # KITTI: 100 to 800 m, of paths of about 1 km
STARTS: Final = 100  # segments of each length begin at every hundredth of the path
TOLERANCE: Final = 0.1
ROUNDING: Final = 1e-9
INTERVALS_S: Final = (1.0, 10.0, 60.0)
CLOSED_M, CLOSED_SHARE = 1.0, 0.05


@dataclass(frozen=True)
class EndError:
    """Error at the last common time. Along and cross are in the reference's axes there (forward, left)."""

    time_s: float
    position_m: float
    along_m: float
    cross_m: float
    heading_deg: float
    share_of_path: float | None
    reference_to_start_m: float
    return_m: float | None  # the paper's return position error; None if the path is not closed
    return_heading_deg: float | None


@dataclass(frozen=True)
class Absolute:
    """Absolute trajectory error over the common rows."""

    rows: int
    position_rmse_m: float
    position_mean_m: float
    position_max_m: float
    heading_rmse_deg: float
    heading_max_deg: float


@dataclass(frozen=True)
class Relative:
    """Relative pose errors over segments of one length (m) or duration (s). `mean_m_per_m` is None for durations."""

    size: float
    segments: int
    position_rmse_m: float
    heading_rmse_deg: float
    mean_m_per_m: float | None
    mean_deg_per_m: float | None


@dataclass(frozen=True)
class Drift:
    """KITTI drift: means over all segments of all lengths."""

    percent: float
    deg_per_m: float
    segments: int
    shortest_m: float
    longest_m: float


def end_error(aligned: Pairs, closed_within_m: float | None) -> EndError:
    """Error of the estimate at the end.

    `|p_n - q_n|` with p the estimate and q the reference, as aligned. The paper's return position error is for closed
    paths: the estimate's displacement from its own start minus the reference's, independent of the alignment,
    `|R(-p_0) (p_n - p_0) - R(-q_0) (q_n - q_0)|`. A path is closed if the reference ends within `closed_within_m` of
    its start (None: within 5 % of the path's length, at most 1 m) and the path is more than four times as long as that
    gap.
    """
    error, path_m = aligned.error[-1], float(aligned.travelled_m[-1])
    along_m, cross_m = rotation(-float(aligned.reference[-1, 2])) @ error[:2]
    position_m = math.hypot(*error[:2])
    apart_m = math.dist(aligned.reference[-1, :2], aligned.reference[0, :2])
    within_m = min(CLOSED_M, CLOSED_SHARE * path_m) if closed_within_m is None else closed_within_m
    is_closed = apart_m <= within_m and path_m > 4.0 * apart_m
    from_start = align(aligned, "start")[0].error[-1] if is_closed else None
    return EndError(
        time_s=float(aligned.time_s[-1]),
        position_m=position_m,
        along_m=float(along_m),
        cross_m=float(cross_m),
        heading_deg=float(error[2]) * DEG_PER_RAD,
        share_of_path=position_m / path_m if path_m > 0.0 else None,
        reference_to_start_m=apart_m,
        return_m=None if from_start is None else math.hypot(*from_start[:2]),
        return_heading_deg=None if from_start is None else float(from_start[2]) * DEG_PER_RAD,
    )


def absolute_error(aligned: Pairs) -> Absolute:
    """Absolute trajectory error: `sqrt(mean |p_i - q_i|^2)`, and the mean and largest distance (Sturm et al. 2012).

    The heading error is the angle of R(q_i)^-1 R(p_i), so at most half a turn.
    """
    distance_m = np.hypot(*(aligned.estimate - aligned.reference)[:, :2].T)
    angle_deg = np.abs(wrapped(aligned.estimate[:, 2] - aligned.reference[:, 2])) * DEG_PER_RAD
    return Absolute(
        rows=len(distance_m),
        position_rmse_m=rms(distance_m),
        position_mean_m=float(distance_m.mean()),
        position_max_m=float(distance_m.max()),
        heading_rmse_deg=rms(angle_deg),
        heading_max_deg=float(angle_deg.max()),
    )


def relative_errors(pairs: Pairs, first: Indices, last: Indices) -> Array:
    """`E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j)` for rows i = `first`, j = `last`, shape (m, 3): x, y in m, angle in rad.

    Sturm et al. 2012 (relative pose error), Geiger et al. 2012 (KITTI). The alignment does not matter. x and y are in
    the axes of the reference at j, relative to its position there.
    """
    estimate, reference = _motion(pairs.estimate, first, last), _motion(pairs.reference, first, last)
    difference = estimate - reference
    xy_m = turned(difference[:, :2], -reference[:, 2])
    return np.column_stack([xy_m, wrapped(difference[:, 2])])


def _motion(pose: Array, first: Indices, last: Indices) -> Array:
    """Poses at `last` in the axes of those at `first`."""
    step = pose[last] - pose[first]
    return np.column_stack([turned(step[:, :2], -pose[first, 2]), step[:, 2]])


def turned(xy: Array, angle_rad: Array | float) -> Array:
    """Rotate vectors (m, 2) counter-clockwise, by one angle or by one each (m,); one vector (1, 2) by each angle."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.column_stack([c * xy[:, 0] - s * xy[:, 1], s * xy[:, 0] + c * xy[:, 1]])


def segments(progress: Array, size: float, step: float) -> tuple[Indices, Indices]:
    """Rows at which segments of `size` begin and end. `progress` (k,) is monotonic: metres, or seconds.

    They begin at the rows nearest to multiples of `step` and end at the row nearest to `size` later. Segments whose
    actual size differs by more than 10 % are left out, as happens with a sparse reference.
    """
    room = float(progress[-1] - progress[0]) - (1.0 - TOLERANCE) * size
    starts = progress[0] + step * np.arange(math.floor(room / step + ROUNDING) + 1.0)
    first = np.unique(_nearest(progress, starts))
    last = _nearest(progress, progress[first] + size)
    fits = np.abs(progress[last] - progress[first] - size) <= (TOLERANCE + ROUNDING) * size
    return first[fits], last[fits]


def _nearest(progress: Array, wanted: Array) -> Indices:
    after = np.clip(np.searchsorted(progress, wanted), 1, len(progress) - 1)
    tie = ROUNDING * float(progress[-1] - progress[0])  # the earlier row wins, whatever the rounding
    nearer_before = wanted - progress[after - 1] <= progress[after] - wanted + tie
    return np.where(nearer_before, after - 1, after)


def kitti_drift(pairs: Pairs) -> tuple[Drift | None, list[Relative]]:
    """Drift by the definition of the KITTI odometry benchmark (Geiger, Lenz, Urtasun 2012), scaled to the path.

    Lengths are 10, 20, ... 80 % of the path (KITTI: 100, 200, ... 800 m); segments begin at every 1 % of the path
    (KITTI: every tenth frame). Each gives `|E_xy| / length` and `|E_angle| / length`; the drift is the mean over all.
    None if no segment has both ends near rows of the reference, or the robot did not move.
    """
    path_m = float(pairs.travelled_m[-1])
    rows: list[Relative] = []
    every: list[Array] = []
    for size in (fraction * path_m for fraction in FRACTIONS if path_m > 0.0):
        first, last = segments(pairs.travelled_m, size, path_m / STARTS)
        if first.size:
            error = relative_errors(pairs, first, last)
            length_m = pairs.travelled_m[last] - pairs.travelled_m[first]
            ratios = np.column_stack([np.hypot(*error[:, :2].T), np.abs(error[:, 2]) * DEG_PER_RAD]) / length_m[:, None]
            every.append(ratios)
            rows.append(_relative(size, error, ratios))
    if not rows:
        return None, rows
    percent, deg_per_m = np.concatenate(every).mean(axis=0) * (100.0, 1.0)
    total = sum(row.segments for row in rows)
    return Drift(float(percent), float(deg_per_m), total, rows[0].size, rows[-1].size), rows


def relative_by_time(pairs: Pairs) -> list[Relative]:
    """Relative pose error over 1, 10 and 60 s: rmse over segments that begin at every row."""
    rows = []
    progress = pairs.time_s
    for size in INTERVALS_S:
        last = _nearest(progress, progress + size)
        fits = np.abs(progress[last] - progress - size) <= TOLERANCE * size
        if fits.any():
            rows.append(_relative(size, relative_errors(pairs, np.flatnonzero(fits), last[fits]), None))
    return rows


def _relative(size: float, error: Array, ratios: Array | None) -> Relative:
    means = (None, None) if ratios is None else tuple(map(float, ratios.mean(axis=0)))
    position_m, angle_deg = np.hypot(*error[:, :2].T), error[:, 2] * DEG_PER_RAD
    return Relative(size, len(error), rms(position_m), rms(angle_deg), *means)


def rms(values: Array) -> float:
    """Root mean square."""
    return math.sqrt(float(np.mean(values**2)))
