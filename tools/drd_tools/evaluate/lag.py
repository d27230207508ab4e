"""Lag of a reference: how much later it shows the same turns than the poses."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.arrays import Array
from drd_tools.evaluate.trajectory import Poses, Reference

# Lidar and motion capture lag the wheels by up to half a second, or lead wheels that are late themselves; steps finer
# than a fifth of the fastest reference's interval would gain nothing.
LAGS_S: Final = np.arange(-0.2, 0.8, 0.02)
LEAST_NATS: Final = 12.0  # less is not reported, as in `drd diagnose`
LEAST_SQUARE: Final = 1e-30  # rad^2: no turning, or no noise
FEWEST_ROWS: Final = 3  # of a reference: two changes


@dataclass(frozen=True)
class Lag:
    """Estimated lag. `value_s`: positive if the reference is late. `nats`: log-likelihood ratio to no lag.

    Both are 0 if `is_sought` is False: too few rows of the reference are within the poses for every lag.
    """

    value_s: float
    nats: float
    is_sought: bool = True


def lag_of(poses: Poses, reference: Reference) -> Lag:
    """Find the lag at which the heading difference changes least from row to row of the reference, using only rows that
    are within the poses for every lag: others would bias the choice.
    """
    if not len(poses.time_s):
        return Lag(0.0, 0.0, is_sought=False)
    early, late = reference.time_s - LAGS_S[-1], reference.time_s - LAGS_S[0]
    inside = (early >= poses.time_s[0]) & (late <= poses.time_s[-1])
    if np.count_nonzero(inside) < FEWEST_ROWS:
        return Lag(0.0, 0.0, is_sought=False)
    at_s, heading_rad = reference.time_s[inside], reference.pose[inside, 2]
    none, *squares = (_mean_square(poses, at_s - float(lag_s), heading_rad) for lag_s in (0.0, *LAGS_S))
    best = int(np.argmin(squares))
    if best in (0, len(LAGS_S) - 1):  # at the edge of the search
        return Lag(float(LAGS_S[best]), 0.0)
    nats = 0.5 * (len(at_s) - 2) * math.log((none + LEAST_SQUARE) / (squares[best] + LEAST_SQUARE))
    return Lag(float(LAGS_S[best]), nats)


def _mean_square(poses: Poses, at_s: Array, heading_rad: Array) -> float:
    """Mean square, rad^2, of the row-to-row changes of the heading difference."""
    return float(np.mean(np.diff(np.interp(at_s, poses.time_s, poses.pose[:, 2]) - heading_rad) ** 2))


def shifted(reference: Reference, lag_s: float) -> Reference:
    """Shift the reference's rows `lag_s` earlier."""
    return replace(reference, time_s=reference.time_s - lag_s)


def taken_off(poses: Poses, reference: Reference, lag_s: float) -> tuple[Reference, float, float | None]:
    """Correct the reference for a lag, NaN: the one that the headings clearly show; return it, the correction and the
    remaining lag, s, which is None if a lag was to be estimated and could not be.
    """
    if lag_s != 0.0 and not math.isnan(lag_s):
        return shifted(reference, lag_s), lag_s, 0.0
    found = lag_of(poses, reference)
    clear_s = found.value_s if found.nats > LEAST_NATS else 0.0
    if lag_s == 0.0:
        return reference, 0.0, clear_s
    return shifted(reference, clear_s), clear_s, 0.0 if found.is_sought else None


def in_words(taken_s: float, left_s: float | None) -> Iterator[str]:
    """Sentence on a lag that was corrected, that remains, or that could not be estimated."""
    if taken_s:
        yield f"The reference is shifted {abs(taken_s):.2f} s {'earlier' if taken_s > 0.0 else 'later'}."
    if left_s is None:
        yield (
            "The lag of the reference is not estimated but taken as 0: an estimate needs "
            f"{FEWEST_ROWS} of its rows from {LAGS_S[-1]:.1f} s after the first pose to {-LAGS_S[0]:.1f} s before "
            "the last."
        )
    elif left_s:
        yield (
            f"The reference shows turns {abs(left_s):.2f} s {'later' if left_s > 0.0 else 'earlier'} than the poses, "
            "which is part of all errors here: --reference-lag auto corrects for it."
        )
