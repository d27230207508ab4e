"""The dynamic programming against all segmentations, and the filter against the dense Gaussian."""

from collections.abc import Iterator
from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from drd.arrays import Array
from drd_tools.fleet import changes
from drd_tools.fleet.changes import CREEPING, Prior, evidence, log_evidence, most_likely, posterior


def every_segmentation(log: Array, change: Array) -> Iterator[tuple[float, tuple[tuple[int, int, int], ...]]]:
    """Weight and segments of each way to cut a series; log: (kinds, n, n), change: (n,)."""
    kinds, n, _ = log.shape
    prior = np.log([1.0 - CREEPING, CREEPING]) if kinds == 2 else np.zeros(1)
    for count in range(n):
        for cuts in combinations(range(1, n), count):
            ends = list(zip((0, *cuts), (*(c - 1 for c in cuts), n - 1), strict=True))
            weight = sum(np.log(change[k]) if k in cuts else np.log1p(-change[k]) for k in range(1, n))
            for which in product(range(kinds), repeat=len(ends)):
                total = weight + sum(prior[k] + log[k, s, e] for k, (s, e) in zip(which, ends, strict=True))
                yield total, tuple((k, s, e) for k, (s, e) in zip(which, ends, strict=True))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 5), kinds=st.integers(1, 2))
def test_the_sum_over_all_segmentations(seed: int, n: int, kinds: int) -> None:
    random = np.random.default_rng(seed)
    log, change = 3.0 * random.standard_normal((1, kinds, n, n)), random.uniform(0.01, 0.6, (1, n))
    every = list(every_segmentation(log[0], change[0]))
    weights = np.array([w for w, _ in every])
    p = np.exp(weights - np.logaddexp.reduce(weights))
    upper = np.triu(np.ones((n, n), bool))
    given_log = np.where(upper, log, -np.inf)
    found = posterior(given_log, change)
    assert log_evidence(given_log, change)[0] == pytest.approx(np.logaddexp.reduce(weights))
    for k in range(1, n):
        at_k = [any(s == k for _, s, _ in segments) for _, segments in every]
        assert found.change[0, k] == pytest.approx(float(p @ at_k), abs=1e-9)
        creeps = [any(s == k and kind for kind, s, _ in segments) for _, segments in every]
        assert found.segments[0, 1:, k].sum() == pytest.approx(float(p @ creeps), abs=1e-9)
        for last in range(k, n):
            some = [any(k <= s <= last for _, s, _ in segments) for _, segments in every]
            assert found.any_change(0, k, last) == pytest.approx(float(p @ some), abs=1e-9)
    best = max(every, key=lambda one: one[0])[1]
    assert tuple(most_likely(given_log, change)[0]) == best


@pytest.mark.parametrize("slope", [0.0, 0.01])
def test_a_segment_without_outliers_is_a_gaussian(monkeypatch: pytest.MonkeyPatch, slope: float) -> None:
    monkeypatch.setattr(changes, "OUTLIERS", 1e-300)
    random = np.random.default_rng(3)
    n, mean, spread, jump, walk = 6, 0.2, 0.5, 1.0, 0.03
    day, value = np.cumsum(random.uniform(0.5, 2.0, n)), random.standard_normal(n)
    variance = random.uniform(0.1, 0.3, n)
    prior = Prior(np.array([mean]), spread, jump, slope, walk, np.zeros((1, n)))
    found = evidence(day[None], value[None], variance[None], prior)
    for kind in range(found.shape[1]):
        for s, e in ((0, n - 1), (2, 4), (3, 3)):
            t = day[s : e + 1] - day[s]
            K = spread**2 + (jump**2 if s else 0.0) + walk * np.minimum(t[:, None], t)
            K = K + kind * slope**2 * np.outer(t, t) + np.diag(variance[s : e + 1])
            expected = stats.multivariate_normal(np.full(len(t), mean), K).logpdf(value[s : e + 1])
            assert found[0, kind, s, e] == pytest.approx(expected)


def test_series_that_are_shorter_are_as_alone() -> None:
    random = np.random.default_rng(0)
    day, value = np.arange(8.0)[None].repeat(2, 0), random.standard_normal((2, 8))
    variance, change = np.full((2, 8), 0.1), np.full((2, 8), 0.02)
    value[1, 5:] = day[1, 5:] = variance[1, 5:] = np.nan
    change[1, 5:] = 0.0
    prior = Prior(np.zeros(2), 0.5, 1.0, 0.1, 0.01, change)
    of_both = evidence(day, value, variance, prior)
    both = posterior(of_both, change)
    alone = Prior(np.zeros(1), 0.5, 1.0, 0.1, 0.01, change[1:, :5])
    of_one = evidence(day[1:, :5], value[1:, :5], variance[1:, :5], alone)
    one = posterior(of_one, change[1:, :5])
    assert log_evidence(of_both, change)[1] == pytest.approx(log_evidence(of_one, change[1:, :5])[0])
    assert both.change[1, :5] == pytest.approx(one.change[0])


def test_one_outlier_is_no_change() -> None:
    value = np.zeros((1, 20))
    value[0, 10] = 0.8
    change = np.full((1, 20), 1e-3)
    prior = Prior(np.zeros(1), 0.5, 1.0, 0.0, 1e-6, change)
    found = posterior(evidence(np.arange(20.0)[None], value, np.full((1, 20), 0.01), prior), change)
    assert found.any_change(0, 1, 19) < 0.3
    value[0, 10:] = 0.8
    found = posterior(evidence(np.arange(20.0)[None], value, np.full((1, 20), 0.01), prior), change)
    assert found.change[0, 10] > 0.9
