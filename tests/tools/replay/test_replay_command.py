"""`drd replay` as a user calls it: summary, files, options, and what is refused."""

import json
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from replay_folders import long_drive, short_drive

from drd.cli import main
from drd_tools.recordings.folder import ESTIMATES, read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.result import Replayed

MCAP = "drd_tools.replay.mcap_source"


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return short_drive(tmp_path_factory.mktemp("short")).folder


def test_poses_and_their_origin_are_written(short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "poses.csv"
    assert main(["replay", str(short), "--output", str(output)]) == 0
    printed = capsys.readouterr().out
    lines = output.read_text().splitlines()
    assert lines[0].split(",") == list(ESTIMATES)
    assert lines[0].startswith("time_s,x_m,y_m,heading_deg,")
    rows = np.loadtxt(output, delimiter=",", skiprows=1)
    assert rows[0].tolist() == [0.0] * len(ESTIMATES)
    reference = np.loadtxt(short / "reference.csv", delimiter=",", skiprows=1)
    assert rows[:, 0] == pytest.approx(reference[:, 0])
    # What is written has 1e-6 m and deg; the encoders' counts are 0.16 mm.
    assert rows[:, 1:3] == pytest.approx(reference[:, 1:3], abs=1e-3)
    assert rows[:, 3] == pytest.approx(np.degrees(np.unwrap(np.radians(reference[:, 3]))), abs=0.1)
    origin = json.loads((tmp_path / "poses.json").read_text())
    assert origin["digest"] in printed
    assert origin["digest"] == replay_folder(read_recording(short)).digest()
    assert origin["poses"] == len(rows) - 1
    assert origin["sha256"] == read_recording(short).sha256
    assert origin["config"]["robot"]["tread_m"] == 0.5
    assert origin["start"] == {"x_m": 0.0, "y_m": 0.0, "heading_deg": 0.0}
    assert f"wrote {output}" in printed
    assert "end error 0.00" in printed


def test_the_start_moves_the_poses_but_not_their_digest(short: Path, tmp_path: Path) -> None:
    digests = []
    for name, start in (("a", "0,0,0"), ("b", "-1.5,2,90")):
        assert main(["replay", str(short), f"--start={start}", "--output", str(tmp_path / f"{name}.csv")]) == 0
        digests.append(json.loads((tmp_path / f"{name}.json").read_text())["digest"])
    a, b = (np.loadtxt(tmp_path / f"{name}.csv", delimiter=",", skiprows=1) for name in "ab")
    assert digests[0] == digests[1]
    assert b[0, 1:4].tolist() == [-1.5, 2.0, 90.0]
    assert b[:, 1] == pytest.approx(-1.5 - a[:, 2], abs=2e-6)
    assert b[:, 2] == pytest.approx(2.0 + a[:, 1], abs=2e-6)


def test_poses_after_a_gap_of_the_wheels_can_be_evaluated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = short_drive(tmp_path).folder
    lines = (folder / "encoders.csv").read_text().splitlines(keepends=True)
    cut = [line for line in lines if not line[0].isdigit() or not 2.0 < float(line.split(",")[0]) < 2.399]
    assert len(cut) < len(lines)
    (folder / "encoders.csv").write_text("".join(cut))
    poses = tmp_path / "poses.csv"
    assert main(["replay", str(folder), "--output", str(poses)]) == 0
    arguments = ["evaluate", str(poses), "--reference", str(folder), "--output", str(tmp_path / "out")]
    assert main(arguments) == 0, capsys.readouterr().err


def test_a_reference_that_does_not_move_gives_no_per_cent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = short_drive(tmp_path).folder
    (folder / "reference.csv").write_text("time_s,x_m,y_m,heading_deg\n0,1,2,0\n4,1,2,0\n")
    assert main(["replay", str(folder)]) == 0
    said = next(line for line in capsys.readouterr().out.splitlines() if "end error" in line)
    assert "m, heading" in said
    assert "%" not in said


def test_options_change_the_result_and_are_kept(short: Path, tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    model.write_text("tread_m: 0.6\n")
    output = tmp_path / "poses.csv"
    assert main(["replay", str(short), "--model", str(model), "--output", str(output)]) == 0
    origin = json.loads((tmp_path / "poses.json").read_text())
    assert origin["options"] == {"model": str(model)}
    assert origin["config"]["robot"]["tread_m"] == 0.6
    assert origin["digest"] != replay_folder(read_recording(short)).digest()


def test_many_disagreements_are_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = long_drive(tmp_path).folder
    model = tmp_path / "model.yaml"
    model.write_text("tread_m: 0.2\n")
    config = tmp_path / "config.yaml"  # else another tread is what a skid-steer robot has
    config.write_text("robot: {drive: differential}\n")
    assert main(["replay", str(folder), "--model", str(model), "--config", str(config)]) == 0
    assert "comparisons wheels and gyro disagree" in capsys.readouterr().out
    assert main(["replay", str(folder)]) == 0
    assert "disagree by more" not in capsys.readouterr().out


def test_a_recording_without_usable_wheel_motion_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tmp_path.joinpath("robot.yaml").write_text(
        "wheel: {radius_m: 0.1, counts_per_revolution: 1000}\ntread_m: 0.5\nencoders: {rate_hz: 20}\n"
    )
    tmp_path.joinpath("encoders.csv").write_text("time_s,left_counts,right_counts\n0,0,0\n5,0,0\n10,9,9\n")
    assert main(["replay", str(tmp_path)]) == 1
    assert "no pose" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--output", "poses.txt"], "expected a file name that ends with .csv"),
        (["--output", "nowhere/poses.csv"], "expected a file in a folder that exists"),
        (["--output", "{folder}/encoders.csv"], "expected a file that is not the recording's own"),
        (["--config", "nowhere.yaml"], "nowhere.yaml: expected a readable UTF-8 text file"),
        (["--calibration", "nowhere.yaml"], "nowhere.yaml: calibration.file: expected a readable YAML file"),
        (["--model", "nowhere.yaml"], "nowhere.yaml: model.file: expected a readable YAML file"),
    ],
)
def test_what_cannot_be_used_is_said_in_one_line(
    short: Path, arguments: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (short / "encoders.csv").read_bytes()
    assert main(["replay", str(short), *(a.format(folder=short) for a in arguments)]) == 2
    printed = capsys.readouterr()
    assert expected in printed.err
    assert printed.err.count("\n") == 1
    assert not printed.out
    assert (short / "encoders.csv").read_bytes() == before


@pytest.mark.parametrize("start", ["1,2", "1,2,x", "1,2,inf", "origin", "1,2,3,4"])
def test_a_start_that_is_no_pose_is_refused(short: Path, start: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["replay", str(short), f"--start={start}"])
    assert "expected x_m,y_m,heading_deg or reference" in capsys.readouterr().err


def test_a_start_on_a_reference_needs_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = short_drive(tmp_path).folder
    assert main(["replay", str(folder), "--start", "reference"]) == 0
    (folder / "reference.csv").unlink()
    assert main(["replay", str(folder), "--start", "reference"]) == 2
    assert "reference.csv: expected a reference" in capsys.readouterr().err


def test_neither_folder_nor_mcap_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(tmp_path / "none")]) == 2
    assert "expected a recording folder, got nothing there" in capsys.readouterr().err


