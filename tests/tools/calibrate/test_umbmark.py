"""UMBmark against an independent simulation of the robot: signs, sizes, uncertainty, and what it cannot tell."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.config.schema import ConfigError
from drd_tools.calibrate.wheels.squares import misfit, significance
from drd_tools.calibrate.wheels.umbmark import (
    Returns,
    evaluate,
    leave_one_pair_out,
    predict_m,
    read_returns,
    runs_problem,
)

SIDE_M, TREAD_M, RADIUS_M = 4.0, 0.5, 0.1


def end_of_square(E_d: float, E_b: float, direction: int) -> tuple[float, float]:
    """Where a robot with these wheels stands when its nominal odometry is back at the origin.

    Wheel by wheel in small steps; it shares nothing with the module under test. The mean diameter is the nominal one.
    """
    left_m = 2.0 * RADIUS_M / (E_d + 1.0)
    right_m = E_d * left_m
    x_m = y_m = heading = 0.0
    side_rad, turn_rad = SIDE_M / RADIUS_M, direction * TREAD_M * math.pi / 4.0 / RADIUS_M
    for left_rad, right_rad in ((side_rad, side_rad), (-turn_rad, turn_rad)) * 4:
        for _ in range(100):
            u_l, u_r = left_m * left_rad / 100, right_m * right_rad / 100
            turn = (u_r - u_l) / (E_b * TREAD_M)
            x_m += 0.5 * (u_l + u_r) * math.cos(heading + 0.5 * turn)
            y_m += 0.5 * (u_l + u_r) * math.sin(heading + 0.5 * turn)
            heading += turn
    return x_m, y_m


def ten_squares(E_d: float, E_b: float, sigma_m: float = 0.0, seed: int = 0, runs: int = 5) -> Returns:
    noise = np.random.default_rng(seed).normal(0.0, sigma_m, (2, runs, 2))
    return Returns(end_of_square(E_d, E_b, -1) + noise[0], end_of_square(E_d, E_b, 1) + noise[1])


@pytest.mark.parametrize(("E_d", "E_b"), [(1.0, 1.02), (1.0, 0.98), (1.005, 1.0), (0.995, 1.0), (1.01, 0.96)])
def test_known_errors_of_both_types_and_signs_are_found(E_d: float, E_b: float) -> None:
    found = evaluate(ten_squares(E_d, E_b), SIDE_M, TREAD_M)
    assert found.E_d.value == pytest.approx(E_d, abs=2e-5)
    assert found.E_b.value == pytest.approx(E_b, abs=5e-5)
    assert found.tread_m.value == pytest.approx(E_b * TREAD_M, abs=5e-5)
    assert found.e_max_after_m.value < 0.01 * found.e_max_before_m.value


@settings(deadline=None)
@given(E_d=st.floats(0.99, 1.01), E_b=st.floats(0.95, 1.05))
def test_any_moderate_pair_of_errors_is_found(E_d: float, E_b: float) -> None:
    found = evaluate(ten_squares(E_d, E_b), SIDE_M, TREAD_M)
    assert found.E_d.value == pytest.approx(E_d, abs=1e-4)
    assert found.E_b.value == pytest.approx(E_b, abs=2e-4)


@pytest.mark.parametrize(("E_d", "E_b"), [(1.005, 1.03), (0.994, 0.97)])
def test_the_corrections_make_the_robot_drive_a_true_square(E_d: float, E_b: float) -> None:
    found = evaluate(ten_squares(E_d, E_b), SIDE_M, TREAD_M)
    # With c_l, c_r and the tread in its odometry the robot's wheels are what its odometry believes.
    left_m, right_m = 2.0 / (E_d + 1.0), 2.0 * E_d / (E_d + 1.0)
    assert found.c_l.value == pytest.approx(left_m, abs=2e-5)
    assert found.c_r.value == pytest.approx(right_m, abs=2e-5)
    assert found.c_l.value + found.c_r.value == pytest.approx(2.0, abs=1e-9)


def test_type_a_and_type_b_have_their_signs() -> None:
    # A tread larger than believed turns too little; a larger right wheel bends to the left.
    assert evaluate(ten_squares(1.0, 1.02), SIDE_M, TREAD_M).alpha_rad.value < 0.0
    assert evaluate(ten_squares(1.005, 1.0), SIDE_M, TREAD_M).beta_rad.value > 0.0
    # Borenstein and Feng: type A ends on the same side in x both ways, type B on opposite sides.
    a, b = ten_squares(1.0, 1.02), ten_squares(1.005, 1.0)
    assert a.cw_m[0, 0] * a.ccw_m[0, 0] > 0.0
    assert b.cw_m[0, 0] * b.ccw_m[0, 0] < 0.0


def test_the_prediction_is_what_small_angles_give() -> None:
    cw, ccw = predict_m(1e-4, 3e-4, SIDE_M)
    assert ccw == pytest.approx([2 * SIDE_M * 4e-4, -2 * SIDE_M * 4e-4], rel=1e-2)
    assert cw == pytest.approx([-2 * SIDE_M * 2e-4, -2 * SIDE_M * 2e-4], rel=1e-2)


@pytest.mark.parametrize("runs", [2, 5])
@pytest.mark.parametrize(("sigma_m", "read_to_m"), [(0.02, 1e-6), (0.004, 0.01)])
def test_sigmas_cover_the_truth(runs: int, sigma_m: float, read_to_m: float) -> None:
    off = []
    for seed in range(200):
        E_b = 1.02 + 1e-5 * seed  # rounded up and down
        exact = ten_squares(1.004, E_b, sigma_m, seed, runs)
        read = Returns(*(read_to_m * np.round(m / read_to_m) for m in (exact.cw_m, exact.ccw_m)))
        found = evaluate(read, SIDE_M, TREAD_M)
        off.append([(found.E_d.value - 1.004) / found.E_d.sigma, (found.E_b.value - E_b) / found.E_b.sigma])
    assert (np.mean(np.abs(off) < 1.96, axis=0) > 0.9).all()


def test_runs_that_agree_to_the_digit_leave_the_tread_unsure() -> None:
    exact = ten_squares(1.004, 1.02)
    found = evaluate(Returns(exact.cw_m.round(2), exact.ccw_m.round(2)), SIDE_M, TREAD_M)
    # Four coordinates rounded to 1 cm tell alpha by their sum over 8 sides; 1.18 is t with 8 degrees of freedom.
    alpha_rad = 1.18 * 0.01 * math.sqrt(4 / 12) / (8 * SIDE_M)
    assert found.E_b.sigma == pytest.approx(alpha_rad / (math.pi / 2), rel=0.1)


def test_a_spread_larger_than_the_effect_is_called_not_significant() -> None:
    noisy = evaluate(ten_squares(1.0, 1.03, 0.02, 3), SIDE_M, TREAD_M)
    assert noisy.significant[0]
    assert not noisy.significant[1]
    assert len(significance(noisy)) == 1
    assert "wheel diameters (beta, E_d): not significant: " in significance(noisy)[0]


def test_swapped_axes_are_noticed() -> None:
    good = ten_squares(1.004, 1.02, 0.005)
    swapped = Returns(good.cw_m[:, ::-1], good.ccw_m[:, ::-1])
    assert misfit(evaluate(good, SIDE_M, TREAD_M), good) == []
    assert "do not fit" in misfit(evaluate(swapped, SIDE_M, TREAD_M), swapped)[0]


def test_a_pair_that_was_left_out_is_predicted_to_within_its_spread() -> None:
    before_m, after_m = leave_one_pair_out(ten_squares(1.004, 1.02, 0.01), SIDE_M)
    assert before_m.shape == after_m.shape == (5, 2)
    assert before_m.max() > 0.5
    assert after_m.max() < 0.05


def test_single_runs_have_no_known_uncertainty_and_no_held_out_figure() -> None:
    returns = ten_squares(1.004, 1.02, runs=1)
    found = evaluate(returns, SIDE_M, TREAD_M)
    assert math.isnan(found.E_b.sigma)
    assert found.significant == (False, False)
    assert "unknown" in significance(found)[0]
    assert len(leave_one_pair_out(returns, SIDE_M)[0]) == 0
    assert "1 cw and 1 ccw" in runs_problem(returns)


def test_one_direction_cannot_be_evaluated() -> None:
    with pytest.raises(ValueError, match="both directions"):
        evaluate(Returns(np.zeros((5, 2)), np.zeros((0, 2))), SIDE_M, TREAD_M)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", r"returns.csv: .*expected the header direction,x_m,y_m, got an empty file"),
        ("way,x_m,y_m\ncw,0,0\n", r"returns.csv:1: header: expected direction,x_m,y_m, got 'way,x_m,y_m'"),
        ("direction,x_m,y_m\ncw,0,0\nleft,0,0\n", r"returns.csv:3: direction: expected cw or ccw, got 'left'"),
        ("direction,x_m,y_m\ncw,0,zero\n", r"returns.csv:2: y_m: expected a finite number, got 'zero'"),
        ("direction,x_m,y_m\ncw,nan,0\n", r"returns.csv:2: x_m: expected a finite number, got 'nan'"),
        ("# a comment\n\ndirection,x_m,y_m\n\ncw,0\n", r"returns.csv:5: .*expected 3 columns, got 2"),
        ("direction,x_m,y_m\n", r"at least 1 row of numbers"),
    ],
)
def test_bad_returns_name_line_and_column(tmp_path: Path, text: str, expected: str) -> None:
    file = tmp_path / "returns.csv"
    file.write_text(text)
    with pytest.raises(ConfigError, match=expected):
        read_returns(file)


def test_returns_are_read_with_comments_and_spreadsheet_marks(tmp_path: Path) -> None:
    file = tmp_path / "returns.csv"
    file.write_bytes(b"\xef\xbb\xbf# hall, 3 May\r\ndirection,x_m,y_m\r\nccw,0.1,-0.2\r\ncw, 0.3, 0.4\r\n")
    returns = read_returns(file)
    assert returns.ccw_m.tolist() == [[0.1, -0.2]]
    assert returns.cw_m.tolist() == [[0.3, 0.4]]


def test_a_missing_file_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected a readable UTF-8 text file, got No such file"):
        read_returns(tmp_path / "none.csv")
