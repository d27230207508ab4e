from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from perfect_hardware import PERFECT

from drd.config.keys import Robot
from drd.units import RAD_PER_DEG
from drd_tools.emulate.fault import Fault
from drd_tools.emulate.sensors import SensorErrors, Sensors
from drd_tools.simulate.missions import Drive, demo_drive
from drd_tools.simulate.route import RATE_HZ, STEP_S, Steps
from drd_tools.simulate.truth import Truth, make_truth

ROBOT = Robot(wheel_radius_m=0.1, tread_m=0.6)


def steady(speed_m_s: float, rate_rad_s: float, seconds: float) -> Truth:
    step = np.full(round(seconds * RATE_HZ), STEP_S)
    return make_truth(Drive(Steps(speed_m_s * step, rate_rad_s * step), 0))


STANDING = steady(0.0, 0.0, 0.02)


def straight(metres: int) -> Truth:
    return steady(1.0, 0.0, metres)


def sensors(truth: Truth, errors: SensorErrors = PERFECT, seed: int = 0) -> Sensors:
    return Sensors(truth, ROBOT, errors, seed)


def test_a_perfect_gyro_says_the_change_of_heading() -> None:
    drive = make_truth(demo_drive(40.0, 2.0))
    gyro = sensors(drive)
    times_s = np.arange(0.0, 40.0, 0.1)
    summed = np.cumsum([0.1 * gyro.rate_rad_s(t, t + 0.1) for t in times_s])
    true = [drive.at(t + 0.1).heading_rad for t in times_s]
    np.testing.assert_allclose(summed, true, atol=1e-12)


def test_bias_and_angle_random_walk_are_those_of_the_datasheet() -> None:
    n, interval_s = 20_000, 0.1
    errors = SensorErrors(warm_up_c=0.0)
    gyro = sensors(STANDING, errors, 1)
    rates = np.array([gyro.rate_rad_s(k * interval_s, (k + 1) * interval_s) for k in range(n)])
    # 5 deg/h/sqrt(Hz) = 0.0833 deg/sqrt(h) = 2.42e-5 rad/sqrt(s)
    sigma_rad_s = 2.424e-5 / sqrt(interval_s)
    assert rates.std() == pytest.approx(sigma_rad_s, rel=4 / sqrt(2 * n))
    assert rates.mean() == pytest.approx(0.02 * RAD_PER_DEG, abs=4 * sigma_rad_s / sqrt(n))
    assert abs(np.corrcoef(rates[1:], rates[:-1])[0, 1]) < 4 / sqrt(n)


def test_the_noise_of_an_angle_does_not_depend_on_the_interval() -> None:
    for interval_s in (0.01, 1.0):
        gyro = sensors(STANDING, replace(PERFECT, angle_random_walk_deg_per_sqrt_h=6.0), 2)
        angles = [gyro.rate_rad_s(0.0, interval_s) * interval_s for _ in range(4000)]
        assert np.std(angles) == pytest.approx(0.1 * RAD_PER_DEG * sqrt(interval_s), rel=0.05)


def test_a_scale_error_shows_in_turns_only() -> None:
    drive = steady(0.0, -0.5, 2.0)
    gyro = sensors(drive, replace(PERFECT, scale_error=0.003))
    assert gyro.rate_rad_s(0.5, 1.5) == pytest.approx(-0.5 * 1.003, rel=1e-9)
    assert gyro.rate_rad_s(5.0, 6.0) == 0.0


def test_the_bias_follows_the_temperature() -> None:
    errors = replace(PERFECT, temperature_c=20.0, warm_up_c=10.0, warm_up_s=100.0, bias_deg_s_per_c=0.002)
    gyro = sensors(STANDING, errors)
    assert gyro.temperature_c(0.0) == 20.0
    assert gyro.temperature_c(100.0) == pytest.approx(20.0 + 10.0 * 0.63212, abs=1e-3)
    assert gyro.rate_rad_s(1e5, 1e5 + 0.1) == pytest.approx(0.02 * RAD_PER_DEG, rel=1e-6)


