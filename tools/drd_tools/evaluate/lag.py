"""How much later a reference shows the same turning than poses do."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.arrays import Array
from drd_tools.evaluate.trajectory import Poses, Reference

# Lidar and motion capture come up to half a second after the wheels, or before wheels that are late themselves; steps
# as fine as a fifth of the fastest reference's interval would gain nothing.
LAGS_S: Final = np.arange(-0.2, 0.8, 0.02)
LEAST_NATS: Final = 12.0  # less is not told, as in `drd diagnose`
LEAST_SQUARE: Final = 1e-30  # rad^2: no turning, or no noise


@dataclass(frozen=True)
class Lag:
    """`value_s`: positive where the reference is the later one. `nats`: log likelihood over that of none."""

    value_s: float
    nats: float


def lag_of(poses: Poses, reference: Reference) -> Lag:
    """The lag where the headings' difference changes least from row to row of the reference."""
    changes = [_changes(poses, reference, float(lag_s)) for lag_s in (0.0, *LAGS_S)]
    none, *squares = (float(np.mean(c**2)) if c.size else math.inf for c in changes)
    best = int(np.argmin(squares))
    if best in (0, len(LAGS_S) - 1):  # beyond what is searched, or no rows at all
        return Lag(float(LAGS_S[best]), 0.0)
    nats = 0.5 * (changes[best + 1].size - 1) * math.log((none + LEAST_SQUARE) / (squares[best] + LEAST_SQUARE))
    return Lag(float(LAGS_S[best]), nats)


def _changes(poses: Poses, reference: Reference, lag_s: float) -> Array:
    """Changes of the headings' difference (rad) between the rows of a reference that is so late."""
    at_s = reference.time_s - lag_s
    inside = (at_s >= poses.time_s[0]) & (at_s <= poses.time_s[-1])
    return np.diff(np.interp(at_s[inside], poses.time_s, poses.pose[:, 2]) - reference.pose[inside, 2])


def shifted(reference: Reference, lag_s: float) -> Reference:
    """The reference with its rows `lag_s` earlier."""
    return replace(reference, time_s=reference.time_s - lag_s)


def taken_off(poses: Poses, reference: Reference, lag_s: float) -> tuple[Reference, float, float]:
    """The reference less a lag, NaN: that which the headings clearly show; what was taken off, and what is left, s."""
    if lag_s == 0.0 or math.isnan(lag_s):
        found = lag_of(poses, reference)
        clear_s = found.value_s if found.nats > LEAST_NATS else 0.0
        if lag_s == 0.0:
            return reference, 0.0, clear_s
        lag_s = clear_s
    return shifted(reference, lag_s), lag_s, 0.0


def in_words(taken_s: float, left_s: float) -> Iterator[str]:
    """A sentence for a lag that was taken off, or that is left."""
    if taken_s:
        yield f"The reference's times are taken {abs(taken_s):.2f} s {'earlier' if taken_s > 0.0 else 'later'}."
    if left_s:
        yield (
            f"The reference shows turns {abs(left_s):.2f} s {'later' if left_s > 0.0 else 'earlier'} than the poses, "
            "which all errors here contain: --reference-lag auto takes that off."
        )
