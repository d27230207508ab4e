"""The fit: known coefficients come back within their sigma, outliers do not matter, new data is ten times better."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rate_table_data import RATES, TEMPERATURES, ErrorLaw, means, of_means, rd2100_error
from scipy.stats import chi2

from drd.arrays import Array
from drd.samples import GyroSample
from drd_tools.calibrate.gyro.data_sets import DataSets
from drd_tools.calibrate.gyro.error_function import ErrorFunction, Order, corner_leverage, fit_error_function

TRUE = np.array([[0.05, 1.5e-3, 1e-5], [5e-3, -2e-4, 1e-6], [1e-5, 2e-8, -3e-9], [-4e-7, 2e-9, 1e-10]])


def cubic_law(coefficients: Array) -> ErrorLaw:
    """The error at a true rate of a gyro whose error function, of the reading, has these coefficients."""

    def law(w: Array, T: Array) -> Array:
        error: Array = np.zeros_like(w)
        for _ in range(80):
            g = w + error
            error = np.sum([row @ np.array([T**0, T, T**2]) * g**i for i, row in enumerate(coefficients)], axis=0)
        return error

    return law


def simulated(coefficients: Array, seed: int, between_deg_s: float = 0.0, step_c: float = 0.0) -> DataSets:
    """With a scatter between data sets that their samples do not show, and a thermometer's steps."""
    rng = np.random.default_rng(seed)
    w, g, T, sigma = means(cubic_law(coefficients), rng)
    T = step_c * np.round(T / step_c) if step_c else T
    g = g + between_deg_s * rng.standard_normal(len(g))
    return of_means(w, g, T, sigma, step_c / math.sqrt(12.0))


def distance(fitted: ErrorFunction, coefficients: Array) -> float:
    """Mahalanobis distance squared: chi-square with 12 degrees of freedom where the covariance is right."""
    sigma = np.sqrt(np.diag(fitted.covariance))
    z = (fitted.coefficients - coefficients).ravel() / sigma
    return float(z @ np.linalg.solve(fitted.covariance / np.outer(sigma, sigma), z))


@settings(deadline=None, max_examples=40)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.floats(-1.0, 1.0), min_size=12, max_size=12),
    st.sampled_from([0.0, 0.002, 0.05]),
)
def test_known_coefficients_come_back_within_what_the_covariance_says(
    seed: int, draws: list[float], between_deg_s: float
) -> None:
    coefficients = TRUE * np.array(draws).reshape(4, 3)
    fitted = fit_error_function(simulated(coefficients, seed, between_deg_s))
    # One in ten million draws lies beyond, of a chi-square that is a quarter too wide: 99 data sets know no better.
    assert distance(fitted, coefficients) < 1.25 * chi2.isf(1e-7, 12)


@pytest.mark.parametrize(("between_deg_s", "step_c"), [(0.0, 0.0), (0.02, 0.0), (0.0, 0.1), (0.0, 1.0)])
def test_over_seeds_the_coefficients_stay_within_three_sigma_and_the_covariance_is_honest(
    between_deg_s: float, step_c: float
) -> None:
    distances, within = [], []
    for seed in range(200):
        fitted = fit_error_function(simulated(TRUE, seed, between_deg_s, step_c))
        distances.append(distance(fitted, TRUE))
        within.append(np.abs(fitted.coefficients - TRUE).ravel() < 3.0 * np.sqrt(np.diag(fitted.covariance)))
        assert fitted.between_deg_s == pytest.approx(between_deg_s, rel=0.4, abs=3e-3)
    assert np.mean(within) > 0.99
    # Chi-square with 12 degrees of freedom: the mean over 200 is 12 +- 0.35, and less for uniform errors.
    assert 8.5 < np.mean(distances) < 13.5


def new_data(seed: int) -> DataSets:
    """Other rates and temperatures than those of the calibration."""
    rng = np.random.default_rng(seed)
    return of_means(*means(rd2100_error, rng, tuple(range(-95, 96, 10)), tuple(range(-15, 60, 10))))


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_on_new_data_the_error_is_ten_times_smaller_though_the_gyro_is_no_polynomial(seed: int) -> None:
    data = of_means(*means(rd2100_error, np.random.default_rng(seed)))
    new = new_data(seed + 1)
    calibration = fit_error_function(data).calibration(0.0, {"made": "for a test"})
    corrected = [
        math.degrees(calibration.correct(GyroSample(0, 0.1, math.radians(g), T)).rate_rad_s)
        for g, T in zip(new.rate_deg_s.tolist(), new.temperature_c.tolist(), strict=True)
    ]
    after = np.sqrt(np.mean((np.array(corrected) - new.table_rate_deg_s) ** 2))
    assert np.sqrt(np.mean(new.error_deg_s**2)) > 10.0 * after


def spoilt(seed: int, count: int) -> tuple[ErrorFunction, npt.NDArray[np.intp]]:
    """The fit of data sets of which so many are off, and which of them."""
    data = simulated(TRUE, seed)
    rng = np.random.default_rng(seed)
    bad = rng.choice(len(data), count, replace=False)
    rate = data.rate_deg_s.copy()
    rate[bad] += rng.choice([-1.0, 1.0], count) * rng.uniform(0.05, 20.0, count)
    return fit_error_function(of_means(data.table_rate_deg_s, rate, data.temperature_c, data.sigma_deg_s)), bad


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_outlying_data_sets_are_rejected_and_do_not_move_the_fit(seed: int, count: int) -> None:
    fitted, bad = spoilt(seed, count)
    assert (fitted.weights[bad] == 0.0).all()
    assert distance(fitted, TRUE) < 1.4 * chi2.isf(1e-7, 12)


