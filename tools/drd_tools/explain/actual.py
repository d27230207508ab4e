"""Actual error over the interval, and its explanation by the budget."""

import math
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.units import DEG_PER_RAD
from drd_tools.evaluate.alignment import rotation
from drd_tools.evaluate.metrics import turned
from drd_tools.evaluate.trajectory import Reference
from drd_tools.explain.attribution import Attribution, along, attribute, inseparable, reference_joint
from drd_tools.explain.interval import Interval
from drd_tools.explain.results import Actual, Part
from drd_tools.limit.causes import CAUSES, GROUPS, SKID_SCALE
from drd_tools.recordings.folder import wrapped

DRAWN: Final = 600
REFERENCE: Final = "the reference itself"


def errors(table: Array, reference: Reference, time_s: Array, from_s: float) -> Array:
    """Estimate minus reference at `time_s` (m,), both relative to their poses at `from_s`: x, y, heading, (m, 3).

    In the estimate's axes; `table` (n, 4) has its time_s, x_m, y_m, heading_rad. Heading errors are within half a turn.
    """
    e, r = (
        np.stack([np.interp([from_s, *time_s], t, column) for column in columns.T], axis=1)
        for t, columns in ((table[:, 0], table[:, 1:]), (reference.time_s, reference.pose))
    )
    turn = e[0, 2] - r[0, 2]
    e, r = e[1:] - e[0], r[1:] - r[0]
    return np.column_stack([e[:, :2] - turned(r[:, :2], turn), wrapped(e[:, 2] - r[:, 2])])


def actual_error(interval: Interval, reference: Reference, keep_s: tuple[float, ...], from_s: float) -> Actual:
    """Judge the error at the end, and on the way if the reference's noise is stated: else it would pass for drift."""
    table, followed = interval.table(), interval.budget.parts
    assert followed is not None
    mean, covariance = followed.kept_mean, with_unknown_way(followed.kept_covariance, interval.kept_ways)
    kept_s = np.minimum(keep_s[: len(mean)], table[-1, 0])
    if not (reference.position_sigma_m > 0.0 and reference.heading_sigma_rad > 0.0):
        rows = 3 * mean.shape[1]
        kept_s, mean, covariance = kept_s[-1:], mean[-1:], covariance[-rows:, -rows:]
    start = np.array([np.interp(from_s, table[:, 0], column) for column in table[:, 1:].T])
    poses = np.stack([np.interp(kept_s, table[:, 0], column) for column in table[:, 1:].T], axis=1)
    own = reference_joint((poses - start)[:, :2], reference.position_sigma_m, reference.heading_sigma_rad)
    e = errors(table, reference, kept_s, from_s)
    course = attribute(mean, covariance, own, e.ravel())
    budget = interval.snapshots[-1].covariance.sum(axis=0)
    S = budget + own[-3:, -3:]
    last = attribute(np.zeros((1, 1, 3)), budget, own[-3:, -3:], e[-1])
    drawn_s = reference.time_s[(reference.time_s >= from_s) & (reference.time_s <= kept_s[-1])]
    drawn_s = drawn_s[np.unique(np.linspace(0, len(drawn_s) - 1, DRAWN).round().astype(int))]
    drawn = errors(table, reference, drawn_s, from_s)
    along_m, across_m = (rotation(-poses[-1, 2]) @ e[-1, :2]).tolist()
    parts, pairs = _parts(course, e[-1])
    return Actual(
        reference=reference.name,
        reference_sha256=reference.sha256,
        reference_sigma_m=reference.position_sigma_m,
        reference_sigma_deg=reference.heading_sigma_rad * DEG_PER_RAD,
        along_m=along_m,
        across_m=across_m,
        heading_deg=float(e[-1, 2]) * DEG_PER_RAD,
        sigma_m=math.sqrt(max(S[0, 0] + S[1, 1], 0.0)),
        sigma_deg=math.sqrt(max(S[2, 2], 0.0)) * DEG_PER_RAD,
        p=last.p,
        poses=len(kept_s),
        course_p=course.p,
        parts=parts,
        inseparable=pairs,
        time_s=drawn_s.tolist(),
        error_m=np.hypot(drawn[:, 0], drawn[:, 1]).tolist(),
        error_deg=(drawn[:, 2] * DEG_PER_RAD).tolist(),
    )


def with_unknown_way(covariance: Array, ways: list[Array]) -> Array:
    """Add to the kept parts' covariance that of the unknown scale of all travel, while the drive is unknown. (34)"""
    distances_m = np.zeros((len(ways), len(GROUPS), 3))
    distances_m[:, GROUPS.index(CAUSES[SKID_SCALE].group)] = ways
    return covariance + np.outer(distances_m, distances_m)


def _parts(course: Attribution, error: Array) -> tuple[list[Part], list[list[str]]]:
    """Most likely part of each group, and the pairs that cannot be distinguished, in position or heading."""
    names = (*GROUPS, REFERENCE)
    length = math.hypot(error[0], error[1])
    direction = np.array([error[0] / length, error[1] / length, 0.0]) if length > 0.0 else np.array([1.0, 0.0, 0.0])
    heading = np.array([0.0, 0.0, 1.0])
    m, m_covariance = along(course, direction)
    rad, rad_covariance = along(course, heading)
    parts = [
        Part(
            name,
            float(m[k]),
            math.sqrt(max(m_covariance[k, k], 0.0)),
            float(rad[k]) * DEG_PER_RAD,
            math.sqrt(max(rad_covariance[k, k], 0.0)) * DEG_PER_RAD,
        )
        for k, name in enumerate(names)
    ]
    pairs = {pair for covariance in (m_covariance, rad_covariance) for pair in inseparable(covariance)}
    return parts, [[names[i], names[j]] for i, j in sorted(pairs)]
