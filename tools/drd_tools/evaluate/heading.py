"""Heading drift: the slope of the heading error over time, with an uncertainty that allows for accumulating errors."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import stdtrit

from drd.arrays import Array
from drd.units import DEG_PER_RAD, S_PER_H

POINTS: Final = 120
BLOCKS: Final = 15
RESAMPLES: Final = 500
FEWEST_ROWS: Final = 30


@dataclass(frozen=True)
class HeadingDrift:
    """Slope in deg/h and its 95 % interval; no interval with fewer than 30 rows."""

    deg_per_h: float
    low_deg_per_h: float | None
    high_deg_per_h: float | None


def heading_drift(time_s: Array, error_rad: Array, seed: int = 0) -> HeadingDrift:
    """Slope of the continuous heading error (k,) over `time_s` (k,), k >= 2.

    The slope is the median of the slopes between all pairs of points (Theil 1950, Sen 1968), the points being means
    over 120 equal times. Heading errors accumulate, so they depart from a line like a random walk, and it is their
    increments that are exchangeable: moving blocks of them (Kuensch 1989), a 15th of the record each, are resampled,
    summed and fitted again. The interval is Student's with 14 degrees of freedom and the deviation of 500 such slopes.
    """
    # Equal times, not equal numbers of rows: dense parts of the reference must not dominate.
    edges_s = np.linspace(time_s[0], time_s[-1], POINTS + 1)[1:-1]
    cell = np.searchsorted(edges_s, time_s, side="right")
    rows = np.bincount(cell, minlength=POINTS)
    filled = rows > 0
    at_s = np.bincount(cell, time_s, POINTS)[filled] / rows[filled]
    error = np.bincount(cell, error_rad, POINTS)[filled] / rows[filled]
    i, j = np.triu_indices(len(at_s), 1)
    apart_s = at_s[j] - at_s[i]
    slope = float(np.median((error[j] - error[i]) / apart_s))
    scale = DEG_PER_RAD * S_PER_H
    if len(at_s) < FEWEST_ROWS:
        return HeadingDrift(slope * scale, None, None)
    increments = np.diff(error - slope * at_s)
    length = math.ceil(len(increments) / BLOCKS)
    rng = np.random.default_rng(seed)
    starts = rng.integers(0, len(increments) - length + 1, (RESAMPLES, BLOCKS))
    drawn = (starts[:, :, None] + np.arange(length)).reshape(RESAMPLES, -1)[:, : len(increments)]
    paths = np.column_stack([np.zeros(RESAMPLES), np.cumsum(increments[drawn], axis=1)])
    slopes = [float(np.median((path[j] - path[i]) / apart_s)) for path in paths]
    half = float(stdtrit(BLOCKS - 1, 0.975)) * float(np.std(slopes)) * math.sqrt(BLOCKS / (BLOCKS - 1))
    return HeadingDrift(slope * scale, (slope - half) * scale, (slope + half) * scale)