def test_hardly_any_good_data_set_is_rejected_beside_outlying_ones() -> None:
    """At given seeds: in two of 900 fits two and seven good ones are, which a random seed meets now and then."""
    more = [int((spoilt(seed, count)[0].weights == 0.0).sum()) - count for seed in range(20) for count in range(1, 7)]
    assert max(more) <= 1
    assert sum(more) <= 4


def test_a_rejected_reading_does_not_widen_the_range() -> None:
    data = simulated(TRUE, 1)
    rate = data.rate_deg_s.copy()
    rate[np.argmax(data.table_rate_deg_s)] += 50.0
    off = of_means(data.table_rate_deg_s, rate, data.temperature_c, data.sigma_deg_s)
    assert fit_error_function(off).rate_range_deg_s[1] < 105.0


def test_raw_and_scaled_powers_say_the_same_and_scaling_is_why_it_is_well_conditioned() -> None:
    data = simulated(TRUE, 3)
    fitted = fit_error_function(data)
    w, T = data.rate_deg_s, data.temperature_c
    raw = sum(fitted.coefficients[i, j] * w**i * T**j for i in range(4) for j in range(3))
    assert raw == pytest.approx(fitted.error_deg_s(w, T), abs=1e-12)
    x = np.array([w**i * T**j for i in range(4) for j in range(3)])
    assert np.sqrt(np.einsum("in,ij,jn->n", x, fitted.covariance, x)) == pytest.approx(fitted.sigma_deg_s(w, T))
    assert fitted.condition_scaled < 50.0
    assert fitted.condition_raw > 1e6


def beyond_rest(fitted: ErrorFunction, rate_deg_s: float) -> float:
    """What the difference to the error at rest has of the error's sigma. (23)"""
    low, high = fitted.rate_range_deg_s
    return math.sqrt(-2.0 * math.expm1(-0.5 * (8.0 * rate_deg_s / (high - low)) ** 2))


def test_fitted_over_a_few_degrees_far_from_zero_it_still_holds() -> None:
    rng = np.random.default_rng(1)
    law = cubic_law(TRUE)
    w, g, T, sigma = means(law, rng, temperatures=(40.0, 43.0, 46.0))
    fitted = fit_error_function(of_means(w, g, T, sigma))
    calibration = fitted.calibration(1e-4, {"made": "for a test"})
    sample = GyroSample(0, 0.1, math.radians(50.0), 43.0)
    assert math.degrees(calibration.correct(sample).sigma_rad_s) == pytest.approx(
        math.hypot(1e-4, float(fitted.sigma_deg_s(50.0, 43.0))) * beyond_rest(fitted, 50.0), rel=1e-3
    )
    assert np.abs(fitted.residual_deg_s(of_means(w, g, T, sigma))).max() < 5.0 * sigma[0]


@pytest.mark.parametrize("order", [Order(1, 0), Order(2, 1), Order(3, 0), Order(3, 2)])
def test_what_the_daemon_loads_is_what_was_fitted(order: Order) -> None:
    data = simulated(TRUE, 5)
    fitted = fit_error_function(data, order)
    calibration = fitted.calibration(0.01, {"made": "for a test"}, 0.5)
    for w, T in ((-80.0, -10.0), (0.0, 0.0), (33.0, 44.0)):
        assert calibration.error_deg_s(w, T) == pytest.approx(float(fitted.error_deg_s(w, T)), abs=1e-12)
        sigma = math.degrees(calibration.correct(GyroSample(0, 0.1, math.radians(w), T)).sigma_rad_s)
        expected = math.hypot(0.01, float(fitted.sigma_deg_s(w, T))) * beyond_rest(fitted, w)
        assert sigma == pytest.approx(expected, rel=1e-6)
    used = np.count_nonzero(np.array(calibration.covariance).any(axis=0))
    assert used == order.coefficients


def test_orders_beyond_the_file_are_fitted_but_not_written() -> None:
    fitted = fit_error_function(simulated(TRUE, 1), Order(5, 3))
    with pytest.raises(ValueError, match=r"5,3.*up to 3,2"):
        fitted.calibration(0.0, {})


def test_too_few_data_sets_and_undetermined_terms_are_refused() -> None:
    data = simulated(TRUE, 1)
    with pytest.raises(ValueError, match="12 coefficients and needs 16 data sets, there are 13"):
        fit_error_function(data.select(np.arange(13)))
    still = of_means(np.tile(RATES, 3), np.tile(RATES, 3), np.zeros(33), np.ones(33))
    with pytest.raises(ValueError, match="determine 4 of 12"):
        fit_error_function(still)
    with pytest.raises(ValueError, match="determine"):
        corner_leverage(still, Order(3, 2))


def test_a_gyro_without_error_and_noise_has_none() -> None:
    T, w = (a.ravel() for a in np.meshgrid(np.array(TEMPERATURES, float), np.array(RATES, float)))
    fitted = fit_error_function(of_means(w, w, T, np.full(len(w), 1e-9)))
    assert np.abs(fitted.coefficients).max() < 1e-9
