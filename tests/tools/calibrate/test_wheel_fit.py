"""Least squares for the wheels: recovers known wheels, says what it cannot tell, and is as sure as it says."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wheel_recordings import CIRCLE, RADIUS_M, SPIN, STRAIGHT, TOUR, TREAD_M, Leg, Truth, write_drive

from drd.config.schema import ConfigError
from drd_tools.calibrate.wheels.drive import Drive, Wheels, make_drive, odometry
from drd_tools.calibrate.wheels.fit import fit_wheels, new_part
from drd_tools.calibrate.wheels.heldout import compare, leave_one_out
from drd_tools.calibrate.wheels.whole_turns import with_turns
from drd_tools.calibrate.wheels.words import held_out_warnings, not_determined, warnings
from drd_tools.recordings.folder import read_recording

TRUTH = Truth(left=1.006, right=0.995, tread=1.04)
SPINNING: tuple[Leg, ...] = (*TOUR, *((0.0, 0.8, 15.0), (0.5, 0.1, 9.0), (0.3, -0.6, 14.0)) * 2)
NOISY = replace(TRUTH, slip_m_per_sqrt_m=0.002, position_sigma_m=0.005, heading_sigma_rad=0.003)


def drive(folder: Path, legs: tuple[Leg, ...], truth: Truth, seed: int = 0, **options: int | bool | float) -> Drive:
    return make_drive(read_recording(write_drive(folder, legs, truth, seed, **options)))  # type: ignore[arg-type]


def relative(wheels: Wheels) -> list[float]:
    return [wheels.left_radius_m / RADIUS_M, wheels.right_radius_m / RADIUS_M, wheels.tread_m / TREAD_M]


@settings(deadline=None, max_examples=8)
@given(left=st.floats(0.97, 1.03), right=st.floats(0.97, 1.03), tread=st.floats(0.9, 1.9))
def test_known_wheels_are_found_without_noise(
    tmp_path_factory: pytest.TempPathFactory, left: float, right: float, tread: float
) -> None:
    folder = tmp_path_factory.mktemp("drive") / "tour"
    fit = fit_wheels([drive(folder, TOUR, Truth(left=left, right=right, tread=tread))])
    assert fit.determined == (True, True, True)
    assert relative(fit.wheels) == pytest.approx([left, right, tread], rel=1e-3)


def test_wheel_speeds_serve_as_well_as_counts(tmp_path: Path) -> None:
    fit = fit_wheels([drive(tmp_path / "a", TOUR, TRUTH, as_speeds=True)])
    assert relative(fit.wheels) == pytest.approx([1.006, 0.995, 1.04], rel=1e-3)


def test_delay_and_lever_arm_of_the_reference_are_found_and_do_no_harm(tmp_path: Path) -> None:
    mounted = replace(TRUTH, time_s=-0.2, forward_m=0.03, left_m=-0.02)
    fit = fit_wheels([drive(tmp_path / "a", TOUR, mounted)])
    assert relative(fit.wheels) == pytest.approx([1.006, 0.995, 1.04], rel=1e-3)
    assert fit.mounting.time_s == pytest.approx(-0.2, abs=0.005)
    assert (fit.mounting.forward_m, fit.mounting.left_m) == pytest.approx((0.03, -0.02), abs=0.002)


def test_jumps_of_the_reference_do_little_harm(tmp_path: Path) -> None:
    quiet = replace(TRUTH, position_sigma_m=0.005, heading_sigma_rad=0.003)
    fit = fit_wheels([drive(tmp_path / "a", TOUR, quiet, jumps=20)])
    assert relative(fit.wheels) == pytest.approx([1.006, 0.995, 1.04], rel=0.01)


def test_start_and_end_alone_are_a_reference_too(tmp_path: Path) -> None:
    sparse = [drive(tmp_path / f"{k}", TOUR[: 5 + k], TRUTH, k, every=10_000 if k % 2 else 100) for k in range(8)]
    fit = fit_wheels(sparse)
    assert relative(fit.wheels) == pytest.approx([1.006, 0.995, 1.04], rel=0.01)


@pytest.mark.parametrize("seconds", [10, 20])
@pytest.mark.parametrize("tread", [0.6, 1.65])
def test_turns_between_sparse_rows_are_counted_by_the_tread_that_leaves_least(
    tmp_path: Path, tread: float, seconds: int
) -> None:
    """Counted by the nominal tread, one of 1.65 times as much has turned about as often again, or not at all."""
    far = replace(NOISY, tread=tread)
    drives = [drive(tmp_path / f"{k}", SPINNING, far, k, every=20 * seconds) for k in range(2)]
    fit = fit_wheels(with_turns(drives))
    assert fit.wheels.tread_m / TREAD_M == pytest.approx(tread, rel=0.02)
    assert max(fit.white_rad) < 0.1


def test_headings_that_no_wheels_explain_determine_nothing(tmp_path: Path) -> None:
    made = drive(tmp_path / "a", TOUR, NOISY, every=100)
    any_way = np.random.default_rng(1).uniform(-math.pi, math.pi, len(made.reference_s))
    lost = [replace(made, reference_heading_rad=np.unwrap(any_way))]
    fit = fit_wheels(with_turns(lost))
    assert fit.determined == (False, False, False)
    (told,) = not_determined(fit, lost)
    assert "no values explain the reference" in told


def test_sigmas_cover_the_truth_over_many_drives(tmp_path: Path) -> None:
    z = []
    for seed in range(24):
        pair = [drive(tmp_path / f"{seed}-{k}", TOUR, NOISY, 2 * seed + k, every=10) for k in (0, 1)]
        fit = fit_wheels(pair)
        errors = np.subtract(relative(fit.wheels), [1.006, 0.995, 1.04])
        z.append(errors / (np.array(fit.sigma) * relative(fit.wheels)))
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    # 24 drives: the rms of a true z lies in 0.6 to 1.4 with 99 %; being a little too modest is allowed.
    assert np.all(rms < 1.4)
    assert np.all(rms > 0.3)


def test_sigmas_cover_the_truth_where_few_windows_slip_more_than_stated(tmp_path: Path) -> None:
    z = []
    slippery = replace(NOISY, slip_m_per_sqrt_m=0.01)
    for seed in range(40):
        made = replace(drive(tmp_path / f"{seed}", TOUR[:7], slippery, seed), slip_m_per_sqrt_m=0.001)
        fit = fit_wheels([made], limit=np.full(3, np.inf))
        errors = np.subtract(relative(fit.wheels), [1.006, 0.995, 1.04])
        z.append(errors / (np.array(fit.sigma) * relative(fit.wheels)))
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all(rms < 1.5)
    assert np.all(rms > 0.6)


def test_a_straight_drive_cannot_tell_the_tread_and_says_so(tmp_path: Path) -> None:
    drives = [drive(tmp_path / "a", STRAIGHT, NOISY)]
    fit = fit_wheels(drives)
    assert fit.determined == (True, True, False)
    assert fit.wheels.tread_m == TREAD_M
    assert "tread: not determined, the recordings hardly turn" in not_determined(fit, drives)[0]


def test_a_spin_tells_only_tread_over_radius_and_says_so(tmp_path: Path) -> None:
    drives = [drive(tmp_path / "a", SPIN, NOISY)]
    fit = fit_wheels(drives)
    assert fit.determined == (False, False, True)
    assert fit.wheels.left_radius_m == fit.wheels.right_radius_m == RADIUS_M
    # The true turn is smaller by radius / tread.
    assert fit.wheels.tread_m / TREAD_M == pytest.approx(1.04 / 1.0005, rel=0.01)
    said = "\n".join(not_determined(fit, drives))
    assert "mean radius: not determined" in said
    assert "hardly go anywhere" in said
    assert "only tread / radius was measured" in said


def test_turning_to_one_side_only_is_warned_of(tmp_path: Path) -> None:
    one = [drive(tmp_path / "a", CIRCLE, NOISY)]
    both = [*one, drive(tmp_path / "b", tuple((v, -w, t) for v, w, t in CIRCLE), NOISY, 1)]
    assert any("turn to one side" in text for text in warnings(fit_wheels(one), one))
    assert not any("turn to one side" in text for text in warnings(fit_wheels(both), both))


def test_held_out_errors_fall_where_the_wheels_are_the_same(tmp_path: Path) -> None:
    drives = [drive(tmp_path / f"{k}", TOUR, NOISY, k) for k in range(3)]
    fit = fit_wheels(drives)
    figures = leave_one_out(drives, fit)
    assert [figure.drive.name for figure in figures] == ["0", "1", "2"]
    assert all(figure.calibrated.rms_m < 0.3 * figure.nominal.rms_m for figure in figures)
    assert not held_out_warnings(fit, drives, fit_wheels(drives[1:]), drives[1:], figures)


def test_a_single_recording_is_tested_on_its_parts(tmp_path: Path) -> None:
    drives = [drive(tmp_path / "a", TOUR, NOISY)]
    figures = leave_one_out(drives, fit_wheels(drives))
    assert [figure.drive.name for figure in figures] == [f"a, part {k} of 5" for k in range(1, 6)]


def test_another_tread_in_the_held_out_recordings_is_told(tmp_path: Path) -> None:
    fitted = [drive(tmp_path / f"a{k}", TOUR, NOISY, k) for k in range(2)]
    tests = [drive(tmp_path / f"b{k}", TOUR, replace(NOISY, tread=1.15), 9 + k) for k in range(2)]
    fit = fit_wheels(fitted)
    said = held_out_warnings(fit, fitted, fit_wheels(tests), tests, [compare(t, fit) for t in tests])
    assert any("give a different tread" in text for text in said)


def test_a_calibration_that_makes_it_worse_is_not_recommended(tmp_path: Path) -> None:
    fit = fit_wheels([drive(tmp_path / "a", TOUR, NOISY)])
    tests = [drive(tmp_path / "b", TOUR, Truth())]
    said = held_out_warnings(fit, [], None, tests, [compare(t, fit) for t in tests])
    assert any("Do not use it" in text for text in said)


def test_different_robots_are_refused(tmp_path: Path) -> None:
    drives = [drive(tmp_path / "a", TOUR, TRUTH), drive(tmp_path / "b", TOUR, TRUTH, tread_m=0.6)]
    with pytest.raises(ConfigError, match=r"b: robot.yaml: expected the same robot as in a .*tread 0.6"):
        fit_wheels(drives)
    drives[1] = drive(tmp_path / "c", TOUR, TRUTH, as_speeds=True)
    with pytest.raises(ConfigError, match=r"4000 counts a turn\), got another one .*wheel speeds"):
        fit_wheels(drives)


def test_a_robot_that_stands_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected wheels that move"):
        drive(tmp_path / "a", ((0.0, 0.0, 20.0),), TRUTH)


def test_odometry_of_a_circle_is_exact(tmp_path: Path) -> None:
    made = drive(tmp_path / "a", ((0.4, 0.4, 10.0),), Truth())
    xy_m, heading = odometry(made, made.nominal, made.time_s)
    assert xy_m[-1] == pytest.approx([np.sin(heading[-1]), 1.0 - np.cos(heading[-1])], abs=1e-3)  # radius 1 m; counts
    assert heading[-1] == pytest.approx(4.0, abs=1e-3)


def test_a_missing_reference_is_a_clear_error(tmp_path: Path) -> None:
    folder = write_drive(tmp_path / "a", TOUR, TRUTH)
    (folder / "reference.csv").unlink()
    with pytest.raises(ConfigError, match=r"reference.csv: expected this file"):
        make_drive(read_recording(folder))


def test_a_reference_at_another_time_is_a_clear_error(tmp_path: Path) -> None:
    folder = write_drive(tmp_path / "a", TOUR, TRUTH)
    (folder / "reference.csv").write_text("time_s,x_m,y_m,heading_deg\n5000,0,0,0\n5001,0,0,0\n")
    with pytest.raises(ConfigError, match="two rows or more within the encoders' time"):
        make_drive(read_recording(folder))


def test_what_is_held_at_its_nominal_is_part_of_the_others_sigma(tmp_path: Path) -> None:
    # One circle: the tread found is for the nominal radii, and those are off.
    errors = []
    for seed in range(6):
        fit = fit_wheels([drive(tmp_path / f"{seed}", CIRCLE, NOISY, seed)])
        assert fit.determined == (False, False, True)
        errors.append(abs(fit.wheels.tread_m / (1.04 * TREAD_M) - 1.0) / fit.sigma[2])
    assert max(errors) < 3.0


def test_headings_that_are_off_by_any_number_of_turns_have_weights_all_the_same(tmp_path: Path) -> None:
    part = new_part(drive(tmp_path / "a", TOUR, TRUTH))
    part.reweigh(np.tile([0.1, 0.1, 1e200], (len(part.weights), 1)))
    assert part.white_rad == math.pi
    assert np.isfinite(part.weights).all()
    assert (part.weights >= 0.0).all()
