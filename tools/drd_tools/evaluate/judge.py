"""Compute all figures of one estimate against one reference."""

from typing import Final

import numpy as np

from drd.units import DEG_PER_RAD
from drd_tools.evaluate.alignment import Alignment, align
from drd_tools.evaluate.consistency import consistency, total_covariance, track_sigmas
from drd_tools.evaluate.growth import error_growth
from drd_tools.evaluate.heading import heading_drift
from drd_tools.evaluate.lag import taken_off
from drd_tools.evaluate.metrics import absolute_error, end_error, kitti_drift, relative_by_time, turned
from drd_tools.evaluate.results import Run, Series
from drd_tools.evaluate.trajectory import MAX_GAP_S, Pairs, Poses, Reference, associate
from drd_tools.limit.limit import Limit

DRAWN_ROWS: Final = 2000
TRACK: Final = np.array((1.0, 1.0, DEG_PER_RAD))


def judge(
    poses: Poses,
    reference: Reference,
    *,
    kind: str = "start",
    metres: float = 0.0,
    max_gap_s: float = MAX_GAP_S,
    closed_within_m: float | None = None,
    lag_s: float = 0.0,
    limit: Limit | None = None,
) -> Run:
    """Associate, align and measure. `lag_s`: lag of the reference, NaN: estimate it from the headings; `limit`: that
    of the recording. Raises ConfigError if the two have too little in common.
    """
    reference, taken_s, left_s = taken_off(poses, reference, lag_s)
    pairs = associate(poses, reference, max_gap_s)
    aligned, alignment = align(pairs, kind, metres)
    drift, by_length = kitti_drift(pairs)
    return Run(
        name=poses.name,
        reference=reference.name,
        poses_sha256=poses.sha256,
        reference_sha256=reference.sha256,
        position_sigma_m=reference.position_sigma_m,
        heading_sigma_deg=reference.heading_sigma_rad * DEG_PER_RAD,
        alignment=alignment,
        rows=len(pairs.time_s),
        outside=pairs.outside,
        in_gaps=pairs.in_gaps,
        max_gap_s=max_gap_s,
        duration_s=float(pairs.time_s[-1] - pairs.time_s[0]),
        path_m=float(pairs.travelled_m[-1]),
        is_dense=pairs.is_dense,
        end=end_error(aligned, closed_within_m),
        absolute=absolute_error(aligned),
        drift=drift,
        by_length=by_length,
        by_time=relative_by_time(pairs),
        heading=heading_drift(pairs.time_s, aligned.error[:, 2]),
        consistency=consistency(aligned, alignment, reference),
        windows=error_growth(pairs, reference),
        series=_series(aligned, alignment, reference),
        limit=limit,
        lag_taken_s=taken_s,
        lag_left_s=left_s,
    )


def _series(aligned: Pairs, alignment: Alignment, reference: Reference) -> Series:
    """Thin out the drawn series evenly; the first and the last row stay."""
    count = min(len(aligned.time_s), DRAWN_ROWS)
    rows = np.unique(np.linspace(0, len(aligned.time_s) - 1, count).round().astype(int))
    S = total_covariance(aligned, alignment, reference)
    heading_rad = aligned.reference[:, 2]
    error = np.column_stack([turned(aligned.error[:, :2], -heading_rad), aligned.error[:, 2]])
    return Series(
        aligned.time_s[rows],
        aligned.estimate[rows, :2],
        aligned.reference[rows, :2],
        (error * TRACK)[rows],
        None if S is None else (track_sigmas(S, heading_rad) * TRACK)[rows],
    )
