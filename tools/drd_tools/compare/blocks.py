"""Steps added up to blocks of time."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd_tools.diagnose.observe.evidence import Evidence

SHORTEST_S: Final = 2.0
USUAL: Final = 120  # blocks in a recording, where it is long enough
MOST: Final = 400
LONGEST_S: Final = 20.0  # unless the recording is so long that there are MOST
FEWEST: Final = 4  # however sparse the reference is


@dataclass(frozen=True)
class Blocks:
    """`index` (n,): the block of each step. `duration_s`, `time_s` (b,): how long each is, and its middle."""

    length_s: float
    index: npt.NDArray[np.intp]
    duration_s: Array
    time_s: Array

    def sums(self, steps: Array) -> Array:
        """Of (n,) increments or (n, k): (b,) or (b, k)."""
        found = np.zeros((len(self.duration_s), *steps.shape[1:]))
        np.add.at(found, self.index, steps)
        return found

    def means(self, steps: Array) -> Array:
        """Rates of change: sums over durations."""
        total = self.sums(steps)
        return (total.T / self.duration_s).T


def cut(e: Evidence) -> Blocks:
    """Equal blocks, as long as the reference's interval at least; a rest of less than half a block belongs to the last.

    Gaps make blocks shorter.
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
