"""How sure levels are, measured on the fleet itself: sizes of changes where there is none."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from drd.monitor.findings import Z_90
from drd_tools.fleet.changes import CREEP
from drd_tools.fleet.events import change
from drd_tools.fleet.levels import LEAST_SEEN, Series, Trend

CUTS: Final = 4  # parts of a segment, between which it is cut: the steps at more cuts have the same recordings


def inflation(every: Sequence[Series], trends: Sequence[Trend]) -> float:
    """Factor on the levels' sigmas with which 90 % of steps that are not there hold 0; never below 1. (103)

    It is 1 beforehand, with the weight of one segment.
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
    """Size and sigma of the step at each cut of a segment, found as if there was a change."""
    for k in range(1, CUTS):
        cut = first + k * (last - first + 1) // CUTS
        before, after = (kind, first, cut - 1), (kind, cut, last)
        yield change(series, series.smoothed([before, after]), before, after)
