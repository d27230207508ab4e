"""Standstill and the static bias: what is averaged, what is not."""

import math
import random

import pytest

from drd.config.keys import StaticBias
from drd.estimation.learning import RestNoise
from drd.estimation.standstill import BiasMeasurement, BiasState, Standstill
from drd.samples import CalibratedRate, WheelSample

S = 1_000_000_000
STATED = math.radians(0.083 / 60) ** 2  # rad^2/s, the default profile's angle random walk


def wheel(t_s: float, left_m: float = 0.0, right_m: float = 0.0, lost_s: float = 0.0) -> WheelSample:
    return WheelSample(round(t_s * S), 0.05, left_m, right_m, lost_s)


def test_the_last_digits_flicker_is_no_motion_but_creep_is() -> None:
    flicker = Standstill(resolution_m=1e-3)
    assert all(flicker.feed(wheel(i, right_m=1e-3 * (-1) ** i)) for i in range(50))
    creep = Standstill(resolution_m=1e-3)
    assert [creep.feed(wheel(i, left_m=1e-3)) for i in range(4)] == [True, True, False, True]


def test_motion_and_unseen_motion_are_no_standstill() -> None:
    s = Standstill(resolution_m=1e-3)
    assert not s.feed(wheel(1, left_m=0.01))
    assert s.feed(wheel(2))
    assert not s.feed(wheel(3, lost_s=1.0))


def measure(still_s: float, rate: float = 1e-3, sigma: float = 0.0, seed: int = 0) -> BiasMeasurement:
    bias, rng = BiasMeasurement(StaticBias(), RestNoise(STATED)), random.Random(seed)
    for i in range(1, 2000):
        t = i * 0.05
        if i % 2 == 0:
            moving = 0.0 if t <= still_s else 0.5
            bias.gyro(CalibratedRate(round(t * S), 0.1, rate + sigma * rng.gauss(0, 1) + moving, 0.0))
        bias.wheels(wheel(t), t <= still_s)
        if not bias.active:
            break
    return bias


def test_ten_seconds_are_averaged() -> None:
    bias = measure(60.0)
    assert bias.state is BiasState.DONE
    assert bias.averaged_s == pytest.approx(10.0, abs=0.11)
    assert bias.bias_rad_s == pytest.approx(1e-3, abs=1e-12)


def test_its_sigma_is_honest_over_seeds() -> None:
    n = math.radians(0.083 / 60)  # rad/sqrt(s), the default profile's angle random walk
    errors = []
    for seed in range(200):
        bias = measure(60.0, sigma=n / math.sqrt(0.1), seed=seed)
        errors.append(((bias.bias_rad_s - 1e-3) / bias.sigma_rad_s) ** 2)
    assert 0.7 < sum(errors) / 200 < 1.35  # 99.9 % of chi-square with 200 degrees


@pytest.mark.parametrize(("still_s", "state"), [(3.0, BiasState.SHORT), (7.0, BiasState.DONE)])
def test_motion_ends_it_and_never_enters_it(still_s: float, state: BiasState) -> None:
    bias = measure(still_s)
    assert bias.state is state
    if state is BiasState.DONE:
        assert bias.bias_rad_s == pytest.approx(1e-3, abs=1e-12)
        assert still_s - 0.5 < bias.averaged_s < still_s
    pending = bias.take_pending()
    assert pending  # the moments around the start of motion go to the filter
    assert not bias.take_pending()


def test_a_configured_zero_skips_it_and_a_request_does_not() -> None:
    bias = BiasMeasurement(StaticBias(duration_s=0.0), RestNoise(STATED))
    assert bias.state is BiasState.SKIPPED
    assert not bias.active
    bias.restart()
    assert bias.active


@pytest.mark.parametrize(("turn_deg_s", "state"), [(0.5, BiasState.MEASURING), (2.0, BiasState.SHORT)])
def test_a_turn_that_no_bias_makes_ends_the_measurement_of_a_known_one(turn_deg_s: float, state: BiasState) -> None:
    bias = BiasMeasurement(StaticBias(), RestNoise(STATED))
    bias.restart(known_rad_s=1e-3)
    for i in range(1, 100):
        t = i * 0.05
        turn = math.radians(turn_deg_s) if t > 3.0 else 0.0
        bias.gyro(CalibratedRate(round(t * S), 0.05, 1e-3 + turn, 0.0))
        bias.wheels(wheel(t), still=True)
        if not bias.active:
            break
    assert bias.state is state
    assert bias.turned is (state is BiasState.SHORT)
    if bias.turned:  # nothing of the turn is lost
        assert sum(rate.rate_rad_s > 0.01 for rate in bias.take_pending()) == 1
