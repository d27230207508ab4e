"""`drd export`: what rosbags, evo, pyarrow and `drd evaluate` make of it, beside the poses themselves."""

import io
import math
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from recorded_daemon import daemon_log
from recorded_drive import drive, recordings
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from drd.cli import main
from drd.config.schema import ConfigError
from drd.output.diagnostics import diagnostics
from drd.samples import Pose
from drd_tools.evaluate.trajectory import read_poses as read_csv
from drd_tools.export import poses as poses_module
from drd_tools.export.poses import Stamped, read_poses
from drd_tools.replay.mcap_source import recorded_pose, replay_mcap
from drd_tools.simulate.files import write_folder
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import Simulated, simulate
from drd_tools.simulate.truth import make_truth


@pytest.fixture(scope="module")
def run() -> Simulated:
    return simulate(make_truth(make_drive("slalom", 20.0)), DEFAULT, [], seed=1)


@pytest.fixture(scope="module")
def recorded(run: Simulated, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return daemon_log(tmp_path_factory.mktemp("recorded") / "run.mcap", run)


def export(recording: Path, **outputs: Path) -> str:
    said = io.StringIO()
    with redirect_stdout(said):
        assert main(["export", str(recording), *(w for k, v in outputs.items() for w in (f"--{k}", str(v)))]) == 0
    return said.getvalue()


def bag_of(file: Path) -> dict[str, list[tuple[int, Any]]]:
    """The messages by topic, with the times of the bag, by an independent reader."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([file]) as reader:
        for connection, at_ns, data in reader.messages():
            found.setdefault(connection.topic, []).append((at_ns, reader.deserialize(data, connection.msgtype)))
    return found


def yaw(turn: Any) -> float:
    return 2.0 * math.atan2(turn.z, turn.w)


def wrapped(angle_rad: float) -> float:
    return math.remainder(angle_rad, 2.0 * math.pi)


def test_rosbags_reads_the_poses_of_a_recording(recorded: Path, tmp_path: Path) -> None:
    said = export(recorded, ros2=tmp_path / "bag.mcap")
    poses = read_poses(recorded).poses
    assert said == (
        f"{len(poses)} poses as they were published\n"
        f"wrote {tmp_path}/bag.mcap: /odom {len(poses)}, /tf {len(poses)}, /imu {len(poses)}\n"
    )
    found = bag_of(tmp_path / "bag.mcap")
    assert found.keys() == {"/odom", "/tf", "/imu"}
    for (at_ns, pose), (odom_ns, odom), (tf_ns, tf), (imu_ns, imu) in zip(
        poses, found["/odom"], found["/tf"], found["/imu"], strict=True
    ):
        (transform,) = tf.transforms
        stamps = [m.header.stamp for m in (odom, transform, imu)]
        assert {at_ns} == {odom_ns, tf_ns, imu_ns} == {s.sec * 10**9 + s.nanosec for s in stamps}
        assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
        assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
        assert imu.header.frame_id == "base_link"
        at, moved = odom.pose.pose.position, transform.transform.translation
        assert (at.x, at.y) == (moved.x, moved.y) == (pose.x_m, pose.y_m)
        for turn in (odom.pose.pose.orientation, transform.transform.rotation, imu.orientation):
            assert wrapped(yaw(turn) - pose.heading_rad) == pytest.approx(0.0, abs=1e-12)
        assert odom.twist.twist.linear.x == pose.speed_m_s
        assert odom.twist.twist.angular.z == imu.angular_velocity.z == pose.rate_rad_s
        assert odom.pose.covariance[0] == pose.covariance[0]


def test_the_bag_is_of_the_profile_ros2_and_all_of_it_cdr(recorded: Path, tmp_path: Path) -> None:
    export(recorded, ros2=tmp_path / "bag.mcap")
    with (tmp_path / "bag.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None
    assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
    assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
    assert {s.name for s in summary.schemas.values()} == {
        "nav_msgs/msg/Odometry",
        "tf2_msgs/msg/TFMessage",
        "sensor_msgs/msg/Imu",
    }


def test_the_health_becomes_diagnostics(tmp_path: Path) -> None:
    d = drive(tmp_path)
    recorder = d.start()
    d.run(10.0)
    now_ns = d.poses[-1].t_ns
    health = d.pipeline.health(now_ns) | {"monotonic_ns": now_ns, "wall_ns": now_ns + 1_700_000_000_000_000_000}
    recorder.health_report(health)
    assert recorder.close(5.0)
    (file,) = recordings(tmp_path)
    assert "/diagnostics 1\n" in export(file, ros2=tmp_path / "bag.mcap")
    found = bag_of(tmp_path / "bag.mcap")
    ((at_ns, array),) = found["/diagnostics"]
    assert at_ns == health["wall_ns"] == array.header.stamp.sec * 10**9 + array.header.stamp.nanosec
    rows = {row.name: row for row in array.status}
    assert rows["drd: pose"].message.startswith(health["validity"])
    assert rows["drd: pose"].hardware_id == "my robot/1"
    values = {pair.key: pair.value for pair in rows["drd: pose"].values}
    assert values["bias_measurement"] == health["bias_measurement"]
    times = [at_ns for at_ns, _ in found["/odom"]]
    assert times == sorted(times)


def test_evo_reads_the_bag_and_the_tum_file_as_one_trajectory(recorded: Path, tmp_path: Path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    export(recorded, ros2=tmp_path / "bag.mcap", tum=tmp_path / "run.tum")
    with Reader(tmp_path / "bag.mcap") as reader:
        bag = file_interface.read_bag_trajectory(reader, "/odom")
    tum = file_interface.read_tum_trajectory_file(tmp_path / "run.tum")
    poses = read_poses(recorded).poses
    for trajectory in (bag, tum):
        assert trajectory.check()[0]
        assert trajectory.positions_xyz == pytest.approx(np.array([(p.x_m, p.y_m, 0.0) for _, p in poses]), abs=1e-9)
        assert trajectory.timestamps == pytest.approx(np.array([at_ns * 1e-9 for at_ns, _ in poses]), abs=1e-6)
    assert tum.orientations_quat_wxyz == pytest.approx(bag.orientations_quat_wxyz, abs=1e-11)


def test_evaluate_reads_the_csv(recorded: Path, tmp_path: Path) -> None:
    export(recorded, csv=tmp_path / "run.csv")
    found = read_csv(tmp_path / "run.csv")
    poses = [p for _, p in read_poses(recorded).poses]
    assert found.time_s[0] == pytest.approx(0.05, abs=0.06)
    assert found.pose == pytest.approx(np.array([(p.x_m, p.y_m, p.heading_rad) for p in poses]), abs=1e-6)
    assert found.bound_m == pytest.approx(np.array([p.position_bound_m for p in poses]), rel=1e-5)
    assert found.covariance is not None
    assert found.covariance[-1, 0, 1] == pytest.approx(poses[-1].covariance[1], rel=1e-5)


def test_parquet_has_every_bit(recorded: Path, tmp_path: Path) -> None:
    export(recorded, parquet=tmp_path / "run.parquet")
    columns = pq.read_table(tmp_path / "run.parquet")
    table = columns.drop_columns(["time"]).to_pydict()
    stamps, poses = zip(*read_poses(recorded).poses, strict=True)
    assert str(columns.schema.field("time").type) == "timestamp[ns, tz=UTC]"
    assert columns.column("time").cast("int64").to_pylist() == list(stamps)
    for name in ("x_m", "y_m", "heading_rad", "speed_m_s", "rate_rad_s", "speed_sigma_m_s", "rate_sigma_rad_s"):
        assert table[name] == [getattr(p, name) for p in poses]
    assert table["yh_m_rad"] == [p.covariance[4] for p in poses]
    assert table["position_bound_99_m"] == [p.position_bound_m for p in poses]
    assert table["validity"] == [p.validity.value for p in poses]
    assert table["reasons"][0] == "; ".join(f"{r.source}: {r.text}" for r in poses[0].reasons)
    assert table["monotonic_ns"] == [p.t_ns for p in poses]


def test_a_folder_is_replayed_and_that_is_said(run: Simulated, tmp_path: Path) -> None:
    write_folder(run, tmp_path / "folder", {})
    said = export(tmp_path / "folder", tum=tmp_path / "run.tum", ros2=tmp_path / "bag.mcap")
    assert " poses of a replay, as `drd replay` gives them: the folder holds none\n" in said
    rows = np.loadtxt(tmp_path / "run.tum")
    assert 0.0 <= rows[0, 0] < 1.0
    assert rows[-1, 0] == pytest.approx(20.0, abs=0.2)
    assert len(bag_of(tmp_path / "bag.mcap")["/tf"]) == len(rows)


def test_times_below_zero_keep_their_order(run: Simulated, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    r = run.recording
    logs: Any = {n: replace(log, time_s=log.time_s - 5.25) for n in ("fog", "wheels") if (log := getattr(r, n))}
    write_folder(replace(run, recording=replace(r, **logs)), tmp_path / "folder", {})
    export(tmp_path / "folder", tum=tmp_path / "run.tum", csv=tmp_path / "run.csv")
    times_s = np.loadtxt(tmp_path / "run.tum")[:, 0]
    assert times_s == pytest.approx(np.loadtxt(tmp_path / "run.csv", delimiter=",", skiprows=1)[:, 0], abs=1e-9)
    assert times_s[0] < -5.0
    assert main(["export", str(tmp_path / "folder"), "--ros2", str(tmp_path / "bag.mcap")]) == 2
    assert "--ros2: expected times from 0, as a bag has, got a recording that begins at -5." in capsys.readouterr().err


def test_a_recording_without_poses_is_replayed_and_that_is_said(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(poses_module, "_recorded", lambda _: ([], []))
    assert "poses of a replay, as `drd replay` gives them: the recording holds none" in export(
        recorded, tum=tmp_path / "run.tum"
    )
    replayed = replay_mcap(recorded)
    first_s = 1_767_225_600.0 + (replayed.poses[0].t_ns - replayed.zero_ns) * 1e-9
    assert np.loadtxt(tmp_path / "run.tum")[0, 0] == pytest.approx(first_s, abs=1e-6)


def test_of_two_poses_for_one_time_the_last_counts_and_a_clock_that_is_set_is_told(
    recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = read_poses(recorded)
    assert not any("clock" in note for note in whole.notes)
    known = recorded_pose

    def twice(value: dict[str, Any]) -> Pose:
        pose = known(value)
        return replace(pose, t_ns=pose.t_ns - pose.t_ns % 100_000_000)

    with monkeypatch.context() as patch:
        patch.setattr(poses_module, "recorded_pose", twice)
        times = [pose.t_ns for _, pose in read_poses(recorded).poses]
    assert len(times) == len(set(times)) == pytest.approx(len(whole.poses) / 2, abs=1)

    turned_back = [Stamped(at - (10**12 if i > 50 else 0), p) for i, (at, p) in enumerate(whole.poses)]
    health = [(5, diagnostics({"validity": "valid", "robot": "", "reasons": []}))]
    with monkeypatch.context() as patch:
        patch.setattr(poses_module, "_recorded", lambda _: (turned_back, health))
        found = read_poses(recorded)
    assert found.notes[-1] == (
        "the wall clock was set on the way: times count on from the start instead, of poses only"
    )
    assert found.poses == whole.poses
    assert found.health == []

    ahead = [Stamped(at + (10**12 if i > 50 else 0), p) for i, (at, p) in enumerate(whole.poses)]
    with monkeypatch.context() as patch:
        patch.setattr(poses_module, "_recorded", lambda _: (ahead, health))
        found = read_poses(recorded)
    assert found.notes[-1] == (
        "the wall clock went ahead by 1000.0 s at once (set on the way, or the machine slept): times have that gap"
    )
    assert found.poses == ahead


def test_bad_usage_is_told(recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["export", str(recorded)])
    assert end.value.code == 2
    for arguments, said in (
        (
            [str(recorded), "--csv", str(tmp_path / "none" / "a.csv")],
            "--csv: expected a file in a folder that exists",
        ),
        ([str(recorded), "--ros2", str(recorded)], "--ros2: expected a file that is not in the recording"),
        ([str(tmp_path / "none.mcap"), "--csv", str(tmp_path / "a.csv")], "No such file"),
    ):
        assert main(["export", *map(str, arguments)]) == 2
        assert said in capsys.readouterr().err
    assert recorded.stat().st_size > 10_000


def test_what_is_no_recording_of_drd_is_refused(recorded: Path, tmp_path: Path) -> None:
    export(recorded, ros2=tmp_path / "bag.mcap")
    with pytest.raises(ConfigError, match="expected a recording of drd"):
        read_poses(tmp_path / "bag.mcap")
