"""Signs that rows of a file were lost, whatever the sensor, and the notes on rows left out. (68)"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array

MOST_LOST: Final = 0.5  # of the rows: a sensor that was lost for longer contradicts the others, which must be told
FEWEST_ALIKE: Final = 10  # rows in a row
BY_CHANCE: Final = 1e-6  # expected runs of so many equal rows, at most: else the sensor's resolution is coarse
# Times its neighbours and nearly the largest value: a robot does not turn, or drive, so fast in one row alone.
LEAP: Final = 20.0


def is_rare(repeats: npt.NDArray[np.bool_], found: Sequence[tuple[int, int]]) -> bool:
    """Whether FEWEST_ALIKE repeated rows (n,) in a row are no chance, given how many repeat outside the runs found."""
    is_single = np.ones(len(repeats), np.bool_)
    for first, last in found:
        is_single[first:last] = False
    share = float(repeats[is_single].mean()) if is_single.any() else 1.0
    return len(repeats) * share ** (FEWEST_ALIKE - 1) <= BY_CHANCE


def isolated(values: Array) -> npt.NDArray[np.bool_]:
    """Which values (n,) are LEAP times as large as both neighbours and as the others of a moving robot."""
    size = np.abs(values)
    if np.count_nonzero(size) < FEWEST_ALIKE:
        return np.zeros(len(size), np.bool_)
    around = np.maximum(np.append(size[1:], 0.0), np.insert(size[:-1], 0, 0.0))
    leap: npt.NDArray[np.bool_] = size > LEAP * np.maximum(around, np.percentile(size[size > 0.0], 95.0))
    return leap


def notes(file: str, spans_s: Sequence[tuple[float, float]], leaps_s: Array) -> tuple[str, ...]:
    """Sentences on what is left out of a file: spans in which it repeats one reading, and single rows that leap."""
    repeated = (
        f"{file} repeats one reading from {begin_s:.1f} to {end_s:.1f} s: left out" for begin_s, end_s in spans_s
    )
    if not len(leaps_s):
        return tuple(repeated)
    count = f"{len(leaps_s)} rows" if len(leaps_s) > 1 else "a row"
    leap = f"{file} has {count} {LEAP:g} times as large as any neighbour, from {leaps_s[0]:.1f} s on: left out"
    return (*repeated, leap)
