"""Finding a warm-up, and not finding one in noise."""

import math

import numpy as np
import pytest
from gyro_noise_data import DEG_H, DEG_H_ROOT_H, static_log

from drd_tools.calibrate.noise.static_log import StaticLog
from drd_tools.calibrate.noise.warmup import WarmUp, fit_warm_up, left_out_s, temperature_slope


def warming(
    change_deg_h: float, constant_s: float, seconds: float = 3600.0, seed: int = 1, **noise: float
) -> StaticLog:
    log = static_log(seconds, 5.0, seed, **noise)
    log.rate_rad_s[:] += change_deg_h * DEG_H * np.exp(-log.time_s / constant_s)
    return log


@pytest.mark.parametrize(("change", "constant_s"), [(20.0, 600.0), (-30.0, 300.0), (10.0, 900.0)])
def test_a_warm_up_in_white_noise_comes_back(change: float, constant_s: float) -> None:
    found = fit_warm_up(warming(change, constant_s))
    assert found is not None
    assert found.change_rad_s / DEG_H == pytest.approx(change, abs=1.0)
    assert found.time_constant_s == pytest.approx(constant_s, rel=0.15)
    assert found.bias_rad_s / DEG_H == pytest.approx(20.0, abs=0.5)


def test_flicker_and_random_walk_do_not_pull_the_fit() -> None:
    found = [fit_warm_up(warming(40.0, 400.0, 7200.0, seed, B=2 * DEG_H, K=3 * DEG_H_ROOT_H)) for seed in range(8)]
    made = [warm_up for warm_up in found if warm_up is not None]
    assert len(made) >= 7
    assert np.median([warm_up.time_constant_s for warm_up in made]) == pytest.approx(400.0, rel=0.2)
    assert np.median([warm_up.change_rad_s for warm_up in made]) / DEG_H == pytest.approx(40.0, rel=0.1)


@pytest.mark.parametrize(
    "noise", [{}, {"B": 2 * DEG_H}, {"K": 10 * DEG_H_ROOT_H}, {"B": 2 * DEG_H, "K": 5 * DEG_H_ROOT_H}]
)
def test_noise_is_hardly_ever_taken_for_a_warm_up(noise: dict[str, float]) -> None:
    found = [fit_warm_up(static_log(3600.0, 1.0, 100 + seed, **noise)) for seed in range(10)]
    assert sum(warm_up is not None for warm_up in found) <= 1


def test_waiting_times_follow_from_the_exponential() -> None:
    warm_up = WarmUp(0.0, 40 * DEG_H, 400.0)
    wait_s = warm_up.wait_s(1 * DEG_H)
    drift = warm_up.at(np.array([wait_s, wait_s + 600.0]))
    assert drift[0] - drift[1] == pytest.approx(1 * DEG_H)
    assert warm_up.at(np.array([warm_up.settled_s(0.5 * DEG_H)]))[0] == pytest.approx(0.5 * DEG_H)
    assert warm_up.wait_s(50 * DEG_H) == 0.0
    assert WarmUp(0.0, -40 * DEG_H, 400.0).wait_s(1 * DEG_H) == pytest.approx(wait_s)


def test_what_is_left_out_is_at_most_half_of_the_log() -> None:
    warm_up = WarmUp(0.0, 40 * DEG_H, 400.0)
    assert left_out_s(warm_up, 2 * DEG_H, 7200.0) == pytest.approx(400.0 * math.log(80.0))
    assert left_out_s(warm_up, 2 * DEG_H, 1000.0) == 500.0


def test_the_slope_over_temperature() -> None:
    log = static_log(3600.0, 5.0)
    temperature = 20.0 + 10.0 * log.time_s / 3600.0
    log.rate_rad_s[:] += 3 * DEG_H * (temperature - 20.0)
    made = StaticLog("x", "", log.interval_s, log.rate_rad_s, temperature, 0.0)
    slope = temperature_slope(made)
    assert slope is not None
    assert slope.rad_s_per_c / DEG_H == pytest.approx(3.0, abs=4 * slope.sigma_rad_s_per_c / DEG_H)
    assert slope.sigma_rad_s_per_c / DEG_H < 0.1
    assert slope.correlation > 0.95
    assert slope.range_c == pytest.approx((20.0, 30.0), abs=0.1)
    assert temperature_slope(log) is None
    assert temperature_slope(StaticLog("x", "", 0.2, log.rate_rad_s, np.full(len(temperature), 20.0), 0.0)) is None
