"""From samples to data sets: where a recording is cut, what is left out, how good a mean is."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rate_table_data import ARW_DEG_S_ROOT_HZ, RATES, of_means, rd2100_error, samples

from drd.arrays import Array
from drd_tools.calibrate.gyro.data_sets import data_sets_of_samples, joined


def times(n: int) -> Array:
    return np.arange(1, n + 1) / 10.0


def test_each_dwell_is_one_data_set_without_its_settling_time() -> None:
    t, w, g, T = samples(np.random.default_rng(1), seconds=8.0)
    data = data_sets_of_samples(t, w, g, T)
    assert data.table_rate_deg_s.tolist() == pytest.approx(list(RATES))
    assert data.count.tolist() == [70] * len(RATES)  # 10 Hz, 8 s less one
    expected = rd2100_error(data.table_rate_deg_s, data.temperature_c)
    assert np.abs(data.error_deg_s - expected).max() < 5.0 * ARW_DEG_S_ROOT_HZ / math.sqrt(7.0)
    assert data.sigma_deg_s == pytest.approx(ARW_DEG_S_ROOT_HZ / math.sqrt(7.0), rel=0.35)


def test_a_table_that_has_not_settled_falsifies_the_mean_unless_that_time_is_left_out() -> None:
    t, w, g, T = samples(np.random.default_rng(1), settle_s=5.0)
    early, late = (data_sets_of_samples(t, w, g, T, settle_s=s) for s in (0.0, 5.0))
    law = rd2100_error(late.table_rate_deg_s, late.temperature_c)
    assert np.abs(late.error_deg_s - law).max() < 0.01
    assert np.abs(early.error_deg_s - law).max() > 1.0


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.08))
def test_spikes_do_not_move_a_mean(seed: int, share: float) -> None:
    t, w, g, T = samples(np.random.default_rng(seed), (0.0, 50.0), spikes=share, seconds=20.0, settle_s=0.0)
    data = data_sets_of_samples(t, w, g, T, settle_s=0.0)
    assert data.count.sum() + data.spikes.sum() == len(t)
    law = rd2100_error(data.table_rate_deg_s, data.temperature_c)
    assert np.abs(data.error_deg_s - law).max() < 7.0 * ARW_DEG_S_ROOT_HZ / math.sqrt(20.0)


def test_a_measured_table_rate_may_jitter_and_its_ramps_are_left_out() -> None:
    rng = np.random.default_rng(2)
    w = np.concatenate([np.full(200, 10.0), np.linspace(10.0, 40.0, 60), np.full(200, 40.0)])
    w = w + 0.01 * rng.standard_normal(len(w))
    data = data_sets_of_samples(times(len(w)), w, w + 0.5, np.full(len(w), 20.0))
    assert data.table_rate_deg_s == pytest.approx([10.0, 40.0], abs=0.01)
    assert data.error_deg_s == pytest.approx([0.5, 0.5])


def test_a_long_dwell_is_cut_as_its_temperature_moves_and_a_glitch_of_the_sensor_is_not_believed() -> None:
    T = np.linspace(10.0, 26.0, 3200)
    T[5::100] = 85.0
    data = data_sets_of_samples(times(3200), np.full(3200, 5.0), 5.0 + 0.01 * T, T)
    assert len(data) == 8
    assert data.temperature_c == pytest.approx(np.arange(11.0, 26.0, 2.0), abs=0.2)


def test_without_scatter_the_resolution_bounds_what_a_mean_is_worth() -> None:
    w = np.repeat([0.0, 10.0, 20.0], 100)
    g = 0.25 * np.round(1.03 * w / 0.25)
    data = data_sets_of_samples(times(300), w, g, np.full(300, 20.0), settle_s=0.0)
    assert (data.sigma_deg_s > 0.25 / math.sqrt(12.0) / 11.0).all()


@pytest.mark.parametrize(("step_c", "sigma_c"), [(1.0, 0.29), (0.5, 0.145), (0.1, 0.029), (0.01, 0.0029), (0.0, 0.0)])
def test_a_thermometers_steps_are_found_and_bound_what_its_mean_is_worth(step_c: float, sigma_c: float) -> None:
    T = np.random.default_rng(1).uniform(20.0, 20.0 + max(step_c, 1e-3), 200)
    T = step_c * np.round(T / step_c) if step_c else T
    w = np.repeat([0.0, 10.0], 100)
    data = data_sets_of_samples(times(200), w, w, T)
    assert data.temperature_sigma_c == pytest.approx(sigma_c, rel=0.01)
    ramp = data_sets_of_samples(times(200), w, w, np.round(np.linspace(20.0, 24.0, 200), 1))
    assert (ramp.temperature_sigma_c < 0.1 * 0.1).all()


def test_what_is_too_short_gives_no_data_set() -> None:
    w = np.arange(30.0)
    assert len(data_sets_of_samples(times(30), w, w, w)) == 0
    assert len(data_sets_of_samples(times(0), *[np.empty(0)] * 3)) == 0


def test_data_sets_join_and_select() -> None:
    ones = np.ones(3)
    data = of_means(ones, 2.0 * ones, np.array([1.0, 2.0, 3.0]), ones)
    both = joined([data, data.select(np.array([2]))])
    assert len(both) == 4
    assert both.temperature_c.tolist() == [1.0, 2.0, 3.0, 3.0]
    assert both.select(both.temperature_c > 2.5).label == ("", "")


@pytest.mark.parametrize(("sigma", "n"), [(0.0, 3), (math.nan, 3), (1.0, 2)])
def test_senseless_means_are_refused(sigma: float, n: int) -> None:
    with pytest.raises(ValueError, match="expected"):
        of_means(np.zeros(3), np.zeros(3), np.zeros(3), np.full(n, sigma))
