"""Score all sets of up to four effects from one Gram matrix, each effect in its best variant in that set. (80)"""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.effects.effect import END, START
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import shape_columns, with_priors
from drd_tools.diagnose.select.intervals import Columns, joined, moved, same_window
from drd_tools.diagnose.select.library import Candidate, choices, columns_of, library_of
from drd_tools.diagnose.selected import Selected, parameter, shape_of

LEFT_SHARE: Final = 1e-3  # of a column's square that must remain after projecting out the rest of its set
FREE_SHARE: Final = 1e-5  # the same for the held effects: the accuracy of single-precision products
RIDGE: Final = 1e-4  # of a column's square, as prior: keeps the sizes of two similar columns finite


class _Group(NamedTuple):
    """Candidates with w columns each: indices (c,), columns (c, w), products (c, w, w), penalties (c,), nats.

    `least` (c, w): lower bounds of the coefficients.
    """

    candidates: npt.NDArray[np.intp]
    columns: npt.NDArray[np.intp]
    blocks: Array
    penalty: Array
    least: Array


class _Set(NamedTuple):
    """A set of candidates and its score, nats. `b` (p,), `own` (p,): all columns' products with the data, and squares,
    after projecting out the set. `D` (m, p): their products with its m columns, orthonormalised.
    """

    chosen: tuple[int, ...]
    score: float
    D: Array
    b: Array
    own: Array


class Estimates(NamedTuple):
    """Value and deviation (inf if unobservable) of each of the library's columns alone, (p,). `held`: names of the
    effects beside which it is estimated.
    """

    value: Array
    sigma: Array
    held: frozenset[str]


