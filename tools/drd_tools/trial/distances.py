"""All distances: how well each manoeuvre separates each effect of the catalogue from each of the others. (93)

`measured`: one effect in one manoeuvre; `calls`: all of them. `Distances`: all rows, as a matrix for each manoeuvre,
and the pairs sorted by how well the best manoeuvre separates them. The robot is the simulator's; its sensors are free
of noise, and weighted by their datasheets.
"""

import csv
import math
import zlib
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd.effects.motion import Motion
from drd_tools.diagnose.advise.manoeuvres import MANOEUVRES, Part, drive, lap_s
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.simulate.conditions import PERFECT
from drd_tools.simulate.files import effect_rows
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.trial.distance import ALIKE, Rivals, nearest
from drd_tools.trial.size import NEAR, Whitener, selected_of

MINUTES: Final = 3  # per drive, long enough for the gyro to cool down in some of them
SIZE: Final = 12.0  # distance of each effect from nothing: clearly detectable
COLUMNS: Final = ("manoeuvre", "effect", "size", "rival", "distance")


class Measured(Struct, frozen=True):
    """An effect in a manoeuvre: parameters in the catalogue's units, `size` (its distance from nothing), and its
    distances from each other name and from nothing; none if the manoeuvre cannot show it at a plausible size.
    """

    manoeuvre: str
    effect: str
    parameters: dict[str, float | str]
    size: float
    distances: dict[str, float]


class Pair(NamedTuple):
    """Two effects of a stated size, and for each manoeuvre the smaller of their two distances from each other."""

    names: tuple[str, str]
    by_manoeuvre: dict[str, float]

    @property
    def best(self) -> str:
        """Manoeuvre that separates them best."""
        return max(self.by_manoeuvre, key=lambda m: self.by_manoeuvre[m])

    @property
    def worst(self) -> str:
        """Manoeuvre that separates them least."""
        return min(self.by_manoeuvre, key=lambda m: self.by_manoeuvre[m])

    @property
    def farthest(self) -> float:
        """Their distance in the best manoeuvre."""
        return self.by_manoeuvre[self.best]


def calls(seed: int, manoeuvres: Sequence[str] = tuple(MANOEUVRES)) -> list[Callable[[], Measured]]:
    """Make a call for each manoeuvre and effect. `seed`: that of times, phases and ratios of the parameters."""
    return [partial(measured, manoeuvre, name, seed) for manoeuvre in manoeuvres for name in catalogue()]


def measured(manoeuvre: str, name: str, seed: int) -> Measured:
    """Measure the distances of an effect of SIZE from all others. One that destroys readings may be larger."""
    motion, problem, rivals = _prepared(manoeuvre)
    whitener, effect = Whitener(problem, motion), catalogue()[name]
    random = np.random.default_rng([seed, zlib.crc32(name.encode())])
    way = whitener.event if effect.irreversible else whitener.plantable
    sized = way(effect, SIZE, random)
    if sized is None or sized[1] < SIZE / NEAR:
        return Measured(manoeuvre, name, {}, 0.0, {})
    (one,), (row,) = selected_of([(effect, sized[0])]), effect_rows([(effect, sized[0])])
    found = {near.name: round(near.distance, 3) for near in nearest(problem, one, [], rivals)}
    return Measured(manoeuvre, name, row["parameters"], round(sized[1], 3), found)


@lru_cache(maxsize=1)
def _prepared(manoeuvre: str) -> tuple[Motion, Problem, Rivals]:
    laps = math.ceil(60.0 * MINUTES / lap_s(manoeuvre))
    truth = drive([Part(manoeuvre, laps)], DEFAULT.standstill_at_start_s)
    made = simulate(truth, DEFAULT, (), PERFECT, name=manoeuvre)
    problem = Problem(gather(made.recording))
    return made.motion, problem, Rivals(problem, list(catalogue()))


class Distances:
    """All measured distances, and figures derived from them."""

    def __init__(self, rows: Sequence[Measured]):
        order, names = list(MANOEUVRES), list(catalogue())
        self.rows = sorted(rows, key=lambda r: (order.index(r.manoeuvre), names.index(r.effect)))
        self.manoeuvres = [m for m in order if any(r.manoeuvre == m for r in rows)]
        self.names = names

    def matrix(self, manoeuvre: str) -> Array:
        """Distances (effect, rival); NaN on the diagonal, and in the rows of effects that are not visible."""
        of = {r.effect: r.distances for r in self.rows if r.manoeuvre == manoeuvre}
        return np.array([[of.get(a, {}).get(b, np.nan) if a != b else np.nan for b in self.names] for a in self.names])

    def best(self) -> Array:
        """Distances (effect, rival), each in the manoeuvre that separates the two best."""
        best: Array = np.fmax.reduce([self.matrix(m) for m in self.manoeuvres])
        return best

    def pairs(self) -> list[Pair]:
        """All pairs of which some manoeuvre shows at least one, the least separated first."""
        matrices = {m: np.fmin(d, d.T) for m in self.manoeuvres for d in [self.matrix(m)]}
        found = []
        for i, a in enumerate(self.names):
            for k, b in enumerate(self.names[:i]):
                seen = {m: float(d[i, k]) for m, d in matrices.items() if np.isfinite(d[i, k])}
                if seen:
                    found.append(Pair((b, a), seen))
        return sorted(found, key=lambda p: (p.farthest, p.names))

    def unseen(self, manoeuvre: str) -> list[str]:
        """Effects that a manoeuvre cannot show at a plausible size."""
        return [r.effect for r in self.rows if r.manoeuvre == manoeuvre and not r.distances]

    def alike(self, manoeuvre: str) -> int:
        """Count the pairs that are look-alikes in a manoeuvre."""
        d = self.matrix(manoeuvre)
        return int((np.fmin(d, d.T)[np.triu_indices(len(d), 1)] < ALIKE).sum())

    def write(self, folder: Path) -> list[Path]:
        """Write distances.csv, a line for each manoeuvre, effect and rival, and distances.json. Raises OSError."""
        files = [folder / "distances.csv", folder / "distances.json"]
        with files[0].open("w", encoding="utf-8", newline="") as out:
            writer = csv.writer(out, lineterminator="\n")
            writer.writerow(COLUMNS)
            for r in self.rows:
                writer.writerows((r.manoeuvre, r.effect, r.size, b, d) for b, d in r.distances.items())
        content = msgspec.json.encode({"minutes": MINUTES, "size": SIZE, "rows": self.rows})
        files[1].write_bytes(msgspec.json.format(content, indent=1) + b"\n")
        return files
