"""Sum steps to blocks of time."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd_tools.diagnose.observe.evidence import Evidence

SHORTEST_S: Final = 2.0
USUAL: Final = 120  # blocks in a recording that is long enough
MOST: Final = 400
LONGEST_S: Final = 20.0  # unless that gives more than MOST blocks
FEWEST: Final = 4  # even with a sparse reference


@dataclass(frozen=True)
class Blocks:
    """Blocks of steps. `index` (n,): block of each step. `duration_s`, `time_s` (b,): duration and middle of each."""

    length_s: float
    index: npt.NDArray[np.intp]
    duration_s: Array
    time_s: Array

    def sums(self, steps: Array) -> Array:
        """Sum increments (n,) or (n, k) by block: (b,) or (b, k)."""
        found = np.zeros((len(self.duration_s), *steps.shape[1:]))
        np.add.at(found, self.index, steps)
        return found

    def means(self, steps: Array) -> Array:
        """Rates of change: sums over durations."""
        total = self.sums(steps)
        return (total.T / self.duration_s).T


def cut(e: Evidence) -> Blocks:
    """Cut into equal blocks, at least as long as the reference's interval; a remainder of less than half a block joins
    the last one. Gaps make blocks shorter.
    """
    begin = float(e.time_s[0] - e.step_s[0])
    whole = float(e.time_s[-1]) - begin
    length = max(SHORTEST_S, min(whole / USUAL, LONGEST_S), whole / MOST)
    if len(e.fix) > 1:
        length = min(max(length, float(np.median(np.diff(e.time_s[e.fix_step])))), max(whole / FEWEST, SHORTEST_S))
    middle = e.time_s - 0.5 * e.step_s
    count = max(int(whole / length + 0.5), 1)
    raw = np.minimum(((middle - begin) / length).astype(np.intp), count - 1)
    _, index = np.unique(raw, return_inverse=True)
    duration = np.bincount(index, weights=e.step_s).astype(float)
    time: Array = np.bincount(index, weights=middle * e.step_s) / duration
    return Blocks(length, index, duration, time)
