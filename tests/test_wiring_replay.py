"""A replay's summary tells a wiring fault, and nothing where there is none."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from recorded_drive import drive, recordings
from replay_folders import long_drive

from drd.cli import main
from drd_tools.recordings.folder import read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.mcap_source import replay_mcap

SHARED = Path(__file__).resolve().parents[2] / "shared"
REAL = sorted(folder.parent for name in ("recordings", "trials") for folder in SHARED.glob(f"{name}/*/robot.yaml"))


def invert_gyro(folder: Path) -> None:
    file = folder / "fog.csv"
    header = file.read_text().splitlines()[0]
    rows = np.loadtxt(file, delimiter=",", skiprows=1)
    rows[:, 1] *= -1.0
    np.savetxt(file, rows, "%.12g", ",", header=header, comments="")


def test_a_folder_with_an_inverted_gyro_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = long_drive(tmp_path).folder
    assert main(["replay", str(folder)]) == 0
    assert "wiring" not in capsys.readouterr().out
    invert_gyro(folder)
    assert main(["replay", str(folder)]) == 0
    assert "wiring: directions: gyro and wheels turn in opposite directions" in capsys.readouterr().out


def test_a_recording_of_the_daemon_is_judged_with_the_configuration_in_force(tmp_path: Path) -> None:
    recorded = drive(tmp_path)
    recorded.start()
    recorded.run(20.0)
    assert recorded.recorder.close(10.0)
    (file,) = recordings(tmp_path)
    assert [note for note in replay_mcap(file).notes if "wiring" in note] == []
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text((tmp_path / "robot.yaml").read_text().replace("ecore,", "ecore, positive: counterclockwise,"))
    (note,) = [note for note in replay_mcap(file, config=wrong).notes if "wiring" in note]
    assert "opposite directions" in note


@pytest.mark.recordings
@pytest.mark.skipif(not REAL, reason="no shared recordings")
@pytest.mark.parametrize("folder", REAL[::9], ids=lambda folder: folder.name)
def test_real_robots_are_not_accused(folder: Path) -> None:
    assert [note for note in replay_folder(read_recording(folder)).notes if "wiring" in note] == []


@pytest.mark.recordings
@pytest.mark.skipif(not (SHARED / "recordings").is_dir(), reason="no shared recordings")
def test_a_real_robot_with_an_inverted_gyro_is(tmp_path: Path) -> None:
    source = min(SHARED.glob("recordings/warthog_*"))
    folder = Path(shutil.copytree(source, tmp_path / "copy", copy_function=shutil.copyfile))
    folder.chmod(0o755)
    invert_gyro(folder)
    (note,) = [note for note in replay_folder(read_recording(folder)).notes if "wiring" in note]
    assert "opposite directions" in note
