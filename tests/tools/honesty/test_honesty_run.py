"""Drives as `make honesty` judges them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from replay_folders import long_drive

from drd.config.keys import Config
from drd.effects.catalogue import catalogue
from drd_tools.honesty.baselines import BASELINES
from drd_tools.honesty.configurations import CALIBRATED, DEFAULT, PAPER, STATED, as_simulated, estimated
from drd_tools.honesty.drives import FOLDS, ROBOTS, SHARED, drives_of, judge_fold
from drd_tools.honesty.run import run
from drd_tools.honesty.scenarios import MISSIONS, SCENARIOS, prior, simulation
from drd_tools.honesty.simulated import judge_seed
from drd_tools.honesty.table import text_of
from drd_tools.replay.nominal import configuration
from drd_tools.simulate.conditions import stream
from drd_tools.simulate.robot import DEFAULT as ROBOT


def test_the_prior_is_that_of_the_configuration() -> None:
    robots = [prior(ROBOT, stream(seed, "test")) for seed in range(400)]

    def sigma(effect: str, name: str) -> float:
        return float(np.std([float(robot[effect][name]) for robot in robots]))

    assert sigma("wheel_radius_error", "left") == pytest.approx(0.005, rel=0.15)
    assert sigma("tread_error", "k") == pytest.approx(0.02, rel=0.15)
    assert sigma("gyro_scale_error", "k") == pytest.approx(0.005, rel=0.15)
    lags = [float(r["encoder_latency"]["delay"]) - float(r["gyro_latency"]["delay"]) for r in robots]
    assert np.std(lags) == pytest.approx(as_simulated(stated("plain")).estimation.initial.wheel_lag_s, rel=0.15)
    assert abs(np.mean(lags)) < 0.01


def stated(name: str) -> Config:
    return configuration(simulation(name, 0).recording)


@pytest.mark.parametrize("name", SCENARIOS)
def test_effects_are_in_the_catalogue_with_these_parameters(name: str) -> None:
    drawn = SCENARIOS[name].draw(stream(1, name))
    for effect, values in drawn.items():
        assert values.keys() <= {p.name for p in catalogue()[effect].parameters}


def test_a_seed_is_the_same_again_and_another_drive_of_it_is_the_same_robot() -> None:
    first, again, other = (simulation("plain", 3, number) for number in (None, None, 0))
    assert np.array_equal(first.recording.encoders.time_s, again.recording.encoders.time_s)
    assert first.recording.fog is not None
    assert again.recording.fog is not None
    assert np.array_equal(first.recording.fog.rate_rad_s, again.recording.fog.rate_rad_s)
    assert (first.mission, other.mission) == (MISSIONS[3], MISSIONS[0])


def test_the_gyro_is_louder_than_robot_yaml_says() -> None:
    def noise(name: str) -> float:
        fog = simulation(name, 0).recording.fog
        assert fog is not None
        return float(np.std(fog.rate_rad_s[:90]))  # it stands for 10 s

    assert noise("gyro noise x 3") / noise("plain") == pytest.approx(3.0, rel=0.3)
    assert simulation("gyro noise x 3", 0).recording.nominal == ROBOT


def test_a_simulated_drive_has_all_configurations_and_the_nees_of_two() -> None:
    judged = judge_seed("plain", 1)
    assert {DEFAULT, CALIBRATED, PAPER, *BASELINES} <= judged.figures.keys()
    assert judged.nees.keys() == {DEFAULT, STATED}
    assert judged.figures[DEFAULT].position_rms_m < 2.0
    assert 0.0 < judged.nees[STATED] < 100.0
    assert CALIBRATED not in judge_seed("radii, tread", 1, beside=0).figures


def test_poses_and_validity_belong_together_where_the_wheels_were_silent(tmp_path: Path) -> None:
    """The first sample after a silence corrects the pose before it: two poses for one time, of which one counts."""
    recording = long_drive(tmp_path)
    log, keep = recording.encoders, np.ones(len(recording.encoders.time_s), bool)
    for at_s in (20.0, 25.0, 30.0):
        keep &= ~((log.time_s > at_s) & (log.time_s < at_s + 0.95))
    columns = {name: values[keep] for name, values in vars(log).items() if values is not None}
    found = estimated(replace(recording, wheels=replace(log, **columns)))
    assert found.is_valid is not None
    assert len(found.is_valid) == len(found.poses.time_s)
    assert not found.is_valid[np.searchsorted(found.poses.time_s, 20.9)]
    assert found.is_valid[np.searchsorted(found.poses.time_s, 24.0)]


def test_in_contact_physics_there_is_no_calibration() -> None:
    pytest.importorskip("mujoco")
    judged = judge_seed("mujoco", 3)
    assert {DEFAULT, PAPER, *BASELINES} <= judged.figures.keys()
    assert judged.nees.keys() == {DEFAULT}


def test_without_recordings_their_rows_are_left_out_and_that_is_said(tmp_path: Path) -> None:
    assert not any(drives_of(robot, tmp_path) for robot in ROBOTS)
    assert judge_fold("warthog", 0, tmp_path) == []


@pytest.mark.recordings
def test_the_short_form_judges_every_warthog_drive_with_wheels_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    if not drives_of("warthog"):
        pytest.skip("no shared recordings")
    few = {name: SCENARIOS[name] for name in ("plain", "radii, tread")}  # `make honesty` has all
    monkeypatch.setattr("drd_tools.honesty.run.SCENARIOS", few)
    found = run(1, short=True, jobs=1)
    real = found.groups("real")
    assert {folder.name for folder in drives_of("warthog")} <= real.keys()
    assert {"optiodom_circular", "optiodom_square", "optiodom_ivanjko"} <= real.keys()
    assert sum(map(len, real.values())) == len(drives_of("warthog")) + len(drives_of("optiodom")[::FOLDS])
    for drives in real.values():
        for one in drives:
            assert {DEFAULT, CALIBRATED, PAPER} <= one.figures.keys()
    assert found.groups("simulated").keys() >= few.keys()
    assert SHARED.name in text_of(found) or not found.notes
