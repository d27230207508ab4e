"""Two pieces of work timed against each other, and percentiles."""

import gc
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from statistics import median
from typing import NamedTuple

Work = Callable[[], object]


class Pairing(NamedTuple):
    """Median seconds of one call of each, and the median of the pairs' ratios, second over first."""

    first_s: float
    second_s: float
    ratio: float


def compare(first: Work, second: Work, pairs: int) -> Pairing:
    """Time both in turn, `pairs` times, each going first in every other pair.

    What disturbs the machine disturbs both of a pair, or only few pairs: the median of the ratios hardly moves.
    """
    timed = []
    with _no_collection():
        for i in range(pairs):
            if i % 2:
                b, a = seconds(second), seconds(first)
            else:
                a, b = seconds(first), seconds(second)
            timed.append((a, b))
    return Pairing(median(a for a, _ in timed), median(b for _, b in timed), median(b / a for a, b in timed))


def seconds(work: Work) -> float:
    """Wall-clock time of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def percentile(values: Sequence[float], percent: float) -> float:
    """The smallest value that at least `percent` of all do not exceed. `values` must not be empty."""
    ranked = sorted(values)
    return ranked[max(0, math.ceil(len(ranked) * percent / 100) - 1)]


@contextmanager
def _no_collection() -> Iterator[None]:
    was_enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
