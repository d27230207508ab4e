"""Means of one parameter's values from several recordings. (89)"""

import math
from collections.abc import Sequence
from typing import Final

from drd_tools.diagnose.results import Amount

# Values of one parameter contradict each other beyond this many sigmas of their difference.
APART_SIGMAS: Final = 4.0


def sigmas(a: Amount, b: Amount) -> float:
    """Distance between two values, in sigmas of their difference."""
    return abs(a.value - b.value) / math.hypot(a.std, b.std)


def weighted(amounts: Sequence[Amount], beyond: float = 0.0) -> tuple[float, float]:
    """Mean weighted by the inverse variances, each plus `beyond`, and its standard deviation."""
    weights = [1.0 / (a.std**2 + beyond) for a in amounts]
    return sum(w * a.value for w, a in zip(weights, amounts, strict=True)) / sum(weights), sum(weights) ** -0.5


def scatter(amounts: Sequence[Amount]) -> float:
    """Variance of values from recording to recording, beyond their own deviations (DerSimonian and Laird 1986). (89)"""
    if len(amounts) < 2:
        return 0.0
    mean, std = weighted(amounts)
    weights = [a.std**-2 for a in amounts]
    excess = sum(((a.value - mean) / a.std) ** 2 for a in amounts) - (len(amounts) - 1)
    return max(0.0, excess / (sum(weights) - std**2 * sum(w**2 for w in weights)))


def mean_of(amounts: Sequence[Amount]) -> Amount:
    """Random-effects mean of values that scatter from recording to recording."""
    return Amount(*weighted(amounts, scatter(amounts)), amounts[0].unit)


def contradict(amounts: Sequence[Amount]) -> bool:
    """Whether values contradict each other, given their standard deviations."""
    if any(not a.std > 0.0 for a in amounts):
        return False
    mean, std = weighted(amounts)
    return any(abs(a.value - mean) > APART_SIGMAS * math.hypot(a.std, std) for a in amounts)
