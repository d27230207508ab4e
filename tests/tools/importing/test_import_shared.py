"""Real recordings as their authors left them: a Husky's bag, whose gyro lies on its side, and a KVH 1750's logs."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from drd_tools.importing.command import main
from drd_tools.recordings.folder import read_recording
from drd_tools.replay.folder_source import replay_folder

pytestmark = pytest.mark.recordings

RAW = Path(__file__).resolve().parents[3].parent / "shared/recordings/raw"


@pytest.fixture(autouse=True)
def _here() -> None:
    if not RAW.is_dir():
        pytest.skip("the shared recordings are not here")


def test_the_bag_s_vertical_axis_is_y(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--gyro", "/imu/data", "--wheels", "/husky_velocity_controller/odom", "--axis", "auto", "--sign", "auto"]
    robot = [
        "--wheel-radius",
        "0.165",
        "--tread",
        "0.555",
        "--shift-wheels",
        "auto",
        "--output",
        str(tmp_path / "husky"),
    ]
    assert main([str(RAW / "test1.bag"), *words, *robot]) == 0
    assert "the vertical axis is y" in capsys.readouterr().out
    said = yaml.safe_load((tmp_path / "husky/import.yaml").read_text())
    assert (said["applied"]["axis"], said["applied"]["sign"]) == ("y", "+")
    # The drive's speeds pass a filter; its header stamps are those of sending.
    assert said["applied"]["shift_wheels_s"] == pytest.approx(-0.355, abs=0.03)
    recording = read_recording(tmp_path / "husky")
    left, right = recording.wheel_angles_rad()
    # The odometry's own last heading: -3.4627 rad after its first.
    assert 0.165 * (right[-1] - left[-1]) / 0.555 == pytest.approx(-3.4627, abs=0.01)
    assert len(replay_folder(recording).poses) > 3900


@pytest.mark.parametrize(
    ("name", "sample_s", "turn_deg"),
    [("direct_ext_rate", 0.001, 180.0), ("direct_imu_rate", 0.001, 173.4), ("medulla_ext_rate", 0.002, 180.0)],
)
def test_the_half_turns_of_the_kvh_logs(name: str, sample_s: float, turn_deg: float, tmp_path: Path) -> None:
    file = RAW / "kvh1750" / f"kvh_{name}.log.gz"
    words = ["--time", "3", "--time-unit", str(sample_s), "--gyro", "7,8,9", "--gyro-unit", "deg", "--axis", "auto"]
    assert main([str(file), *words, "--output", str(tmp_path / "kvh")]) == 0
    assert yaml.safe_load((tmp_path / "kvh/import.yaml").read_text())["applied"]["axis"] == "x"
    rate_deg_s = np.loadtxt(tmp_path / "kvh/fog.csv", delimiter=",", skiprows=1)[:, 1]
    # The marks of the bench are good for about 1 deg.
    assert (np.cumsum(rate_deg_s) * sample_s).max() == pytest.approx(turn_deg, abs=0.5)


def test_the_kvh_logs_own_word_rad_is_found_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = RAW / "kvh1750" / "kvh_direct_imu_rate.log.gz"
    words = ["--time", "3", "--time-unit", "ms", "--gyro", "7,8,9", "--gyro-unit", "rad", "--axis", "x"]
    assert main([str(file), *words, "--output", str(tmp_path / "kvh")]) == 0
    assert "degrees taken for radians" in " ".join(capsys.readouterr().out.split())
