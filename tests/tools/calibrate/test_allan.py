"""The Allan deviation and the model's fit."""

import allantools
import numpy as np
import pytest
from gyro_noise_data import rates
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls
from scipy.signal import lfilter

from drd_tools.calibrate.noise.allan import (
    LONGEST_PART,
    MAX_BLOCKS,
    TERMS,
    B,
    K,
    N,
    Q,
    allan_curve,
    averaging_factors,
    fit,
    nonnegative,
    shapes,
)

MODEL = (Q, N, B, K)


def test_the_deviation_is_the_librarys_whatever_the_bias() -> None:
    noise = rates(5000, 0.1, {"N": 1e-3, "K": 1e-6}, 3)
    curve = allan_curve(noise + 5.0, 0.1)
    expected = allantools.oadev(noise, rate=10.0, data_type="freq", taus=curve.tau_s)
    assert curve.tau_s == pytest.approx(expected[0])
    assert curve.deviation == pytest.approx(expected[1], rel=1e-9)
    assert (curve.low < curve.deviation).all()
    assert (curve.deviation < curve.high).all()


@given(st.integers(30, 5_000_000))
@settings(deadline=None)
def test_averaging_factors_rise_up_to_a_third_and_the_long_ones_are_whole_blocks(count: int) -> None:
    factors, block = averaging_factors(count)
    assert factors[0] == 1
    assert (np.diff(factors) > 0).all()
    assert factors[-1] <= count / LONGEST_PART
    assert factors[-1] > count / LONGEST_PART / 2.3
    assert count // block <= MAX_BLOCKS
    assert (factors[factors >= block] % block == 0).all()


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(ValueError, match="29 samples"):
        allan_curve(np.zeros(29), 0.1)


def test_a_curve_of_the_models_form_gives_its_coefficients_back() -> None:
    curve = allan_curve(rates(20_000, 0.1, {"N": 1e-3}, 1), 0.1)
    shape = shapes(curve.tau_s)
    squares = np.array([1e-5, 1e-3, 1e-4, 1e-6, 0.0]) ** 2
    found = fit(shape, shape @ squares, curve.edf, MODEL)
    assert np.sqrt(found.squares) == pytest.approx(np.sqrt(squares), rel=1e-4)
    assert found.variance == pytest.approx(shape @ squares)


@pytest.mark.parametrize("term", ["Q", "N", "B", "K", "R"])
def test_each_term_alone_has_the_slope_and_size_of_ieee_952(term: str) -> None:
    # Means over seeds: a single log's long averaging times are chance.
    variances = [allan_curve(rates(3000, 0.5, {term: 2e-3}, seed), 0.5).deviation ** 2 for seed in range(20)]
    curve = allan_curve(rates(3000, 0.5, {term: 2e-3}, 0), 0.5)
    expected = shapes(curve.tau_s)[:, TERMS.index(term)] * 2e-3**2
    ratio = np.mean(variances, axis=0) / expected
    averaged = curve.tau_s < 60.0
    assert ratio[averaged] == pytest.approx(np.ones(averaged.sum()), abs=0.12)


def test_our_flicker_agrees_with_the_librarys_generator() -> None:
    # allantools' pink noise has the one-sided density 1/f per sample: B^2 / pi = 1.
    ours = [allan_curve(rates(4096, 1.0, {"B": np.sqrt(np.pi)}, seed), 1.0).deviation for seed in range(20)]
    tau_s = allan_curve(np.arange(4096.0), 1.0).tau_s
    np.random.seed(4)  # the library's generator uses the global one
    theirs = [
        allantools.oadev(allantools.noise.pink(4096, depth=80), data_type="freq", taus=tau_s)[1] for _ in range(20)
    ]
    middle = (tau_s >= 2) & (tau_s <= 100)
    ratio = (np.mean(np.square(ours), axis=0) / np.mean(np.square(theirs), axis=0))[middle]
    # Their scale is a matter of convention; that the ratio is flat is not. Beyond, their octaves end.
    assert ratio / ratio.mean() == pytest.approx(np.ones(middle.sum()), abs=0.15)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_the_non_negative_fit_is_scipys(seed: int) -> None:
    random = np.random.default_rng(seed)
    A, y, weight = random.normal(size=(12, 4)), random.normal(size=(3, 12)), random.uniform(0.5, 2.0, (3, 12))
    found = nonnegative(A, y, weight)
    for row in range(3):
        expected, residual = nnls(weight[row, :, None] * A, weight[row] * y[row])
        assert found[row] == pytest.approx(expected, rel=1e-6, abs=1e-7)
        assert np.linalg.norm(weight[row] * (A @ found[row] - y[row])) == pytest.approx(residual)


def test_estimates_scatter_about_the_truth() -> None:
    truth = {"Q": 1e-4, "N": 1e-3, "B": 1e-4, "K": 1e-5}
    found = []
    for seed in range(30):
        curve = allan_curve(rates(10_000, 0.1, truth, seed), 0.1)
        found.append(np.sqrt(fit(shapes(curve.tau_s), curve.deviation**2, curve.edf, MODEL).squares))
    middle = np.median(found, axis=0)
    assert middle[[Q, N]] == pytest.approx([1e-4, 1e-3], rel=0.05)
    assert middle[B] == pytest.approx(1e-4, rel=0.4)
    assert middle[K] == pytest.approx(1e-5, rel=0.4)


@pytest.mark.parametrize(("interval_s", "constant_s", "order"), [(0.01, 0.016, 1), (0.02, 0.03, 4), (0.1, 0.3, 1)])
def test_a_filter_in_the_gyro_hides_no_angle_random_walk(interval_s: float, constant_s: float, order: int) -> None:
    a = np.exp(-interval_s / constant_s)
    for seed in range(5):
        noise = rates(36_000, interval_s, {"N": 1e-3, "K": 1e-6}, seed)
        for _ in range(order):
            noise = lfilter([1.0 - a], [1.0, -a], noise)
        curve = allan_curve(noise, interval_s)
        found = fit(shapes(curve.tau_s), curve.deviation**2, curve.edf, MODEL)
        assert np.sqrt(found.squares[N]) == pytest.approx(1e-3, rel=0.12)


@pytest.mark.parametrize("term", ["Q", "N", "B", "K", "R"])
def test_a_gyro_without_a_filter_keeps_the_shortest_averages(term: str) -> None:
    for seed in range(20):
        noise = rates(3000, 0.1, {"N": 1e-3, term: 1e-3}, seed)
        assert allan_curve(noise, 0.1).factors[0] == 1


def test_a_curve_of_zeros_has_no_noise() -> None:
    curve = allan_curve(np.zeros(1000), 0.1)
    assert (fit(shapes(curve.tau_s), curve.deviation**2, curve.edf, MODEL).squares == 0.0).all()
