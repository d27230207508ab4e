"""Growth of the error in short windows, with the covariates temperature, yaw rate and speed."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from drd.arrays import Array, cumulative
from drd.units import DEG_PER_RAD
from drd_tools.evaluate.metrics import relative_errors
from drd_tools.evaluate.trajectory import Pairs, Reference

WINDOW_S: Final = 2.0
BINS: Final = 12
FEWEST: Final = 5  # windows in a bin


@dataclass(frozen=True)
class Windows:
    """Growth of the error in successive windows, shape (w,) each; `why_not` says why there are none.

    Yaw rate and speed are the estimate's: the reference's noise is in the error too, and would correlate it negatively
    with the reference's rate.
    """

    window_s: float
    heading_deg_s: Array
    along_m_s: Array
    rate_deg_s: Array
    speed_m_s: Array
    temperature_c: Array | None
    why_not: str = ""


def error_growth(pairs: Pairs, reference: Reference) -> Windows:
    """Relative pose error over windows of 2 s, divided by their duration. The alignment does not matter."""
    none = np.empty(0)
    if not pairs.is_dense:
        return Windows(WINDOW_S, none, none, none, none, None, "not determined: the reference is sparse")
    wanted_s = np.arange(pairs.time_s[0], pairs.time_s[-1], WINDOW_S)
    rows = np.unique(np.searchsorted(pairs.time_s, wanted_s))
    first, last = rows[:-1], rows[1:]
    duration_s = pairs.time_s[last] - pairs.time_s[first]
    fits = duration_s <= 2.0 * WINDOW_S
    first, last, duration_s = first[fits], last[fits], duration_s[fits]
    if first.size < FEWEST:
        return Windows(WINDOW_S, none, none, none, none, None, f"not determined: {first.size} windows of 2 s")
    error = relative_errors(pairs, first, last)
    travel_m = cumulative(np.hypot(*np.diff(pairs.estimate[:, :2], axis=0).T))
    temperature_c = None
    if reference.temperature is not None:
        middle_s = 0.5 * (pairs.time_s[first] + pairs.time_s[last])
        temperature_c = np.interp(middle_s, *reference.temperature)
    return Windows(
        WINDOW_S,
        error[:, 2] * DEG_PER_RAD / duration_s,
        error[:, 0] / duration_s,
        (pairs.estimate[last, 2] - pairs.estimate[first, 2]) * DEG_PER_RAD / duration_s,
        (travel_m[last] - travel_m[first]) / duration_s,
        temperature_c,
    )


def binned(covariate: Array, growth: Array) -> Array:
    """Means over bins of the covariate, shape (b, 4): covariate, mean growth, its standard error, number of windows.

    A bin is wider than a twelfth of the covariate's range and has at least five windows. The standard error is
    `s / sqrt(n)`, s the scatter in the bin.
    """
    order = np.argsort(covariate, kind="stable")
    covariate, growth = covariate[order], growth[order]
    width = float(np.ptp(covariate)) / BINS
    begins = [0]
    for k in range(1, len(covariate)):
        if covariate[k] - covariate[begins[-1]] > width and k - begins[-1] >= FEWEST and len(covariate) - k >= FEWEST:
            begins.append(k)
    rows = []
    for begin, end in pairwise([*begins, len(covariate)]):
        n, chosen = end - begin, growth[begin:end]
        rows.append((covariate[begin:end].mean(), chosen.mean(), np.std(chosen, ddof=1) / math.sqrt(n), n))
    return np.array(rows, float)
