"""Calibrate the uncertainty of levels on the fleet itself: sizes of steps where nothing has changed."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from drd.monitor.findings import Z_90
from drd_tools.fleet.changes import CREEP
from drd_tools.fleet.events import change
from drd_tools.fleet.levels import LEAST_SEEN, Series, Trend

CUTS: Final = 4  # parts of a segment, with a cut between each: steps at more cuts would share recordings


def inflation(every: Sequence[Series], trends: Sequence[Trend]) -> float:
    """Factor on the levels' sigmas with which the intervals of 90 % of null steps contain 0; at least 1. (103)

    Its prior is 1, with the weight of one segment.
    """
    steps = [
        [abs(size) / sigma for size, sigma in _steps(one, kind, first, last)]
        for one, trend in zip(every, trends, strict=True)
        for kind, first, last in trend.segments
        if kind != CREEP and last - first + 1 >= CUTS * LEAST_SEEN
    ]
    if not steps:
        return 1.0
    found = float(np.quantile(np.concatenate(steps), 0.9)) / Z_90
    return max(1.0, float(np.sqrt((1.0 + len(steps) * found**2) / (1.0 + len(steps)))))


def _steps(series: Series, kind: int, first: int, last: int) -> Iterator[tuple[float, float]]:
    """Size and sigma of the step at each cut of a segment, estimated as if there were a change."""
    for k in range(1, CUTS):
        cut = first + k * (last - first + 1) // CUTS
        before, after = (kind, first, cut - 1), (kind, cut, last)
        yield change(series, series.smoothed([before, after]), before, after)
