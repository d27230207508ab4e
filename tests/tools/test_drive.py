from math import pi

import numpy as np
import pytest

from drd_tools.emulate.drive import STEP_S, Drive, demo_drive, square_drive

X, Y, HEADING, SPEED, RATE, TRAVEL = range(6)


def test_the_square_is_the_papers_210_m_in_about_three_minutes_and_returns_to_its_start() -> None:
    drive = square_drive()
    end = drive.at(drive.duration_s)
    assert drive.length_m == pytest.approx(210.0, abs=0.001)
    assert 160.0 < drive.duration_s < 200.0
    assert np.hypot(end.x_m, end.y_m) < 0.001
    assert end.heading_rad == pytest.approx(2 * pi, abs=1e-6)


def test_a_clockwise_square_is_the_mirror_image() -> None:
    ccw, cw = square_drive().table, square_drive(clockwise=True).table
    for column, sign in ((X, 1), (Y, -1), (HEADING, -1), (SPEED, 1), (RATE, -1)):
        np.testing.assert_allclose(cw[:, column], sign * ccw[:, column], atol=1e-9)


def test_laps_repeat_the_square() -> None:
    drive = square_drive(side_m=10.0, laps=3)
    end = drive.at(drive.duration_s)
    assert drive.length_m == pytest.approx(120.0, abs=0.001)
    assert end.heading_rad == pytest.approx(6 * pi, abs=1e-6)
    assert np.hypot(end.x_m, end.y_m) < 0.001


def test_the_square_slows_down_for_its_corners_and_never_exceeds_its_speed() -> None:
    table = square_drive().table
    assert 1.49 < table[:, SPEED].max() <= 1.5 + 1e-9
    in_corner = table[:, RATE] > 0.01
    assert table[in_corner, SPEED].max() < 0.85
    assert table[in_corner, SPEED].mean() == pytest.approx(0.8, abs=0.05)
    assert table[:, SPEED].min() >= 0.0


@pytest.mark.parametrize("drive", [square_drive(), demo_drive(60.0), demo_drive(25.0), demo_drive(8.0, 2.0)])
def test_speed_and_yaw_rate_are_smooth_and_their_integrals_are_the_path(drive: Drive) -> None:
    table = drive.table
    assert np.abs(np.diff(table[:, SPEED])).max() / STEP_S < 0.6  # m/s^2
    assert np.abs(np.diff(table[:, RATE])).max() / STEP_S < 2.0  # rad/s^2
    assert np.abs(table[:, RATE]).max() < 1.0
    heading = np.concatenate(([0.0], np.cumsum(table[:-1, RATE]) * STEP_S))
    np.testing.assert_allclose(table[:, HEADING], heading, atol=2e-3)
    moved = np.hypot(np.diff(table[:, X]), np.diff(table[:, Y]))
    assert moved.sum() == pytest.approx(drive.length_m, rel=1e-6)
    along = np.arctan2(np.diff(table[:, Y]), np.diff(table[:, X]))
    turned = np.angle(np.exp(1j * (along - table[:-1, HEADING])))
    assert np.abs(turned[moved > 1e-5]).max() < 0.002


def test_the_robot_stands_at_the_origin_first_and_at_the_end_for_ever() -> None:
    drive = square_drive(stand_s=5.0)
    for t_s in (-1.0, 0.0, 4.9):
        assert drive.at(t_s) == (0.0, 0.0, 0.0, 0.0, 0.0)
    assert drive.at(6.0).v_m_s > 0.0
    end = drive.at(drive.duration_s - 1.5)
    assert end.v_m_s == 0.0
    assert drive.at(drive.duration_s + 1e6) == end
    assert drive.travel_m(1e6) == drive.length_m


def test_a_drive_that_ends_in_motion_stands_afterwards() -> None:
    drive = Drive(np.full(1001, 2.0), np.full(1001, 0.5))
    assert drive.at(1.0).v_m_s == 2.0
    after = drive.at(1.001)
    assert (after.v_m_s, after.w_rad_s) == (0.0, 0.0)
    assert after.heading_rad == pytest.approx(0.5)


def test_a_circle_comes_out_exactly() -> None:
    drive = Drive(np.full(10_001, 1.0), np.full(10_001, 0.3))
    for t_s in (0.5, 3.14159, 10.0):
        motion = drive.at(t_s)
        assert motion.x_m == pytest.approx(np.sin(0.3 * t_s) / 0.3, abs=1e-6)
        assert motion.y_m == pytest.approx((1 - np.cos(0.3 * t_s)) / 0.3, abs=1e-6)
        assert drive.travel_m(t_s) == pytest.approx(t_s)


@pytest.mark.parametrize("seconds", [45.0, 60.0, 130.0, 300.0])
def test_a_long_demo_is_closed_figures_of_eight_within_its_time(seconds: float) -> None:
    drive = demo_drive(seconds)
    end = drive.at(seconds)
    assert drive.duration_s == pytest.approx(seconds, abs=0.01)
    assert (end.v_m_s, drive.at(seconds - 1.0).v_m_s, drive.at(9.9).v_m_s) == (0.0, 0.0, 0.0)
    assert np.hypot(end.x_m, end.y_m) < 0.01
    assert end.heading_rad == pytest.approx(0.0, abs=1e-3)
    assert drive.table[:, HEADING].max() > 2.0
    assert drive.table[:, HEADING].min() < -2.0
    assert drive.length_m > 0.9 * 1.5 * (seconds - 10.0 - 2.0 - 3.0 - 0.8)


@pytest.mark.parametrize("seconds", [0.001, 0.5, 3.0, 11.0, 13.0, 15.0, 25.0])
def test_a_short_demo_still_stands_drives_and_stops(seconds: float) -> None:
    drive = demo_drive(seconds, stand_s=min(10.0, seconds / 3))
    assert drive.duration_s == pytest.approx(max(seconds, STEP_S), abs=0.01)
    assert drive.at(seconds).v_m_s == 0.0
    assert np.abs(drive.table[:, RATE]).max() < 0.81


@pytest.mark.parametrize("seconds", [0.001, 0.01, *np.arange(0.1, 6.0, 0.1)])
@pytest.mark.parametrize("share", [0.0, 1 / 3])
def test_a_demo_of_any_short_length_takes_its_time_and_stands_at_its_end(seconds: float, share: float) -> None:
    drive = demo_drive(seconds, stand_s=share * seconds)
    assert np.isfinite(drive.table).all()
    assert drive.duration_s == pytest.approx(seconds, abs=0.02)
    assert drive.at(seconds + 0.02).v_m_s == 0.0
    assert np.abs(np.diff(drive.table[:, SPEED])).max() / STEP_S < 0.6


def test_a_demo_that_is_shorter_than_its_standstill_only_stands() -> None:
    assert demo_drive(8.0).length_m == 0.0
