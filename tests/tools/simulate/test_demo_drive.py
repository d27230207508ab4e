import numpy as np
import pytest

from drd_tools.simulate.missions import Drive, demo_drive, make_drive
from drd_tools.simulate.route import RATE_HZ, STEP_S, Steps
from drd_tools.simulate.truth import Truth, make_truth


def demo(seconds: float, stand_s: float = 10.0) -> Truth:
    return make_truth(demo_drive(seconds, stand_s))


def steady(speed_m_s: float, rate_rad_s: float, seconds: int) -> Truth:
    step = np.full(seconds * RATE_HZ, STEP_S)
    return make_truth(Drive(Steps(speed_m_s * step, rate_rad_s * step), 0))


@pytest.mark.parametrize("truth", [demo(60.0), demo(25.0), demo(8.0, 2.0)])
def test_speed_and_yaw_rate_are_smooth_and_their_integrals_are_the_path(truth: Truth) -> None:
    assert np.abs(np.diff(truth.speed_m_s)).max() / STEP_S < 0.6  # m/s^2
    assert np.abs(np.diff(truth.rate_rad_s)).max() / STEP_S < 2.0  # rad/s^2
    assert np.abs(truth.rate_rad_s).max() < 1.0
    heading = np.concatenate(([0.0], np.cumsum(truth.rate_rad_s) * STEP_S))
    np.testing.assert_allclose(truth.heading_rad, heading, atol=1e-9)
    moved = np.hypot(np.diff(truth.x_m), np.diff(truth.y_m))
    assert moved.sum() == pytest.approx(truth.length_m, rel=1e-6)
    along = np.arctan2(np.diff(truth.y_m), np.diff(truth.x_m))
    turned = np.angle(np.exp(1j * (along - truth.heading_rad[:-1])))
    assert np.abs(turned[moved > 1e-5]).max() < 0.002


def test_the_robot_stands_at_the_origin_first_and_at_the_end_for_ever() -> None:
    truth = make_truth(make_drive("square-ccw", stand_s=5.0))
    for t_s in (-1.0, 0.0, 4.9):
        assert truth.at(t_s) == (0.0, 0.0, 0.0, 0.0)
    assert truth.at(6.0).distance_m > 0.0
    end = truth.at(truth.duration_s - 0.9)
    assert truth.at(truth.duration_s + 1e6) == pytest.approx(end)
    assert end.distance_m == pytest.approx(210.0, abs=0.001)


def test_a_circle_comes_out_exactly() -> None:
    truth = steady(1.0, 0.3, 10)
    for t_s in (0.5, 3.14159, 10.0):
        place = truth.at(t_s)
        assert place.x_m == pytest.approx(np.sin(0.3 * t_s) / 0.3, abs=1e-6)
        assert place.y_m == pytest.approx((1 - np.cos(0.3 * t_s)) / 0.3, abs=1e-6)
        assert place.heading_rad == pytest.approx(0.3 * t_s)
        assert place.distance_m == pytest.approx(t_s)


@pytest.mark.parametrize("seconds", [45.0, 60.0, 130.0, 300.0])
def test_a_long_demo_is_closed_figures_of_eight_within_its_time(seconds: float) -> None:
    truth = demo(seconds)
    end = truth.at(seconds)
    assert truth.duration_s == pytest.approx(seconds, abs=0.01)
    assert (truth.speed_m_s[-500:] == 0.0).all()
    assert (truth.speed_m_s[: round(9.9 * RATE_HZ)] == 0.0).all()
    assert np.hypot(end.x_m, end.y_m) < 0.01
    assert end.heading_rad == pytest.approx(0.0, abs=1e-3)
    assert truth.heading_rad.max() > 2.0
    assert truth.heading_rad.min() < -2.0
    assert truth.length_m > 0.9 * 1.5 * (seconds - 10.0 - 2.0 - 3.0 - 0.8)


@pytest.mark.parametrize("seconds", [0.001, 0.01, 0.5, 11.0, 13.0, 15.0, 25.0, *np.arange(0.1, 6.0, 0.1)])
@pytest.mark.parametrize("share", [0.0, 1 / 3])
def test_a_demo_of_any_short_length_takes_its_time_and_stands_at_its_end(seconds: float, share: float) -> None:
    truth = demo(seconds, share * seconds)
    assert all(np.isfinite(a).all() for a in (truth.x_m, truth.y_m, truth.heading_rad))
    assert truth.duration_s == pytest.approx(seconds, abs=0.002)
    assert truth.speed_m_s[-1] == pytest.approx(0.0, abs=1e-3)
    assert np.abs(truth.rate_rad_s).max() < 0.81
    assert np.abs(np.diff(truth.speed_m_s)).max(initial=0.0) / STEP_S < 0.6


def test_a_demo_that_is_shorter_than_its_standstill_only_stands() -> None:
    assert demo(8.0).length_m == 0.0