class Sets:
    """Sets of effects beside the effects `held`, which stay. (80)

    The shapes of `near`, which may be selected again, and of `others` are additional variants.
    """

    def __init__(
        self,
        problem: Problem,
        held: Sequence[Selected],
        near: Sequence[Selected] = (),
        others: Sequence[Selected] = (),
    ):
        self._problem, self._library = problem, library_of(problem)
        self._held_names = frozenset(c.id for c in held)
        of_held, left = with_priors(problem, held)
        self._marginal = Marginal(np.column_stack([shape_columns(problem, near), of_held]))
        left = self._marginal.projected(left)
        self._held, self._left = self._marginal.columns.astype(np.float32), left.astype(np.float32)
        # A search that adds one effect at a time finds a long interval in pieces, or by another effect's name.
        pieces = [*(one for _, one in joined(near)), *(c for one in near for c in same_window(one))]
        lasting = [c for c in near if c.end_s is None]
        moments = moved(lasting, float(np.ptp(problem.evidence.edges_s)))
        self.intervals = list(self._intervals())
        extra, columns = self._variants([*near, *others, *pieces, *moments, *self.intervals])
        own: Columns = np.concatenate([self._library.columns, columns], axis=1)
        between, count = columns.T @ own, self._library.columns.shape[1]
        products = np.block([[self._library.products, between[:, :count].T], [between]])
        G, b = self._beside(own, products)
        free, taken = np.diag(G) > FREE_SHARE * np.diag(products), {c.id for c in held if not c.effect.repeats}
        # The held effects fully explain the other columns: these belong to no candidate.
        self._scale = np.zeros(len(G))
        self._scale[free] = np.diag(G)[free] ** -0.5
        self._G = G * self._scale[:, None] * self._scale + RIDGE * np.eye(len(G))
        self._b = b * self._scale
        candidates = [*self._library.candidates, *extra]
        self.candidates = [c for c in candidates if c.effect.id not in taken and free[list(c.columns)].all()]
        labels = [self._label(c, near) for c in self.candidates]
        names = sorted(set(labels))
        self._name = np.array([names.index(label) for label in labels], int)
        self._names = len(names)
        self._groups = [self._group(width) for width in sorted({len(c.columns) for c in self.candidates})]

    def _beside(self, columns: Columns, products: Columns) -> tuple[Array, Array]:
        """Products of columns (r, p) with each other, (p, p), and with the data, (p,), beside the held effects."""
        cross = np.asarray(columns.T @ self._held, float)
        return self._marginal.beside(products, cross.T), np.asarray(columns.T @ self._left, float)

    def _intervals(self) -> Iterator[Selected]:
        """Each interval effect, with each choice of its sizes, in the interval where it explains most."""
        for each in self._library.intervals:
            products = self._beside(each.columns, each.products)
            for which in choices(each.effect, each.names):
                names = tuple(each.names[i] for i in which)
                if (best := each.best(names, *products)) is not None:
                    values = {**best.shape, **dict.fromkeys(each.names, 0.0)}
                    yield Selected(each.effect, values, (*names, START.name, END.name))

    def _variants(self, near: Sequence[Selected]) -> tuple[list[Candidate], Columns]:
        """Candidates with the shapes of refined effects, and their columns, numbered after the library's."""
        candidates: list[Candidate] = []
        sensitivities: list[Sensitivity] = []
        for one in near:
            first = self._library.columns.shape[1] + len(sensitivities)
            made, own = columns_of(self._problem, one.effect, dict(shape_of(one.effect, one.values)), first)
            candidates += made
            sensitivities += own
        if not sensitivities:
            return [], np.zeros((len(self._problem.data), 0), np.float32)
        return candidates, self._problem.whiten(sensitivities, np.float32).astype(np.float32, copy=False)

    def scatter(self, selected: Selected) -> float:
        """Scatter of an interval effect over this drive, relative to its deviations; 1 for any other effect."""
        for each in self._library.intervals:
            if each.effect.id == selected.id:
                return each.scatter(selected, *self._beside(each.columns, each.products))
        return 1.0

    def estimates(self) -> Estimates:
        """Estimates of effects that are not held, each alone, with the held ones' parameters and other shapes free."""
        count = self._library.columns.shape[1]
        scale, b = self._scale[:count], self._b[:count]
        return Estimates(b * scale, np.where(scale > 0.0, scale, np.inf), self._held_names)

    def ranked(self) -> list[tuple[float, Selected]]:
        """Gain of each effect that is worth its cost, nats, with its best variant; best first."""
        found = [(score, self._selected(chosen)) for score, chosen in self.scored(1).values() if score > 0.0]
        return sorted(((score, one[0]) for score, one in found if one), key=lambda r: -r[0])

    @staticmethod
    def _label(candidate: Candidate, near: Sequence[Selected]) -> str:
        """Name of an effect; if it may occur more than once, each refined occurrence has its own."""
        if candidate.effect.repeats:
            for i, one in enumerate(near):
                if candidate.effect is one.effect and candidate.shape == shape_of(one.effect, one.values):
                    return f"{one.id} {i}"
        return candidate.effect.id

    def _group(self, width: int) -> "_Group":
        """The candidates with this number of columns."""
        which = [i for i, c in enumerate(self.candidates) if len(c.columns) == width]
        chosen = [self.candidates[i] for i in which]
        columns = np.array([c.columns for c in chosen], int)
        blocks = self._G[columns[:, :, None], columns[:, None, :]]
        least = np.array([_least(c) for c in chosen])
        return _Group(np.array(which), columns, blocks, np.array([c.penalty for c in chosen]), least)

    def as_they_are(self) -> list[Selected]:
        """The best variant of each threshold and delay, unscaled, since its form changes with its size."""
        best: dict[str, tuple[float, Candidate]] = {}
        for candidate in self.candidates:
            if candidate.is_fixed:
                (i,) = candidate.columns
                nats = float(self._b[i] / self._scale[i] - 0.5 / self._scale[i] ** 2) - candidate.penalty
                if nats > best.get(candidate.effect.id, (0.0,))[0]:
                    best[candidate.effect.id] = nats, candidate
        made = (candidate.selected(np.ones(1)) for _, candidate in best.values())
        return [one for one in made if one is not None]

    def best(self, count: int, largest: int) -> list[tuple[Selected, ...]]:
        """The best sets of at most `largest` effects, with jointly fitted sizes; best first.

        Half of `count` go to the best of all, the others to sets with further names: linearisation may mislead all sets
        with one name.
        """
        made: list[tuple[Selected, ...]] = []
        names: set[str] = set()
        for _, chosen in sorted(self.scored(largest).values(), key=lambda found: -found[0]):
            own = {self.candidates[i].effect.id for i in chosen}
            if (len(made) < count // 2 or own - names) and (selection := self._selected(chosen)) is not None:
                made.append(selection)
                names |= own
                if len(made) == count:
                    break
        return made

    def scored(self, largest: int) -> dict[frozenset[int], tuple[float, tuple[int, ...]]]:
        """Score of each set of names, nats, with its best candidates.

        A set of n + 1 names is evaluated n + 1 times, with each of its names as the last, in its best variant.
        """
        last = {
            frozenset[int](): _Set((), 0.0, np.zeros((0, len(self._b))), self._b, np.full(len(self._b), 1.0 + RIDGE))
        }
        found = {names: (one.score, one.chosen) for names, one in last.items()}
        for size in range(largest):
            better: dict[frozenset[int], tuple[float, frozenset[int], int]] = {}
            for names, one in last.items():
                gains = self._gains(one)
                order = np.argsort(gains)
                best = np.full(self._names, -1)
                best[self._name[order]] = order
                for name, i in enumerate(best.tolist()):
                    if name not in names and gains[i] > -np.inf:
                        key, total = names | {name}, one.score + float(gains[i])
                        if key not in better or total > better[key][0]:
                            better[key] = total, names, i
            found |= {key: (total, (*last[rest].chosen, i)) for key, (total, rest, i) in better.items()}
            if size < largest - 1:
                grown = ((key, self._grown(last[rest], i, total)) for key, (total, rest, i) in better.items())
                last = {key: one for key, one in grown if one is not None}
        return found

    def _grown(self, one: "_Set", i: int, score: float) -> "_Set | None":
        """Add a candidate to a set; None if its columns are collinear in single precision."""
        columns = list(self.candidates[i].columns)
        left = self._G[columns] - one.D[:, columns].T @ one.D
        try:
            L = np.linalg.cholesky(left[:, columns])
        except np.linalg.LinAlgError:
            return None
        D = np.linalg.solve(L, left)
        b = one.b - np.linalg.solve(L, one.b[columns]) @ D
        return _Set((*one.chosen, i), score, np.concatenate([one.D, D]), b, one.own - np.einsum("mi,mi->i", D, D))

    def _gains(self, one: "_Set") -> Array:
        """Gain of each candidate beside a set, less its cost, nats; -inf if collinear with the set or of wrong sign."""
        gains = np.full(len(self.candidates), -np.inf)
        enough = one.own > LEFT_SHARE
        for group in self._groups:
            at = group.columns
            if at.shape[1] == 1:
                i = at[:, 0]
                x = (one.b[i] / np.maximum(one.own[i], LEFT_SHARE))[:, None]
            else:
                taken = one.D[:, at]
                blocks = group.blocks - np.einsum("mcw,mcv->cwv", taken, taken)
                blocks[~enough[at].all(axis=1)] = np.eye(at.shape[1])
                x = np.linalg.solve(blocks, one.b[at][:, :, None])[:, :, 0]
            seen = (enough[at] & (x >= group.least)).all(axis=1)
            nats = 0.5 * (one.b[at] * x).sum(axis=1) - group.penalty
            gains[group.candidates] = np.where(seen, nats, -np.inf)
        return gains

    def _selected(self, chosen: Sequence[int]) -> tuple[Selected, ...] | None:
        """The effects of a set, with jointly fitted sizes; None if implausible."""
        candidates = [self.candidates[i] for i in chosen]
        columns = [i for c in candidates for i in c.columns]
        x = np.linalg.solve(self._G[np.ix_(columns, columns)], self._b[columns]) * self._scale[columns]
        made, k = [], 0
        for candidate in candidates:
            one = candidate.selected(x[k : k + len(candidate.columns)])
            if one is None:
                return None
            made.append(one)
            k += len(candidate.columns)
        return tuple(made)


def _least(candidate: Candidate) -> list[float]:
    """Lower bound of each column's coefficient."""
    if candidate.angle:
        return [-np.inf] * len(candidate.columns)
    return [-np.inf if name == "" or parameter(candidate.effect, name).signed else 0.0 for name in candidate.names]
