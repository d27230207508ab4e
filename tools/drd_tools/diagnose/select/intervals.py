"""Effects limited to an interval of time: all intervals of a fine grid are scored from its pieces' sensitivities."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd.effects.effect import END, START, Effect
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.selected import Selected, Values, parameter

Columns = npt.NDArray[np.float32]
Pieces = npt.NDArray[np.intp]

PIECES: Final = 32  # a multiple of the pieces in the catalogue's own variants
LONGEST: Final = PIECES // 2  # longer effects are found in part and then extended; permanent ones are no interval
MEET_S: Final = 5.0  # longest gap that the grid leaves between two parts of one interval
FEWEST_SIZES: Final = 6  # their scatter is known to 30 %
LEAST_SCATTER: Final = 1.5  # less may be chance: intervals overlap
MOVES: Final = (0.003, 0.006, 0.012, 0.024)  # of a recording: the catalogue's own moments are 0.025 apart
LEFT_SHARE: Final = 1e-2  # of an interval's square that must remain after projecting out the held effects


def is_of_interval(effect: Effect) -> bool:
    """Whether an effect's parameters are `t0`, `t1` and linear sizes."""
    linear = effect.linear()
    return bool(linear) and {q.name for q in effect.parameters} == {START.name, END.name, *linear}


class Best(NamedTuple):
    """An interval: the nats it explains, its times, and the sizes."""

    nats: float
    shape: dict[str, float | str]
    sizes: Array


class Intervals:
    """One effect in all intervals. (82) `columns` (r, k PIECES): whitened sensitivities of each size in each piece."""

    def __init__(self, problem: Problem, effect: Effect):
        m = problem.sensitivities.motion
        self.effect, self.names = effect, effect.linear()
        self._edges_s = np.linspace(float(m.time_s[0]), m.end_s, PIECES + 1)
        shapes = [{START.name: float(a), END.name: float(b)} for a, b in itertools.pairwise(self._edges_s)]
        sensitivities = [problem.unit(effect, shape, name) for name in self.names for shape in shapes]
        self.columns: Columns = problem.whiten(sensitivities, np.float32).astype(np.float32, copy=False)
        self.products: Columns = self.columns.T @ self.columns

    def column(self, shape: Values, name: str) -> Columns:
        """Whitened sensitivity to a size (r,) in an interval of the grid."""
        k = self.names.index(name) * PIECES
        first, last = (k + int(np.abs(self._edges_s - float(shape[t])).argmin()) for t in (START.name, END.name))
        total: Columns = self.columns[:, first:last].sum(axis=1)
        return total

    def best(self, names: tuple[str, ...], G: Array, b: Array) -> Best | None:
        """The interval in which the named sizes explain most, with their required signs. `G`, `b`: products of the
        columns with each other and with the data, after projecting out the held effects.
        """
        i, j = np.triu_indices(PIECES + 1, 1)
        b_of, G_of, known = self._sums(names, G, b, i, j)
        known &= j - i <= LONGEST
        known &= np.linalg.det(G_of) > LEFT_SHARE * np.einsum("wii->wi", G_of).prod(axis=1)
        x = np.zeros_like(b_of)
        x[known] = np.linalg.solve(G_of[known], b_of[known][:, :, None])[:, :, 0]
        unsigned = [i for i, name in enumerate(names) if not parameter(self.effect, name).signed]
        known &= (x[:, unsigned] > 0.0).all(axis=1)
        nats = np.where(known, 0.5 * (b_of * x).sum(axis=1), 0.0)
        w = int(nats.argmax())
        edges_s = self._edges_s
        shape: dict[str, float | str] = {START.name: float(edges_s[i[w]]), END.name: float(edges_s[j[w]])}
        return Best(float(nats[w]), shape, x[w]) if nats[w] > 0.0 else None

    def scatter(self, selected: Selected, G: Array, b: Array) -> float:
        """Root mean square of the sizes that a fit leaves in equally long intervals elsewhere, in their own deviations;
        1 if it is not significantly larger, or these are few. `G`, `b`: as for `best`. (87)
        """
        begin_s, end_s = selected.interval_s or (0.0, 0.0)
        names = [name for name in self.names if name in selected.free]
        if end_s <= begin_s or not names:
            return 1.0
        length = min(max(1, round((end_s - begin_s) / float(self._edges_s[1] - self._edges_s[0]))), PIECES)
        i = np.arange(PIECES - length + 1)
        b_of, G_of, seen = self._sums(names, G, b, i, i + length)
        seen &= (self._edges_s[i + length] <= begin_s) | (self._edges_s[i] >= end_s)
        if len(names) * int(seen.sum()) < FEWEST_SIZES:
            return 1.0
        inverse = np.linalg.pinv(G_of[seen], hermitian=True)
        sizes, variances = np.einsum("wij,wj->wi", inverse, b_of[seen]), np.einsum("wii->wi", inverse)
        # In single precision, two nearly equal columns may give an indefinite covariance.
        known = variances > 0.0
        found = float(np.sqrt(np.mean(sizes[known] ** 2 / variances[known]))) if known.any() else 1.0
        return found if found > LEAST_SCATTER else 1.0

    def _sums(
        self, names: Sequence[str], G: Array, b: Array, i: Pieces, j: Pieces
    ) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
        """Products of sizes with the data (w, k) and with each other (w, k, k) in the intervals from i to j, and
        whether every size is still visible after projecting out the held effects.
        """
        k, index = len(names), np.concatenate([self.names.index(n) * PIECES + np.arange(PIECES) for n in names])
        sums = np.pad(np.cumsum(b[index].reshape(k, PIECES), axis=1), ((0, 0), (1, 0)))
        G_of, own = (_squares(M[np.ix_(index, index)].astype(float), k, i, j) for M in (G, self.products))
        diagonal, whole = np.einsum("wii->wi", G_of), np.einsum("wii->wi", own)
        seen = ((diagonal > LEFT_SHARE * whole) & (whole > 0.0)).all(axis=1)
        return (sums[:, j] - sums[:, i]).T, G_of, seen


