"""Products of the rows, summed over segments of time that grow longer with age: a bounded memory. (96)"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from drd.arrays import Array

# Number of segments of each length, the shortest first; each length is twice the one before.
COUNTS: Final = (20, 10, 8, 6, 6, 6, 6, 6)
FADES: Final = 0.5  # factor on the oldest, each time it absorbs one: data of an hour ago fade


@dataclass
class Segment:
    """Products of the rows `(X y)` in it, (width + 1, width + 1). `level`: log2 of its length in blocks.

    `rolled_m`: mean travel of both wheels when it began; `turning_m`: that within its turns.

    `is_white`: the noise includes the scatter of the robot's constants.
    """

    begin_s: float
    end_s: float
    distance_m: float  # when it began
    level: int
    products: Array
    is_white: bool = False
    rolled_m: float = 0.0
    turning_m: float = 0.0


class Segments:
    """Segments in order of time, the newest last. `white`: whitens a block's products for the scatter."""

    def __init__(self, white: Callable[[Array], Array]) -> None:
        self.all: list[Segment] = []
        self._white = white

    @property
    def white(self) -> list[Segment]:
        """All segments, with the scatter in their noise."""
        return [s if s.is_white else replace(s, products=self._white(s.products), is_white=True) for s in self.all]

    def add(
        self,
        begin_s: float,
        end_s: float,
        distance_m: float,
        products: Array,
        pinned: set[float],
        rolled_m: float = 0.0,
        turning_m: float = 0.0,
    ) -> None:
        """Add a block. Segments that begin or end at a pinned time are not merged, so that they stay short."""
        self.all.append(Segment(begin_s, end_s, distance_m, 0, products, False, rolled_m, turning_m))
        for level, most in enumerate(COUNTS):
            mine = [i for i, s in enumerate(self.all) if s.level == level]
            if len(mine) <= most:
                return
            free = [i for i in mine[:-1] if not any(s.begin_s in pinned for s in self.all[i : i + 3])]
            if level < len(COUNTS) - 1:
                if mine[0] in free:
                    self._merge(mine[0])
                self.all[mine[0]].level += 1  # alone, it moves on
            else:  # pinned segments stay while pinned, in addition to the usual number
                for i in free[: len(mine) - most][::-1]:
                    self._merge(i, FADES)

    def _merge(self, i: int, fades: float = 1.0) -> None:
        first, second = self.all[i], self.all.pop(i + 1)
        for one in (first, second):
            if not one.is_white:  # merged blocks can no longer be separated
                one.products, one.is_white = self._white(one.products), True
        first.products, first.end_s = fades * first.products + second.products, second.end_s
        first.turning_m += second.turning_m

    def drop_since(self, begin_s: float) -> None:
        """Forget the sums since a time."""
        self.all = [s for s in self.all if s.end_s <= begin_s]

    @property
    def begins_s(self) -> list[float]:
        """Begins of all segments."""
        return [s.begin_s for s in self.all]