def test_the_monitor_is_asked_only_where_it_is_wanted(
    short: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for options, text in (([], ""), (["--monitor"], "monitor: nothing is found")):
        assert main(["replay", str(short), *options]) == 0
        printed = capsys.readouterr().out
        assert text in printed
        assert ("monitor:" in printed) == bool(text)
    monkeypatch.setattr("drd_tools.replay.folder_source.findings.monitored", pytest.fail)
    assert main(["replay", str(short)]) == 0


def test_an_mcap_file_goes_to_its_own_source(
    short: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    called: list[Any] = []

    def replay_mcap(file: Path, *, monitors: bool, **given: Path | None) -> Replayed:
        called.append((file, *given.values(), monitors))
        return replay_folder(read_recording(short))

    monkeypatch.setitem(sys.modules, MCAP, types.SimpleNamespace(replay_mcap=replay_mcap))
    assert main(["replay", "run.mcap", "--config", "a.yaml", "--calibration", "b.yaml", "--model", "c.yaml"]) == 0
    assert main(["replay", "run.mcap", "--monitor"]) == 0
    files = Path("run.mcap"), Path("a.yaml"), Path("b.yaml"), Path("c.yaml")
    assert called == [(*files, False), (files[0], None, None, None, True)]
    assert "digest" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="2"):
        main(["replay", "run.mcap", "--start", "reference"])