def _squares(G: Array, k: int, i: Pieces, j: Pieces) -> Array:
    """Sums of products (k p, k p) over the pieces i to j, both ways: (w, k, k)."""
    pieces = G.reshape(k, PIECES, k, PIECES).transpose(0, 2, 1, 3)
    total = np.pad(pieces.cumsum(axis=2).cumsum(axis=3), ((0, 0), (0, 0), (1, 0), (1, 0)))
    result: Array = total[..., j, j] - total[..., i, j] - total[..., j, i] + total[..., i, i]
    return result.transpose(2, 0, 1)


def same_window(selected: Selected) -> list[Selected]:
    """Other interval effects, in the interval of a selected effect."""
    if selected.interval_s is None:
        return []
    return [c for c in _in_window(*selected.interval_s) if c.id != selected.id]


def joined(selection: Sequence[Selected]) -> list[tuple[tuple[Selected, Selected], Selected]]:
    """Pairs of effects with adjoining intervals, each with the effects that may replace both: a search that adds one
    effect at a time finds a long interval in pieces.
    """
    found = []
    placed = [(c, c.interval_s) for c in selection if c.interval_s is not None]
    for (a, (a0, a1)), (b, (b0, b1)) in itertools.combinations(placed, 2):
        if max(a0, b0) - min(a1, b1) < MEET_S:
            found += [((a, b), one) for one in _in_window(min(a0, b0), max(a1, b1))]
    return found


def moved(selection: Sequence[Selected], length_s: float) -> list[Selected]:
    """Effects with a begin or an end, each moved to times near its own: a descent may have stopped at a local
    optimum.
    """
    steps_s = [sign * share * length_s for share in MOVES for sign in (-1.0, 1.0)]
    return [
        replace(c, values={**c.values, name: c.number(name) + step_s})
        for c in selection
        for name in (START.name, END.name)
        if name in c.free
        for step_s in steps_s
    ]


def _in_window(t0_s: float, t1_s: float) -> list[Selected]:
    """Each interval effect in this window, with sizes not yet fitted."""
    times = {START.name: t0_s, END.name: t1_s}
    return [
        Selected(effect, {**times, **dict.fromkeys(effect.linear(), 0.0)}, (*effect.linear(), *times))
        for effect in catalogue().values()
        if is_of_interval(effect)
    ]
