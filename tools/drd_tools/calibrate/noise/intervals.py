"""Confidence intervals of the noise terms, by simulation: the true values under which the log's fit is likely."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from drd.arrays import Array
from drd_tools.calibrate.noise.allan import CONFIDENCE, MAX_BLOCKS, TERMS, B, Curve, Fit, K, N, Q, R, fit, shapes

SIMULATIONS: Final = 300
SEED: Final = 20010217
TAIL: Final = (1.0 - CONFIDENCE) / 2.0
# Search for an interval's end: first step (a factor on the square), how often it may be squared, bisections.
FIRST_STEP: Final = 1.02
GROWTHS: Final = 10
BISECTIONS: Final = 4
# Number of aliases of flicker noise that are summed; the rest is below 1 % at the shortest averaging time.
ALIASES: Final = 8
# A ramp is accepted if noise alone makes one as large in at most 1 of 20 logs.
RAMP_QUANTILE: Final = 0.95


@dataclass(frozen=True)
class Interval:
    """A coefficient (SI) with its 90 % interval. `low` is 0 if the log does not show the term."""

    value: float
    low: float
    high: float

    @property
    def is_visible(self) -> bool:
        """Whether the log shows the term; otherwise `high` is an upper bound that holds in 19 of 20 such logs."""
        return self.low > 0.0


class Simulator:
    """Simulator of Allan variances of logs as long as the measured one, with any noise of the model. Repeatable.

    Averaging times below one block of the curve are so well averaged that the model's misfit exceeds their
    scatter; there, points get independent errors as large as the first block's.
    """

    def __init__(self, curve: Curve, simulations: int = SIMULATIONS):
        self._curve = curve
        self.shape = shapes(curve.tau_s)
        blocks = curve.count // curve.block
        factors = tuple(int(m) for m in curve.factors[curve.factors >= curve.block] // curve.block)
        unit = unit_variances(blocks, factors, simulations)
        block_s = curve.interval_s * curve.block
        scale = np.array([block_s**-1.0, block_s**-0.5, 1.0, block_s**0.5, block_s])
        self._products = unit * scale[:, None] * scale
        short = len(curve.factors) - len(factors)
        random = np.random.default_rng(SEED + 1)
        self._errors = random.standard_normal((simulations, short)) * np.sqrt(2.0 / (MAX_BLOCKS / 2))

    def variances(self, squares: Array) -> Array:
        """Allan variances, shape (simulations, k), of noise with these squared coefficients, shape (5,)."""
        root = np.sqrt(squares)
        long = np.einsum("skij,i,j->sk", self._products, root, root, optimize=True)
        short = (self.shape[: self._errors.shape[1]] @ squares) * (1.0 + self._errors)
        return np.concatenate([short, np.maximum(long, 0.0)], axis=1)

    def estimates(self, squares: Array, terms: Sequence[int]) -> Array:
        """Fit each simulated log: squared coefficients, shape (simulations, 5)."""
        return fit(self.shape, self.variances(squares), self._curve.edf, terms).squares


@lru_cache(maxsize=8)
def unit_variances(count: int, factors: tuple[int, ...], simulations: int) -> Array:
    """Mean products of second differences, for all pairs of terms with coefficient 1 and interval 1 s.

    Shape (simulations, k, 5, 5). The Allan variance of a sum of terms is the quadratic form of their coefficients.
    """
    random = np.random.default_rng(SEED)
    result = np.empty((simulations, len(factors), len(TERMS), len(TERMS)))
    for simulation in range(simulations):
        angle = np.zeros((len(TERMS), count + 1))
        angle[:, 1:] = np.cumsum(unit_rates(count, random), axis=1)
        for row, m in enumerate(factors):
            difference = angle[:, 2 * m :] - 2.0 * angle[:, m:-m] + angle[:, : -2 * m]
            result[simulation, row] = difference @ difference.T / (2.0 * m**2 * difference.shape[1])
    return result


def unit_rates(count: int, random: np.random.Generator) -> Array:
    """One realisation of each term with coefficient 1: means of the rate over intervals of 1 s, shape (5, n)."""
    rates = np.empty((len(TERMS), count))
    rates[Q] = np.diff(random.standard_normal(count + 1))
    rates[N] = random.standard_normal(count)
    rates[B] = _flicker(count, random)
    step = random.standard_normal(count)
    # The mean of a Brownian path over a step is half of the step plus a bridge of variance 1/12.
    rates[K] = np.cumsum(step) - 0.5 * step + random.standard_normal(count) / np.sqrt(12.0)
    rates[R] = (np.arange(count) - 0.5 * count) * random.choice((-1.0, 1.0))
    return rates


def _flicker(count: int, random: np.random.Generator) -> Array:
    """Generate means over 1 s of flicker noise, in the frequency domain.

    The series is four times as long as needed, to have lower frequencies than the log and to avoid wrapping around.
    """
    density = flicker_density(4 * count)
    normal = random.standard_normal((2, len(density)))
    # irfft divides by the length.
    return np.fft.irfft((normal[0] + 1j * normal[1]) * np.sqrt(density * 2 * count), 4 * count)[:count]


def flicker_density(length: int) -> Array:
    """Two-sided spectral density of means over 1 s of flicker noise, at rfft's frequencies; 0 at f = 0.

    The noise itself has the one-sided density B^2 / (pi f), B = 1 (IEEE Std 952); taking means aliases it.
    """
    f = np.fft.rfftfreq(length)[1:]
    aliased = sum(np.sinc(f + k) ** 2 / np.abs(f + k) for k in range(-ALIASES, ALIASES + 1))
    return np.concatenate([[0.0], aliased / (2.0 * np.pi)])


def intervals(
    curve: Curve, found: Fit, simulator: Simulator, wanted: Sequence[int], on_step: Callable[[], object] = lambda: None
) -> dict[int, Interval]:
    """Find 90 % intervals of the wanted terms, by inverting a test.

    A value is in the interval if logs with that value, the other terms refitted, give estimates as low (as high) as
    the measured one in at least 5 % of the simulations. So even an estimate of 0 has a valid bound.
    """
    made = {}
    for term in wanted:
        made[term] = _interval(curve, found, simulator, term)
        on_step()
    return made


def _interval(curve: Curve, found: Fit, simulator: Simulator, term: int) -> Interval:
    measured, shape = curve.deviation**2, simulator.shape[:, term]
    others = [t for t in found.terms if t != term]
    observed = float(found.squares[term])

    def tails(square: float) -> tuple[float, float]:
        """Fractions of the simulations whose estimate is at most, and at least, the observed one."""
        squares = fit(simulator.shape, measured, curve.edf, others, square * shape).squares.copy()
        squares[term] = square
        estimates = simulator.estimates(squares, found.terms)[:, term]
        return float(np.mean(estimates <= observed)), float(np.mean(estimates >= observed))

    # An estimate of 0 has no scale of its own: begin far below the largest value that the curve allows.
    smallest = 1e-4 * float(np.min(measured / shape))
    high = _boundary(lambda square: tails(square)[0] >= TAIL, max(observed, smallest), FIRST_STEP)
    low = 0.0
    if observed > 0.0 and tails(0.0)[1] < TAIL:
        low = _boundary(lambda square: tails(square)[1] >= TAIL, observed, 1.0 / FIRST_STEP)
    return Interval(observed**0.5, low**0.5, high**0.5)


def _boundary(holds: Callable[[float], bool], start: float, factor: float) -> float:
    """Find where a condition that holds at `start` ceases to hold, up or down: growing steps, then bisection."""
    inside, outside = start, start * factor
    for _ in range(GROWTHS):
        if not holds(outside):
            break
        factor **= 2
        inside, outside = outside, start * factor
    for _ in range(BISECTIONS):
        middle = (inside * outside) ** 0.5
        if holds(middle):
            inside = middle
        else:
            outside = middle
    return outside


def shows_ramp(curve: Curve, found: Fit, simulator: Simulator) -> Fit | None:
    """Fit with a ramp, if noise without one gives as large a ramp in less than 1 of 20 logs; otherwise None."""
    terms = (*found.terms, R)
    ramped = fit(simulator.shape, curve.deviation**2, curve.edf, terms)
    if ramped.squares[R] <= 0.0:
        return None
    chance = simulator.estimates(found.squares, terms)[:, R]
    return ramped if ramped.squares[R] > np.quantile(chance, RAMP_QUANTILE) else None
