"""A gyro that drifts by half a turn: the path is found, the noise stays that of the sensors, the cause is named."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import problem, recorded, selected, truth
from hypothesis import given
from hypothesis import strategies as st

from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.error_model.nominal_path import SLOWLY_RAD, _unwrapped
from drd_tools.diagnose.regression.noise_fit import fitted
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.results import Status
from drd_tools.recordings.folder import read_recording

SHARED = Path(__file__).parents[4] / "shared" / "recordings"
DRIVE = ("slalom", 400.0)
VIBRATION = selected("gyro_vibration_bias", k=np.radians(0.5))  # turns 230 deg too far in this drive


@cache
def drifting() -> Problem:
    return problem(DRIVE, 6, VIBRATION)


@given(
    st.lists(st.floats(-0.9 * SLOWLY_RAD, 0.9 * SLOWLY_RAD), min_size=1, max_size=200),
    st.floats(-1.0, 1.0),
    st.lists(st.integers(-3, 3), min_size=200, max_size=200),
)
def test_a_drift_is_followed_through_any_number_of_turns(steps: list[float], start: float, turns: list[int]) -> None:
    drift = start + np.cumsum([0.0, *steps[1:]])
    wrapped = drift + 2.0 * np.pi * np.array(turns[: len(drift)])
    np.testing.assert_allclose(_unwrapped(wrapped), drift, atol=1e-9)


@pytest.mark.parametrize("wrong", [[3.1], [3.0, -3.0], [2.0, -2.5, 3.1, -3.1, 1.2, -2.9]])
def test_wrong_headings_add_no_turn(wrong: list[float]) -> None:
    off = np.concatenate([np.full(20, 0.1), wrong, np.full(20, 0.1)])
    np.testing.assert_allclose(_unwrapped(off)[-20:], 0.1)
    np.testing.assert_allclose(_unwrapped(np.zeros(0)), np.zeros(0))


def test_the_first_path_is_near_the_truth_although_the_gyro_turns_too_far() -> None:
    p, t = drifting(), truth(*DRIVE)
    edges_s, pose = p.evidence.edges_s, p.path.pose
    true = np.column_stack([np.interp(edges_s, t.time_s, v) for v in (t.x_m, t.y_m, t.heading_rad)])
    assert p.evidence.gyro_rad is not None
    assert abs(p.evidence.gyro_rad.sum() - (true[-1, 2] - true[0, 2])) > np.pi
    assert np.abs(pose - true)[:, :2].max() < 0.1
    assert np.abs(pose - true)[:, 2].max() < 0.05


def test_noise_that_an_effect_has_made_goes_with_it() -> None:
    p = drifting()
    noise, inflation = fitted(p, refine(p, []), searched=True)
    assert inflation.mean() > 2.0
    p = p.with_noise(noise, inflation, p.inflation).around([VIBRATION])
    noise, inflation = fitted(p, refine(p, [VIBRATION]), searched=True)
    assert inflation.mean() < 1.05
    assert noise.position_m == pytest.approx(p.evidence.datasheet.position_m, rel=0.05)
    assert noise.heading_rad == pytest.approx(p.evidence.datasheet.heading_rad, rel=0.05)


def test_a_cause_that_turns_the_gyro_too_far_has_its_name_and_size() -> None:
    """Another name may take the small share that it leaves."""
    cause = max(analyse(recorded(DRIVE, 6, VIBRATION)).conclusion.causes, key=lambda c: c.explains)
    assert cause.selected is not None
    assert cause.selected.id == VIBRATION.id
    assert cause.selected.number("k") == pytest.approx(VIBRATION.number("k"), rel=0.05)


@pytest.mark.recordings
@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not there")
def test_three_causes_that_turn_the_gyro_of_a_real_drive_too_far_are_all_found() -> None:
    whole = read_recording(SHARED / "warthog_grass_2024_8_8_15h56s39")
    fog, log = whole.fog, whole.wheels
    assert fog is not None
    assert log is not None
    assert log.left_rad_s is not None
    assert log.right_rad_s is not None
    rate, since_s = fog.rate_rad_s, fog.time_s - fog.time_s[0]
    speed = np.interp(fog.time_s, log.time_s, 0.5 * whole.nominal.wheel_radius_m * (log.left_rad_s + log.right_rad_s))
    planted = np.radians(0.655 * speed**2 + 1.573 * np.exp(-since_s / 69.4)) + 0.057 * np.abs(rate)
    causes = analyse(replace(whole, fog=replace(fog, rate_rad_s=rate + planted))).conclusion.causes
    found = {c.effect: c.selected for c in causes if c.status is Status.CONFIRMED and c.selected is not None}
    assert found["gyro_scale_asymmetry"].number("k") == pytest.approx(0.057, abs=0.006)
    # The wheels are 4.5 % smaller than stated, and the robot so much slower.
    assert np.degrees(found["gyro_vibration_bias"].number("k")) == pytest.approx(0.655 * 1.045**2, abs=0.08)
    assert np.degrees(found["gyro_warmup"].number("b")) == pytest.approx(1.573, abs=0.2)
