"""What `drd import` refuses, each time in a sentence and without a folder left behind."""

import contextlib
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from import_data import Traps, drive
from import_files import EPOCH_NS, ROBOT, Messages, write_bag
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from drd.cli import main

CONFIG = """\
robot: {name: scout, wheel_radius_m: 0.1, tread_m: 0.5, left_scale: 1.01}
fog: {protocol: dsp3000, rate_hz: 10, positive: clockwise, full_scale_deg_s: 375}
encoders: {layout: agilex, rate_hz: 20}
"""
TRAPS = Traps(axis=1, gyro_sign=-1.0, has_gravity=True, wheels_offset_s=0.2, seconds=60.0)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bag") / "run.bag", drive(1, TRAPS))


def run(*words: Any) -> int:
    return main(["import", *map(str, words)])


def test_auto_is_refused_with_the_reason(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = write_bag(tmp_path / "both.bag", drive(2, Traps(left_sign=-1.0, right_sign=-1.0, seconds=60.0)))
    words = ("--wheels", "/joints", *ROBOT, "--output", tmp_path / "out")
    assert run(both, *words, "--reference", "/truth", "--swap", "auto") == 2
    assert "both wheels' signs are wrong" in capsys.readouterr().err
    assert run(both, *words, "--reference", "/truth", "--swap", "auto", "--reverse", "both") == 0
    # The gyro's z is not the vertical one: there is nothing to see in it, and that is said.
    assert run(bag, *words, "--gyro", "/imu", "--shift-wheels", "auto") == 2
    assert "the vertical axis is y" in capsys.readouterr().err


@pytest.mark.parametrize("last", ["Imu", "Pose"])
def test_a_topic_of_two_types_of_which_one_has_no_header_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], last: str
) -> None:
    store, path = get_typestore(Stores.ROS1_NOETIC), tmp_path / "two.bag"
    messages = Messages(store, ros1=True)
    with Writer(path) as writer:
        for k in range(200):
            t_ns = EPOCH_NS + k * 50_000_000
            has_header = (last == "Imu") == (k >= 100)
            made = messages.imu(t_ns, np.zeros(3), None) if has_header else messages.pose(0.0, 0.0, 0.0)
            kind = made.__msgtype__
            known = [c for c in writer.connections if c.msgtype == kind]
            connection = known[0] if known else writer.add_connection("/turn", kind, typestore=store)
            writer.write(connection, t_ns, store.serialize_ros1(made, kind))
    assert run(path, "--gyro", "/turn:orientation.z", "--output", tmp_path / "out") == 2
    expected = "messages of one type, got geometry_msgs/msg/Pose and sensor_msgs/msg/Imu"
    assert expected in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--gyro", "/imu"), "--output"),
        (("--gyro", "/nothing", "--output", "o"), "one of /imu"),
        (("--gyro", "/odom", "--output", "o"), "TOPIC:FIELD"),
        (("--gyro", "/odom:twist.nothing", "--output", "o"), "a number in nav_msgs/msg/Odometry"),
        (("--wheels", "/odom", "--output", "o"), "--wheel-radius"),
        (("--wheels", "/odom", "--wheel-radius", "0.1", "--output", "o"), "--tread"),
        (("--wheels", "/imu", *ROBOT, "--output", "o"), "sensor_msgs/msg/JointState"),
        (("--wheels", "/left,/right", *ROBOT, "--output", "o"), "--wheels-unit"),
        (("--wheels", "/left,/right", "--wheels-unit", "counts", *ROBOT, "--output", "o"), "--counts-per-revolution"),
        (("--wheels", "/joints", "--joints", "a:b", *ROBOT, "--output", "o"), "wheel_left, wheel_right"),
        (("--reference", "/imu", "--output", "o"), "PoseStamped"),
        (("--wheels", "/odom", *ROBOT, "--gyro", "/imu", "--shift-wheels", "1e6", "--output", "o"), "overlap"),
    ],
)
def test_bad_requests_say_what_is_wrong(
    words: tuple[str, ...],
    expected: str,
    bag: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(bag, *words) == 2
    error = capsys.readouterr().err
    assert error.startswith("drd import: ")
    assert expected in error
    assert list(tmp_path.iterdir()) == []


SHOWN = "can0  311   [8]  00 00 00 01 00 00 00 01\n"
SQLITE = {
    "other": ["CREATE TABLE people (name TEXT)"],
    "bag": ["CREATE TABLE topics (id)", "CREATE TABLE messages (id, topic_id, timestamp, data)"],
}


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (f"  {SHOWN}", "a.log:1: expected times since 1970, as candump -ta"),
        (f" (000.050120)  {SHOWN}", "(000.050120), which is another clock"),
        (f" (2023-11-14 22:13:20.123456)  {SHOWN}", "which is another clock"),
        (f" (1700000000.1234567)  {SHOWN} (1700000000.2)  can0  311   [8]  00 00\n", "a.log:2"),
        (f" (1700000000.123456)  {SHOWN} (1700000000.200000)  can0  311   [8]  00 00\n", "expected 8 bytes"),
    ],
)
def test_what_candump_shows_is_refused_by_what_it_lacks(
    content: str, expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.log").write_text(content)
    assert run(tmp_path / "a.log") == 2
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "tables", "expected"),
    [
        ("a.db", "bag", "a ROS 2 bag to end in .db3"),
        ("a.db", "other", "the tables people"),
        ("a.db3", "other", "the tables people"),
    ],
)
def test_sqlite_files_are_called_by_what_they_hold(
    name: str, tables: str, expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with contextlib.closing(sqlite3.connect(tmp_path / name)) as base:
        for statement in SQLITE[tables]:
            base.execute(statement)
        base.commit()
    assert run(tmp_path / name) == 2
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize("begin", [b"MDF     4.10    ", b"UnFinMF 4.11    "])
def test_a_measurement_file_is_called_one_with_what_to_do(
    begin: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.mf4").write_bytes(begin + bytes(range(200)))
    assert run(tmp_path / "a.mf4") == 2
    error = capsys.readouterr().err
    assert "can_logconvert RUN.mf4 RUN.blf" in error
    assert "got an MF4 file" in error


@pytest.mark.parametrize("name", ["a.xlsx", "a.csv"])
def test_an_unknown_binary_file_is_called_one(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / name).write_bytes(b"PK\3\4\xff\xfe")
    assert run(tmp_path / name) == 2
    assert r"got bytes that begin with b'PK\x03\x04" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3", "a.blf", "a.asc", "a.csv", "a.log.gz", "a.trc", "a.bin"])
@pytest.mark.parametrize(
    "content", [b"", b"\0\1\2rubbish\xff" * 50, b"1,2,3\n4,5\n", b"\x1f\x8b\x08", b"1," + b"2" * 200_000]
)
def test_rubbish_is_refused_in_a_sentence(
    name: str, content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(CONFIG)
    (tmp_path / name).write_bytes(content)
    kind = {".bin": ("--gyro", "fog"), ".csv": ("--gyro", "2", "--gyro-unit", "rad_s", "--time", "1")}
    words = kind.get(
        Path(name).suffix, ("--wheels", "can" if name.startswith(("a.blf", "a.asc", "a.trc")) else "/odom")
    )
    assert run(tmp_path / name, *words, "--config", config, "--output", tmp_path / "out") == 2
    assert capsys.readouterr().err.startswith("drd import: ")
