"""`drd simulate --world mujoco` as it is used, and the sensors. MuJoCo is an optional extra."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from drd.cli import main as drd

pytest.importorskip("mujoco", reason="the extra drd[mujoco] is not installed")

from drd_tools.mujoco_world.ground import Ground
from drd_tools.mujoco_world.sensors import COUNTS_PER_REVOLUTION, Readings, read_sensors
from drd_tools.mujoco_world.vehicle import Vehicle
from drd_tools.mujoco_world.world import Motion, drive
from drd_tools.recordings.folder import read_recording
from drd_tools.replay.command import main as replay
from drd_tools.simulate.conditions import Reference

FILES = ("robot.yaml", "fog.csv", "encoders.csv", "reference.csv", "truth.yaml", "truth.csv")


@pytest.fixture(scope="module")
def motion() -> Motion:
    return drive(Vehicle(), Ground(), "spins", 40.0, 10.0, seed=0)


@pytest.fixture(scope="module")
def readings(motion: Motion) -> Readings:
    return read_sensors(motion, Reference(), 5)


def test_it_writes_a_recording_that_replays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    argv = ["--world", "mujoco", "--mission", "square-ccw", "--seconds", "40", "--seed", "3", "--output"]
    assert drd(["simulate", *argv, str(run)]) == 0
    text = capsys.readouterr().out
    assert "bend left" in text
    assert "straight" in text
    assert (run / "emerged.png").read_bytes()[:4] == b"\x89PNG"
    recording = read_recording(run)
    assert recording.fog is not None
    assert recording.reference is not None
    assert len(recording.fog.time_s) == 400
    assert len(recording.encoders.time_s) == 801
    truth = yaml.safe_load((run / "truth.yaml").read_text())
    treads = [m["tread_m"] for m in truth["manoeuvres"] if m["kind"] == "bend left"]
    assert all(1.5 < tread / recording.nominal.tread_m < 2.2 for tread in treads)
    assert replay([str(run), "--output", str(tmp_path / "poses.csv")]) == 0
    assert json.loads((tmp_path / "poses.json").read_text())
    again = tmp_path / "again" / "run"
    assert drd(["simulate", *argv, str(again)]) == 0
    for name in FILES:
        assert (again / name).read_bytes() == (run / name).read_bytes()


def test_no_reference_is_none_and_no_other_recording_is_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    argv = ["--world", "mujoco", "--mission", "spins", "--seconds", "12", "--reference"]
    assert drd(["simulate", *argv, "ends", "--output", str(run)]) == 0
    assert len((run / "reference.csv").read_text().splitlines()) == 3
    assert drd(["simulate", *argv, "none", "--output", str(run)]) == 0
    assert "nothing" in capsys.readouterr().out
    assert read_recording(run).reference is None
    (run / "truth.yaml").unlink()
    assert drd(["simulate", *argv, "none", "--output", str(run)]) == 2
    assert "another recording" in capsys.readouterr().err
    assert drd(["simulate", *argv, "none", "--output", str(run / "robot.yaml")]) == 2
    assert capsys.readouterr().err.startswith("drd simulate: ")


def test_the_gyro_gives_the_mean_over_its_interval(motion: Motion, readings: Readings) -> None:
    fog = readings.recording.fog
    assert fog is not None
    assert fog.temperature_c is not None
    assert fog.time_s[0] == pytest.approx(0.1)
    turned_deg = np.diff(np.degrees(motion.gyro_rad[::10]))
    error_deg_s = np.degrees(fog.rate_rad_s) - turned_deg / 0.1 - readings.bias_deg_s
    # Angle random walk of 0.0833 deg/sqrt(h) over 0.1 s; what the bias does beside it is a hundred times less.
    assert error_deg_s.std() == pytest.approx(0.0833 / 60.0 / np.sqrt(0.1), rel=0.2)
    assert abs(error_deg_s.mean()) < 0.002
    assert np.all(np.diff(fog.temperature_c) >= 0.0)


def test_counts_are_whole_and_never_more_than_one_off(motion: Motion, readings: Readings) -> None:
    log = readings.recording.encoders
    for counts, angle in ((log.left_counts, motion.left_rad), (log.right_counts, motion.right_rad)):
        assert counts is not None
        exact = angle[::5] * COUNTS_PER_REVOLUTION / (2.0 * np.pi)
        assert np.all(counts == np.round(counts))
        assert np.all(np.abs(counts - exact) <= 1.0)


def test_the_reference_is_the_true_pose_with_its_noise(motion: Motion) -> None:
    found = [read_sensors(motion, Reference(period_s=period_s), 5).recording.reference for period_s in (0.1, 5.0, None)]
    full, sparse, ends = (log for log in found if log is not None)
    assert (len(full.time_s), len(sparse.time_s), len(ends.time_s)) == (401, 9, 2)
    assert (full.x_m - motion.x_m[::10]).std() == pytest.approx(0.01, rel=0.2)
    assert np.degrees(full.heading_rad - motion.heading_rad[::10]).std() == pytest.approx(0.15, rel=0.2)
    np.testing.assert_allclose(sparse.time_s, full.time_s[::50])
    assert np.abs(sparse.x_m - full.x_m[::50]).max() < 0.1
    assert read_sensors(motion, Reference(is_there=False), 5).recording.reference is None


def test_another_seed_is_other_noise_on_the_same_drive(motion: Motion, readings: Readings) -> None:
    other = read_sensors(motion, Reference(), 6)
    assert other.bias_deg_s != readings.bias_deg_s
    assert other.recording.fog is not None
    assert readings.recording.fog is not None
    assert np.any(other.recording.fog.rate_rad_s != readings.recording.fog.rate_rad_s)
