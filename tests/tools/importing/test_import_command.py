"""`drd import` as a user calls it: bags, CAN logs, tables and bytes in, folders out that `drd replay` reads."""

import gzip
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from import_data import RADIUS_M, TREAD_M, Traps, drive
from import_files import COUNTS, EPOCH_NS, ROBOT, write_bag, write_frames, write_table
from mcap.writer import Writer as McapWriter

from drd.cli import main
from drd_tools.importing.examine import WheelTravel
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.replay.folder_source import replay_folder

CONFIG = """\
robot: {name: scout, wheel_radius_m: 0.1, tread_m: 0.5, left_scale: 1.01}
fog: {protocol: dsp3000, rate_hz: 10, positive: clockwise, full_scale_deg_s: 375}
encoders: {layout: agilex, rate_hz: 20}
"""
TRAPS = Traps(axis=1, gyro_sign=-1.0, has_gravity=True, wheels_offset_s=0.2, seconds=60.0)
DRIVE = drive(1, TRAPS)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bag") / "run.bag", DRIVE)


def run(*words: Any) -> int:
    return main(["import", *map(str, words)])


def said(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load((folder / "import.yaml").read_text())
    return content


def check_wheels(recording: Recording, tolerance_m: float = 2e-4, true: WheelTravel = DRIVE[1]) -> None:
    left, right = (RADIUS_M * angle for angle in recording.wheel_angles_rad())
    for mine, side in ((left, true.left_m), (right, true.right_m)):
        assert mine == pytest.approx(side - side[0], abs=tolerance_m)


def test_a_bag_with_its_traps_found(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    wanted = ("--gyro", "/imu", "--wheels", "/joints", "--reference", "/truth", *ROBOT)
    assert run(bag, *wanted, "--axis", "auto", "--sign", "auto", "--shift-wheels", "auto", "--output", out) == 0
    printed = capsys.readouterr().out
    assert "the vertical axis is y" in printed
    assert "fixed  sign" in printed
    recording = read_recording(out)
    check_wheels(recording)
    assert recording.fog is not None
    true = -DRIVE[0].rate_rad_s[:, 1]
    assert recording.fog.rate_rad_s == pytest.approx(true, abs=1e-8)
    assert recording.reference is not None
    assert recording.reference.heading_rad == pytest.approx(DRIVE[2].heading_rad, abs=1e-7)
    applied = said(out)["applied"]
    assert (applied["axis"], applied["sign"]) == ("y", "-")
    assert applied["shift_wheels_s"] == pytest.approx(-0.2, abs=0.01)
    assert said(out)["inputs"].keys() == {str(bag)}
    assert recording.nominal.gyro_rate_hz == pytest.approx(100.0)
    assert recording.nominal.gyro_range_deg_s is None
    # The end of the drive: nothing but counts of 0.15 mm and a gyro with 0.17 deg/s of bias is in it.
    replayed = replay_folder(recording)
    assert replayed.poses[-1].x_m == pytest.approx(DRIVE[2].x_m[-1], abs=0.5)


@pytest.mark.parametrize("name", ["run.bag", "ros2", "ros2_mcap"])
def test_all_bags_give_the_same(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = drive(1, replace(TRAPS, seconds=15.0))
    path = write_bag(tmp_path / name, short)
    file = next(path.glob("*.mcap")) if "mcap" in name else path
    assert run(file) == 0
    listed = capsys.readouterr().out
    assert "sensor_msgs/msg/Imu" in listed
    assert "--gyro /imu --axis auto --sign auto --wheels /joints" in listed
    assert run(file, "--gyro", "/imu", "--wheels", "/odom", *ROBOT, "--output", tmp_path / "out") == 0
    recording = read_recording(tmp_path / "out")
    check_wheels(recording, 1e-3, short[1])
    assert recording.fog is not None
    assert recording.fog.rate_rad_s == pytest.approx(short[0].rate_rad_s[:, 2], abs=1e-8)


@pytest.mark.parametrize(
    "wheels",
    [
        ("/odom",),
        ("/odom", "--wheels-from", "pose"),
        ("/joints",),
        ("/joints", "--joints", "wheel_left:wheel_right"),
        ("/joints:position.0,/joints:position.1", "--wheels-unit", "rad"),
    ],
)
def test_wheels_of_any_message_are_the_same_wheels(wheels: tuple[str, ...], bag: Path, tmp_path: Path) -> None:
    assert run(bag, "--wheels", *wheels, *ROBOT, "--output", tmp_path / "out") == 0
    recording = read_recording(tmp_path / "out")
    # A first row has no interval: what an odometry says of the time before is not in the folder.
    check_wheels(recording, 3e-3)
    assert recording.nominal.counts_per_revolution is None


def test_counts_of_two_topics_that_wrap(bag: Path, tmp_path: Path) -> None:
    words = ("--wheels", "/left:data,/right", "--wheels-unit", "counts", "--counts-per-revolution", COUNTS)
    assert run(bag, *words, *ROBOT, "--output", tmp_path / "out") == 0
    recording = read_recording(tmp_path / "out")
    assert recording.encoders.left_counts is not None
    assert np.ptp(recording.encoders.left_counts) > 2**15
    check_wheels(recording, 4e-4)
    notes = said(tmp_path / "out")["streams"]["wheels"]["notes"]
    assert any("nearest in time, 0.0030 s apart" in note for note in notes)


def test_stamps_of_receipt_and_of_the_header(bag: Path, tmp_path: Path) -> None:
    for stamps, late_s in (("header", 0.0), ("receive", 0.02)):
        out = tmp_path / stamps
        assert run(bag, "--gyro", "/imu", "--stamps", stamps, "--output", out) == 0
        stream = said(out)["streams"]["gyro"]
        assert stream["stamps"] == stamps
        assert "received 0.0200 s after" in stream["notes"][0]
        begin_s = float(said(out)["zero"]) - EPOCH_NS * 1e-9
        assert begin_s == pytest.approx(DRIVE[0].time_s[0] + late_s, abs=1e-6)


def test_a_header_without_stamps_asks_for_those_of_receipt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_bag(tmp_path / "zero.bag", drive(1, replace(TRAPS, seconds=5.0)), zero_stamps=True)
    assert run(path, "--gyro", "/imu", "--output", tmp_path / "out") == 2
    assert "--stamps receive" in capsys.readouterr().err
    assert run(path, "--gyro", "/imu", "--stamps", "receive", "--output", tmp_path / "out") == 0


def test_what_the_data_cannot_tell_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    traps = Traps(swapped=True, seconds=60.0)
    path = write_bag(tmp_path / "run.bag", drive(2, traps))
    words = ("--gyro", "/imu", "--wheels", "/joints", *ROBOT, "--output", tmp_path / "out")
    assert run(path, *words, "--sign", "auto") == 2
    assert "--sign" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert run(path, *words, "--sign", "+", "--reference", "/truth", "--swap", "auto") == 0
    assert said(tmp_path / "out")["applied"]["swap"] is True
    printed = capsys.readouterr().out
    assert "fixed  sides" in printed
    assert "gyro against wheels: correlation +" in printed
    assert run(path, *words, "--swap", "no") == 0
    assert "?      sign" in capsys.readouterr().out


def test_wheels_and_a_reference_without_a_gyro(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--wheels", "/joints", "--reference", "/truth", *ROBOT, "--output", tmp_path / "out")
    assert run(bag, *words, "--shift-wheels", "auto") == 0
    assert "fixed  clock, wheels against reference" in capsys.readouterr().out
    assert said(tmp_path / "out")["applied"]["shift_wheels_s"] == pytest.approx(-0.2, abs=0.02)
    recording = read_recording(tmp_path / "out")
    assert recording.fog is None
    assert len(replay_folder(recording).poses) > 1000


def test_the_daemon_s_own_recording_needs_no_import(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "own.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(library="drd 0.1.0, python mcap")
        writer.finish()  # type: ignore[no-untyped-call]
    assert run(path) == 2
    assert "drd replay" in capsys.readouterr().err


FORMATS = [
    "run.log",
    "run.asc",
    "run.blf",
    "run.trc",
    "run.csv",
    "run.db",
    "run.log.gz",
    "run.asc.gz",
    "run.csv.gz",
]


@pytest.mark.parametrize("name", FORMATS)
def test_can_logs(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(CONFIG)
    path = write_frames(tmp_path / name.removesuffix(".gz"), DRIVE[1])
    if name.endswith(".gz"):
        (tmp_path / name).write_bytes(gzip.compress(path.read_bytes()))
    path = tmp_path / name
    assert run(path) == 0
    assert "311" in capsys.readouterr().out
    assert run(path, "--config", config, "--wheels", "can", "--output", tmp_path / "out") == 0
    recording = read_recording(tmp_path / "out")
    check_wheels(recording, 1.2e-3)  # mm, twice rounded
    assert recording.nominal.counts_per_revolution == pytest.approx(2.0 * math.pi * 100.0)
    assert recording.nominal.tread_m == 0.5
    assert recording.encoders.left_counts is not None
    begin_s = float(said(tmp_path / "out")["zero"]) - EPOCH_NS * 1e-9
    # The time zone of a TRC file is not known.
    assert begin_s == pytest.approx(DRIVE[1].time_s[0], abs=1.0 if ".asc" in name else 2e-3)


@pytest.mark.parametrize("name", ["run.log", "run.txt", "run.log.gz"])
def test_what_candump_shows_with_wall_times(name: str, tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(CONFIG)
    text = ""
    for k in range(100):
        time, distance_mm = f" ({1_700_000_000 + 0.05 * k:.6f})  can0 ", (10 * k).to_bytes(4, "big").hex(" ").upper()
        text += f"{time}      311   [8]  {distance_mm} {distance_mm}\n"
        text += f"{time} 20000004   [8]  00 08 00 00 00 00 00 00   ERRORFRAME\n"
    text += " (1700000009.999999)  can0       311   [8]  00 00 0"  # cut
    (tmp_path / name).write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
    assert run(tmp_path / name, "--config", config, "--wheels", "can", "--output", tmp_path / "out") == 0
    recording = read_recording(tmp_path / "out")
    assert RADIUS_M * recording.wheel_angles_rad()[0][-1] == pytest.approx(0.99, abs=1e-6)
    assert float(said(tmp_path / "out")["zero"]) == pytest.approx(1.7e9, abs=1e-3)


@pytest.mark.parametrize("stays", [True, False], ids=["preset", "one wrong frame"])
def test_a_counter_that_jumps_in_a_can_log_is_no_robot_that_stands(stays: bool, tmp_path: Path) -> None:
    config, text = tmp_path / "robot.yaml", ""
    config.write_text(CONFIG)
    for k in range(400):
        off_mm = 70_000 * sum(k >= jump if stays else k == jump for jump in (100, 200, 300))
        data = (50 * k + off_mm).to_bytes(4, "big").hex()
        text += f"({1_700_000_000 + 0.05 * k:.6f}) can0 311#{data}{data}\n"
    (tmp_path / "run.log").write_text(text)
    assert run(tmp_path / "run.log", "--config", config, "--wheels", "can", "--output", tmp_path / "out") == 0
    log = read_recording(tmp_path / "out").encoders
    assert log.left_counts is not None
    assert np.diff(log.left_counts) / np.diff(log.time_s) == pytest.approx(1000.0, rel=1e-4)
    assert log.left_counts[-1] - log.left_counts[0] == 50 * 399
    assert any("3 times" in note for note in said(tmp_path / "out")["streams"]["wheels"]["notes"])


def test_a_pause_in_a_can_log_stays_a_pause(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(CONFIG)
    w = DRIVE[1]
    kept = (w.time_s < 20.0) | (w.time_s > 23.0)
    cut = replace(w, time_s=w.time_s[kept], left_m=w.left_m[kept], right_m=w.right_m[kept])
    path = write_frames(tmp_path / "cut.log", cut)
    assert run(path, "--config", config, "--wheels", "can", "--output", tmp_path / "out") == 0
    recording = read_recording(tmp_path / "out")
    assert np.diff(recording.encoders.time_s).max() == pytest.approx(3.0, abs=0.15)
    assert any("missing, not guessed" in note for note in said(tmp_path / "out")["streams"]["wheels"]["notes"])
    lost_m = np.interp([20.0, 23.0], w.time_s, w.left_m)
    total_m = RADIUS_M * recording.wheel_angles_rad()[0][-1]
    assert total_m == pytest.approx(w.left_m[-1] - w.left_m[0] - np.diff(lost_m)[0], abs=0.1)


def test_gyro_and_wheels_from_two_files(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(CONFIG)
    can_log = write_frames(tmp_path / "run.blf", DRIVE[1])
    gyro = DRIVE[0]
    columns = {"stamp": gyro.time_s * 1e3 + EPOCH_NS * 1e-6, "wz": np.degrees(gyro.rate_rad_s[:, 1])}
    np.savetxt(
        tmp_path / "gyro.csv", np.column_stack(list(columns.values())), "%.3f,%.9f", header="stamp,wz", comments=""
    )
    words = ("--config", config, "--wheels", "can", "--gyro-file", tmp_path / "gyro.csv", "--gyro", "wz")
    units = ("--gyro-unit", "deg_s", "--time-unit", "ms", "--sign", "-")
    assert run(can_log, *words, *units, "--shift-wheels", "auto", "--output", tmp_path / "out") == 0
    assert said(tmp_path / "out")["applied"]["shift_wheels_s"] == pytest.approx(-0.2, abs=0.015)
    assert len(said(tmp_path / "out")["inputs"]) == 2


def test_tables_by_name_and_by_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, wheels, _ = DRIVE
    rng = np.random.default_rng(0)
    columns = {
        "t": wheels.time_s,
        "l": wheels.left_m,
        "r": wheels.right_m,
        "w": rng.normal(0.0, 0.01, len(wheels.time_s)),
    }
    path = write_table(tmp_path / "table.csv", columns)
    words = ("--wheels-unit", "m", *ROBOT, "--output", tmp_path / "out")
    assert run(path) == 0
    assert "median step" in capsys.readouterr().out
    for names in ("l,r", "2,3"):
        assert run(path, "--wheels", names, *words) == 0
        check_wheels(read_recording(tmp_path / "out"), 1e-6)
    quoted = tmp_path / "quoted.csv"
    rows = path.read_text().splitlines()[1:]
    quoted.write_text("\n".join(["t,l,r,remark", *(",".join([*row.split(",")[:3], '"dry, flat"']) for row in rows)]))
    assert run(quoted, "--wheels", "l,r", *words) == 0
    check_wheels(read_recording(tmp_path / "out"), 1e-6)
    bare = tmp_path / "bare.txt.gz"
    text = "\n".join(" ".join(["rate:", *row.split(",")]) for row in rows)
    bare.write_bytes(gzip.compress(text.encode()))
    assert run(bare, "--time", "2", "--wheels", "3,4", "--gyro", "5", "--gyro-unit", "rad_s", *words) == 0
    check_wheels(read_recording(tmp_path / "out"), 1e-6)


def test_delta_angles_and_their_known_turn(tmp_path: Path) -> None:
    rate = np.sin(np.arange(500) / 50.0)
    path = write_table(tmp_path / "delta.csv", {"n": np.arange(500.0), "a": rate * 0.01})
    words = ("--time", "n", "--time-unit", "0.01", "--gyro", "a", "--gyro-unit", "rad", "--gyro-scale", "2")
    assert run(path, *words, "--output", tmp_path / "out") == 0
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["fog.csv", "import.yaml"]
    written = np.loadtxt(tmp_path / "out" / "fog.csv", delimiter=",", skiprows=1)
    assert np.radians(written[:, 1]) == pytest.approx(2.0 * rate, abs=1e-8)


def test_an_earlier_import_is_replaced_and_nothing_else_is(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run(bag, "--gyro", "/imu", "--wheels", "/odom", *ROBOT, "--output", out) == 0
    assert run(bag, "--wheels", "/odom", *ROBOT, "--output", out) == 0
    assert not (out / "fog.csv").exists()
    (out / "import.yaml").unlink()
    assert run(bag, "--wheels", "/odom", *ROBOT, "--output", out) == 2


def test_robot_yaml_is_kept_and_overruled(bag: Path, tmp_path: Path) -> None:
    robot = tmp_path / "robot.yaml"
    robot.write_text("name: husky\nwheel: {radius_m: 0.1}\ntread_m: 0.9\nfog: {range_deg_s: 300}\n")
    words = (
        "--wheels",
        "/joints",
        "--robot",
        robot,
        "--tread",
        TREAD_M,
        "--standstill",
        3,
        "--output",
        tmp_path / "out",
    )
    assert run(bag, *words) == 0
    nominal = read_recording(tmp_path / "out").nominal
    assert (nominal.name, nominal.tread_m, nominal.gyro_range_deg_s) == ("husky", TREAD_M, 300.0)
    assert nominal.standstill_at_start_s == 3.0
