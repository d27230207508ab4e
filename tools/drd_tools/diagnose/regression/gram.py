"""Cached products of a problem's whitened columns, so that sets of effects are fitted with small matrices. (76)"""

from collections.abc import Hashable, Sequence

import numpy as np

from drd.arrays import Array

FIRST, MOST = 64, 1024  # columns, at first and at most (8 MB of products)


class Gram:
    """Products of data (r,), nuisances (r, q), and columns identified by keys."""

    def __init__(self, data: Array, nuisance: Array):
        self._held = np.concatenate([data[None], nuisance.T])
        self._among_held = self._held @ self._held.T
        self._forget()

    def _forget(self) -> None:
        self._index: dict[Hashable, int] = {}
        self._products, self._beside = np.full((FIRST, FIRST), np.nan), np.zeros((len(self._held), FIRST))

    def of(self, keys: Sequence[Hashable], columns: Sequence[Array]) -> Array:
        """Products (1 + q + m, 1 + q + m) of data, nuisances and m columns."""
        if len(self._index) + len(keys) > MOST:
            self._forget()
        fresh = {key: column for key, column in zip(keys, columns, strict=True) if key not in self._index}
        if fresh:
            self._add(fresh)
        at = [self._index[key] for key in keys]
        within = self._products[np.ix_(at, at)]
        for i, j in zip(*np.nonzero(np.isnan(within)), strict=True):
            if i <= j:
                within[i, j] = within[j, i] = columns[i] @ columns[j]
        self._products[np.ix_(at, at)] = within
        beside = self._beside[:, at]
        return np.block([[self._among_held, beside], [beside.T, within]])

    def _add(self, fresh: dict[Hashable, Array]) -> None:
        first, last = len(self._index), len(self._index) + len(fresh)
        self._index.update((key, first + i) for i, key in enumerate(fresh))
        if last > len(self._products):
            more = max(last, 2 * first) - len(self._products)
            self._products = np.pad(self._products, (0, more), constant_values=np.nan)
            self._beside = np.pad(self._beside, ((0, 0), (0, more)))
        self._beside[:, first:last] = np.column_stack([self._held @ column for column in fresh.values()])
