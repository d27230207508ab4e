"""Deviation, tails and colour of whitened residuals, which are white and of deviation 1 if the noise is right."""

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln, ndtri, stdtrit

from drd.arrays import Array
from drd_tools import robust

FEWEST_ROWS: Final = 50  # fewer determine a deviation to 12 % or worse
ROWS_PER_PRIOR: Final = 30  # weight of the prior of 1, in rows
SPANS_S: Final = (0.5, 2.0, 5.0, 10.0)  # of real slip and real references, which are correlated over seconds
FEWEST_BLOCKS: Final = 20  # the deviation of fewer is mostly scatter
TOGETHER_S: Final = (0.3, 0.5, 1.0, 2.0, 4.0)  # correlation times of slip, from a row or two upwards
SHARES: Final = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)  # of the variance
LEAST_COLOUR: Final = 1.15  # less may be scatter of the estimate
# Degrees of freedom of the wheels' tails, around those of real skid steer (3 to 4), up to nearly Gaussian.
FREEDOMS: Final = (2.5, 3.0, 4.0, 6.0, 10.0)
HEAVY_NATS: Final = 50.0  # required gain of tails: simulated noise, which has none, gains less than 5
LEAST_MEDIAN: Final = 1e-9  # rows without noise


def deviation(rows: Array) -> float:
    """Robust deviation of rows, shrunk towards the expected 1 if they are few."""
    if len(rows) < FEWEST_ROWS:
        return 1.0
    found = robust.deviation(rows)
    weight = len(rows) / (len(rows) + ROWS_PER_PRIOR)
    return float(np.exp(weight * np.log(max(found, 0.05))))


class Students(NamedTuple):
    """Most likely Student's t of rows (k,); a Gaussian has nu = inf."""

    nu: float
    scale: float
    nats: float


def students(rows: Array) -> Students:
    """Fit Student's t over FREEDOMS; a Gaussian unless the tails gain HEAVY_NATS. (78)"""
    median = max(float(np.median(np.abs(rows))), LEAST_MEDIAN)
    squares, found = rows**2, []
    for nu in FREEDOMS:
        scale = median / float(stdtrit(nu, 0.75))
        each = float(gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu)) - math.log(scale * math.sqrt(math.pi * nu))
        nats = len(rows) * each - 0.5 * (nu + 1.0) * float(np.log1p(squares / (nu * scale**2)).sum())
        found.append(Students(nu, scale, nats))
    scale = median / float(ndtri(0.75))
    nats = -len(rows) * math.log(scale * math.sqrt(2.0 * math.pi)) - 0.5 * float(squares.sum()) / scale**2
    found.append(Students(math.inf, scale, nats + HEAVY_NATS))
    return max(found, key=lambda one: one.nats)


def tails(rows: Array, moving: npt.NDArray[np.bool_]) -> float | Array:
    """Inflation of each row by Student's t: root of 1 + u^2/nu, 1 at rest; 1 if a Gaussian fits as well. (78)"""
    seen = rows[moving]
    found = students(seen) if len(seen) >= FEWEST_ROWS else None
    if found is None or math.isinf(found.nu):
        return 1.0
    return np.where(moving, np.sqrt(1.0 + (rows / found.scale) ** 2 / found.nu), 1.0)


def slow_deviation(rows: Array, every_s: float, drifts: bool = False) -> float:
    """Deviation of block means, times the root of the rows per block, over the worst block length: 1 for white rows.

    `drifts`: use the Allan deviation, of differences of successive means: changes over minutes are not noise.
    """
    worst = 1.0
    for span_s in SPANS_S:
        m = max(1, round(span_s / every_s))
        count = len(rows) // m
        if m < 2 or count < FEWEST_BLOCKS:
            continue
        means = rows[: count * m].reshape(count, m).sum(axis=1) / m**0.5
        if drifts:
            means = np.diff(means) / 2.0**0.5
        found = robust.deviation(means)
        # Scatter of this estimate must not be mistaken for colour.
        worst = max(worst, found / (1.0 + 2.5 * 1.17 / (2.0 * count) ** 0.5))
    return worst if worst > LEAST_COLOUR else 1.0


class Colour(NamedTuple):
    """Long-run deviation of rows under their most likely spectrum, and its log likelihood up to a constant."""

    long_run: float
    nats: float


def long_run(rows: Array, every_s: float) -> float:
    """Long-run deviation of whitened rows, at least 1, modelled as white plus correlated noise. (78)"""
    return max(colour(rows, every_s).long_run, 1.0) if len(rows) >= FEWEST_ROWS else 1.0


def colour(rows: Array, every_s: float) -> Colour:
    """Most likely spectrum (Whittle 1953), which uses all rows even if blocks of seconds are few."""
    power = np.abs(np.fft.rfft(rows - rows.mean())[1:]) ** 2 / len(rows)
    if not power.any():  # all rows equal, as from a silent sensor
        return Colour(1.0, 0.0)
    found = Colour(1.0, -math.inf)
    omega = np.pi * np.arange(1, len(power) + 1) / (0.5 * len(rows))
    for together_s in (0.0, *TOGETHER_S):
        phi = math.exp(-every_s / together_s) if together_s else 0.0
        spectrum = (1.0 - phi**2) / np.abs(1.0 - phi * np.exp(-1j * omega)) ** 2
        for share in SHARES if together_s else (0.0,):
            S = 1.0 - share + share * spectrum
            level = float(np.mean(power / S))
            nats = -float(np.log(S).sum()) - len(S) * math.log(level) - (math.log(len(rows)) if share else 0.0)
            if nats > found.nats:
                found = Colour(math.sqrt((1.0 - share + share * (1.0 + phi) / (1.0 - phi)) * level), nats)
    return found
