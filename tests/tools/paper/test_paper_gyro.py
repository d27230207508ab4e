import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drd_tools.calibrate.gyro.data_sets import data_sets_of_samples
from drd_tools.calibrate.gyro.error_function import fit_error_function
from drd_tools.paper.gyro import SimulatedGyro
from drd_tools.paper.physics import Gyro, RateTable

TEMPERATURES = np.linspace(-40.0, 75.0, 400)
RATES = np.linspace(-100.0, 100.0, 401)


def gyro(seed: int, **physics: float) -> SimulatedGyro:
    return SimulatedGyro(Gyro(**physics), np.random.default_rng(seed))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_each_gyro_is_as_bad_as_table_i_says(seed: int) -> None:
    g = gyro(seed)
    bias = g.error_deg_s(0.0, TEMPERATURES)
    assert np.ptp(bias) == pytest.approx(0.2, rel=0.45)
    scale = (g.error_deg_s(100.0, TEMPERATURES) - g.error_deg_s(-100.0, TEMPERATURES)) / 200.0
    assert np.ptp(scale) == pytest.approx(0.02, rel=0.45)
    rate = RATES[RATES != 0.0]
    at_factory = (g.error_deg_s(rate, 25.0) - g.error_deg_s(0.0, 25.0)) / rate
    assert np.sqrt(np.mean(at_factory**2)) == pytest.approx(0.005, rel=0.35)
    # The straight line of the datasheet is the best one.
    assert abs(np.polyfit(rate, at_factory * rate, 1)[0]) < 0.001


def test_a_reading_has_the_noise_of_table_i() -> None:
    g = gyro(1, bias_stability_deg_s=0.0)
    rate, temperature = g.read(np.full(20_000, 5.0), np.full(20_000, 25.0))
    assert rate.std() == pytest.approx(5 / 3600 / np.sqrt(0.1), rel=0.05)
    assert rate.mean() - 5.0 == pytest.approx(float(g.error_deg_s(5.0, 25.0)), abs=2e-4)
    assert set(temperature.tolist()) == {25.0}
    assert np.allclose(np.round(rate / (100 / 32768)) * (100 / 32768), rate)


def test_a_reading_never_leaves_the_full_scale() -> None:
    rate, _ = gyro(2).read(np.array([-150.0, 150.0]), np.array([20.0, 20.0]))
    assert np.abs(rate) == pytest.approx(100.0, abs=0.002)


def test_the_rate_table_calibration_brings_an_order_of_magnitude_on_new_data() -> None:
    ratios = []
    for seed in range(20):
        g = gyro(seed)
        fitted = fit_error_function(data_sets_of_samples(*g.on_rate_table(RateTable())))
        new = data_sets_of_samples(*g.on_rate_table(RateTable()))
        ratios.append(np.std(new.error_deg_s) / np.std(fitted.residual_deg_s(new)))
    assert np.median(ratios) > 10.0
    assert np.mean(np.array(ratios) > 10.0) >= 0.8