def test_the_same_seed_repeats_the_noise_and_another_does_not() -> None:
    def say(seed: int) -> list[float]:
        gyro, wheels = (sensors(truth, SensorErrors(), seed) for truth in (STANDING, straight(3)))
        return [gyro.rate_rad_s(0.0, 0.1), *wheels.travel_m(1.0), *wheels.travel_m(2.0)]

    assert say(7) == say(7)
    assert not set(say(7)) & set(say(8))


def test_perfect_wheels_give_travel_and_heading_back() -> None:
    drive = make_truth(demo_drive(40.0, 2.0))
    wheels = sensors(drive)
    for t_s in (10.0, 20.0, 40.0):
        left_m, right_m = wheels.travel_m(t_s)
        assert (left_m + right_m) / 2 == pytest.approx(drive.at(t_s).distance_m, abs=1e-9)
        assert (right_m - left_m) / 0.6 == pytest.approx(drive.at(t_s).heading_rad, abs=1e-9)


def test_a_larger_wheel_counts_less_and_a_wider_tread_turns_more() -> None:
    errors = replace(PERFECT, left_radius_error=0.01, right_radius_error=-0.02)
    left_m, right_m = sensors(straight(10), errors).travel_m(10.0)
    assert (left_m, right_m) == pytest.approx((10 / 1.01, 10 / 0.98))
    turning = steady(0.0, 1.0, 1.0)
    left_m, right_m = sensors(turning, replace(PERFECT, tread_error=0.1)).travel_m(1.0)
    assert (left_m, right_m) == pytest.approx((-0.33, 0.33))


def test_slip_noise_grows_with_the_root_of_the_way_however_often_it_is_sampled() -> None:
    errors = replace(PERFECT, slip_m_per_sqrt_m=0.01)
    drive = straight(4)
    for steps in (1, 20):
        ends = []
        for seed in range(800):
            wheels = sensors(drive, errors, seed)
            for k in range(steps):
                travel_m = wheels.travel_m(4.0 * (k + 1) / steps)
            ends.append(travel_m)
        noise_m = np.array(ends) - 4.0
        assert noise_m.std(axis=0) == pytest.approx([0.02, 0.02], rel=0.1)
        assert abs(np.mean(noise_m[:, 0] * noise_m[:, 1])) < 0.15 * 0.02**2


def test_slip_adds_counts_while_it_lasts_and_minus_one_stops_a_counter() -> None:
    wheels = sensors(straight(4))
    assert wheels.travel_m(1.0) == pytest.approx((1.0, 1.0))
    assert wheels.travel_m(2.0, left_slip=0.1) == pytest.approx((2.1, 2.0))
    assert wheels.travel_m(3.0, right_slip=-1.0) == pytest.approx((3.1, 2.0))
    assert wheels.travel_m(4.0) == pytest.approx((4.1, 3.0))


def test_wheels_that_stand_count_nothing() -> None:
    wheels = sensors(STANDING, SensorErrors())
    assert wheels.travel_m(5.0) == (0.0, 0.0)


def test_a_fault_adds_to_what_the_sensors_say() -> None:
    time_s = np.array([0.0, 2.0, 4.0])
    fault = Fault(time_s, np.array([[0.0, 0.0, 0.1], [0.0, 0.0, -0.2], [0.0, 0.0, 0.3]]))
    found = Sensors(straight(5), ROBOT, PERFECT, 0, fault)
    assert found.travel_m(2.0) == pytest.approx((2.0, 2.0))
    assert found.travel_m(4.0) == pytest.approx((4.1, 3.8))
    assert found.rate_rad_s(1.0, 2.0) == pytest.approx(0.0)
    assert found.rate_rad_s(2.0, 3.0) == pytest.approx(0.15)
