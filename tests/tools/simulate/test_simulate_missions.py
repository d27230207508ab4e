"""What the missions promise: laps that close, limits that are kept, places that are reached."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.config.schema import ConfigError
from drd_tools.simulate.missions import MISSIONS, Drive, make_drive, read_waypoints
from drd_tools.simulate.route import (
    ACCELERATION_M_S2,
    LATERAL_M_S2,
    RATE_HZ,
    RATE_LIMIT_RAD_S,
    STEP_S,
    Route,
)
from drd_tools.simulate.temperature import PROFILES, temperature_c
from drd_tools.simulate.truth import Truth, make_truth


def driven(mission: str, seconds: float | None = None) -> Truth:
    return make_truth(make_drive(mission, seconds), "constant")


@pytest.mark.parametrize("mission", MISSIONS)
@pytest.mark.parametrize("seconds", [None, 900.0])
def test_a_mission_ends_where_it_began(mission: str, seconds: float | None) -> None:
    truth = driven(mission, seconds)
    assert truth.laps >= 1
    assert math.hypot(truth.x_m[-1] - truth.x_m[0], truth.y_m[-1] - truth.y_m[0]) < 0.001
    assert math.remainder(truth.heading_rad[-1], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-6)
    assert truth.speed_m_s[-1] == truth.rate_rad_s[-1] == 0.0


@pytest.mark.parametrize("mission", MISSIONS)
def test_a_mission_keeps_to_what_a_robot_can_do(mission: str) -> None:
    truth = driven(mission)
    assert np.abs(np.diff(truth.speed_m_s)).max() / STEP_S <= 1.05 * ACCELERATION_M_S2
    assert np.abs(truth.rate_rad_s).max() <= 1.03 * RATE_LIMIT_RAD_S
    assert np.abs(truth.rate_rad_s * truth.speed_m_s).max() <= 1.15 * LATERAL_M_S2
    smooth = np.convolve(truth.rate_rad_s, np.full(25, 1.0 / 25.0), "valid")  # over 50 ms
    assert np.abs(np.diff(smooth)).max() / STEP_S < 2.0
    standing = truth.middle_s < 10.0
    assert not truth.speed_m_s[standing].any()
    assert not truth.rate_rad_s[standing].any()


@pytest.mark.parametrize("mission", ["eights", "umbmark-cw"])
def test_as_many_laps_as_fit(mission: str) -> None:
    truth = driven(mission, 600.0)
    assert len(truth.speed_m_s) == 600 * RATE_HZ
    lap_s = driven(mission).duration_s - 11.0  # less the standstills at the start and the end
    assert truth.laps > 1
    at_rest_s = (len(truth.speed_m_s) - np.flatnonzero(truth.speed_m_s)[-1]) * STEP_S
    assert at_rest_s < lap_s + 5.0


def test_without_time_for_a_lap_it_is_cut() -> None:
    truth, whole = driven("square-cw", 60.0), driven("square-cw")
    assert truth.laps == 0
    assert truth.duration_s == 60.0
    np.testing.assert_array_equal(truth.x_m, whole.x_m[: len(truth.x_m)])


def test_the_papers_square() -> None:
    cw, ccw = driven("square-cw"), driven("square-ccw")
    assert cw.length_m == pytest.approx(210.0, abs=1e-3)
    assert 160.0 < cw.duration_s < 190.0  # about three minutes
    assert cw.heading_rad[-1] == pytest.approx(-2.0 * math.pi)
    np.testing.assert_allclose(ccw.y_m, -cw.y_m, atol=1e-9)
    assert cw.speed_m_s.max() == pytest.approx(1.5)


def test_umbmark_stops_in_the_corners_of_a_square_of_4_m() -> None:
    truth = driven("umbmark-ccw")
    for x, y in ((4.0, 0.0), (4.0, 4.0), (0.0, 4.0)):
        there = np.hypot(truth.x_m[1:] - x, truth.y_m[1:] - y) < 1e-3
        assert there.any()
        assert np.ptp(truth.heading_rad[1:][there]) == pytest.approx(0.5 * math.pi, abs=1e-3)


def test_spins_turn_at_several_rates_both_ways_on_the_spot() -> None:
    truth = driven("spins")
    assert not truth.speed_m_s.any()
    for rate_deg_s in (5.0, 15.0, 30.0, 50.0):
        for side in (1.0, -1.0):
            steady = np.isclose(truth.rate_rad_s, side * math.radians(rate_deg_s), rtol=1e-3)
            assert steady.sum() * STEP_S > 10.0


def test_the_warehouse_has_stops_reversing_and_turns_to_both_sides() -> None:
    truth = driven("warehouse", 400.0)
    assert truth.speed_m_s.min() < -0.3
    starts = np.flatnonzero((truth.speed_m_s[1:] != 0.0) & (truth.speed_m_s[:-1] == 0.0))
    assert len(starts) >= 8
    assert truth.rate_rad_s.min() == pytest.approx(-truth.rate_rad_s.max(), rel=1e-3)


def test_the_fields_lines_are_3_m_apart() -> None:
    truth = driven("field")
    middle = np.flatnonzero(np.diff(np.sign(truth.x_m - 15.0)))
    np.testing.assert_allclose(truth.y_m[middle], [0.0, 3.0, 6.0, 9.0], atol=1e-3)


def test_the_slalom_weaves_to_both_sides() -> None:
    truth = driven("slalom")
    crossings = np.flatnonzero(np.diff(np.sign(truth.rate_rad_s[truth.rate_rad_s != 0.0])))
    assert len(crossings) >= 25


POINTS = st.lists(st.tuples(st.integers(-20, 20), st.integers(-20, 20)), min_size=2, max_size=6, unique=True).map(
    lambda points: [(float(x), float(y)) for x, y in points if (x, y) != (0, 0)]
)


@settings(deadline=None, max_examples=40)
@given(points=POINTS)
def test_a_route_goes_to_the_last_point_and_near_all_others(points: list[tuple[float, float]]) -> None:
    if not points:
        return
    truth = make_truth(Drive(Route().go(points, 1.0, corner_m=2.0).steps(), 1), "constant")
    assert (truth.x_m[-1], truth.y_m[-1]) == pytest.approx(points[-1], abs=2e-3)
    for x, y in points:
        assert np.hypot(truth.x_m - x, truth.y_m - y).min() < 1.5


def test_waypoints_of_a_file_are_visited(tmp_path: Path) -> None:
    file = tmp_path / "way.csv"
    file.write_text("x_m,y_m,speed_m_s\n1,1,9\n11,1,0.5\n11,9,1\n")
    truth = driven(str(file))
    assert (truth.x_m[0], truth.y_m[0], truth.heading_rad[0]) == (1.0, 1.0, 0.0)
    assert (truth.x_m[-1], truth.y_m[-1]) == pytest.approx((11.0, 9.0), abs=1e-3)
    first_leg = (truth.x_m[1:] < 8.0) & (truth.speed_m_s > 0.0)
    assert truth.speed_m_s[first_leg].max() == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("text", "where", "expected"),
    [
        ("x,y\n1,2\n", "way.csv:1", "x_m,y_m or"),
        ("x_m,y_m\n1,2\n", "way.csv:", "at least 2"),
        ("x_m,y_m\n1,2\n3,four\n", "way.csv:3", "a finite number"),
        ("x_m,y_m\n1,2\n3\n", "way.csv:3", "2 columns"),
        ("x_m,y_m\n1,2\n1,2\n", "way.csv:", "at least 0.01 m apart"),
        ("x_m,y_m,speed_m_s\n1,2,1\n3,4,0\n", "way.csv:3", "0.05 to 10"),
    ],
)
def test_a_bad_file_of_waypoints_is_named(tmp_path: Path, text: str, where: str, expected: str) -> None:
    file = tmp_path / "way.csv"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_waypoints(file)
    assert where in str(caught.value)
    assert expected in str(caught.value)


@pytest.mark.parametrize("name", PROFILES)
def test_a_temperature_profile_stays_between_what_it_says(name: str) -> None:
    time_s = np.arange(0.0, 900.0, 0.5)
    values = temperature_c(f"{name}:12:18" if name != "warmup" else "warmup:12:6", time_s, 900.0)
    assert values.min() >= 12.0 - 1e-9
    assert values.max() <= 18.0 + 1e-9
    assert (np.ptp(values) > 3.0) == (name != "constant")


def test_a_temperature_profile_of_a_file_is_interpolated(tmp_path: Path) -> None:
    file = tmp_path / "t.csv"
    file.write_text("time_s,temperature_c\n0,10\n100,20\n")
    np.testing.assert_allclose(temperature_c(str(file), np.array([0.0, 50.0, 200.0]), 200.0), [10.0, 15.0, 20.0])


@pytest.mark.parametrize("text", ["hot", "constant:x", "rise:1:2:3", "rise:nan", "constant:500"])
def test_an_unknown_profile_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--temperature"):
        temperature_c(text, np.zeros(1), 1.0)
