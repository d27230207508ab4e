import math
import shutil
from pathlib import Path

import pytest
from bench.robot import SPEED_M_S
from recorded_drive import CALIBRATION, Drive, drive, recordings

from drd.config.schema import ConfigError
from drd.recording import recorder as recorder_module
from drd.recording.file import RecordingFile
from drd.recording.in_force import IN_FORCE
from drd.recording.topics import POSE, RAW_CAN, RAW_EVENTS, RAW_FOG, Message
from drd.units import NS_PER_S
from drd_tools.recordings.mcap_file import open_mcap
from drd_tools.replay.mcap_source import bits, replay_mcap
from drd_tools.replay.result import digest
from drd_tools.replay.summary import summary


def recorded(folder: Path, recording: str = "flush_s: 0.1", seconds: float = 20.0) -> Drive:
    d = drive(folder, recording)
    recorder = d.start()
    d.run(seconds)
    assert recorder.close(5.0)
    return d


def test_the_replay_repeats_the_live_run_to_the_bit(tmp_path: Path) -> None:
    """With a calibration, split packets, a lost port and all commands."""
    d = recorded(tmp_path)
    (file,) = recordings(tmp_path)
    for name in ("robot.yaml", "calibration.yaml"):
        (tmp_path / name).unlink()  # all that is needed is in the recording
    replayed = replay_mcap(file)
    assert len(replayed.poses) == len(d.poses) > 350
    assert replayed.digest() == digest(d.poses)
    assert replayed.notes == [f"the {len(d.poses)} poses of the live run are repeated to the bit"]
    assert replayed.counters == d.pipeline.counters()
    assert replayed.calibration == d.pipeline.calibration
    assert any(pose.validity.value == "degraded" for pose in replayed.poses)
    assert list(replayed.inputs) == [file.name]


def test_poses_that_were_set_reach_the_monitor_and_are_no_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Straight on, by wheels that are 3 % larger than configured; a reset begins the distances anew."""
    monkeypatch.setattr("bench.robot.RATE_RAD_S", 0.0)
    d = drive(tmp_path, calibration=False)

    def between(tick: int) -> None:
        if tick in (400, 1200):
            d.pipeline.set_pose(tick * 50_000_000, 1.03 * 0.05 * SPEED_M_S * tick, 0.0, 0.0, 0.01, 0.01)

    recorder = d.start()
    d.run(70.0, between)
    assert recorder.close(5.0)
    replayed = replay_mcap(recordings(tmp_path)[0], monitors=True)
    (told,) = [note for note in replayed.notes if "monitor: " in note]
    assert "Both wheels roll +3 % further than configured, by 1 distances" in told
    # Where a pose is set the robot is elsewhere, but has not driven there.
    assert len(replayed.set_ns) == 4
    (told,) = [line for line in summary(replayed).splitlines() if line.startswith("path ")]
    assert float(told.split()[1]) == pytest.approx(70.0 * SPEED_M_S, abs=0.5)


def test_a_run_in_several_parts_is_replayed_from_its_first(tmp_path: Path) -> None:
    d = recorded(tmp_path, "flush_s: 0.1, max_file_mb: 1", seconds=200.0)
    files = recordings(tmp_path)
    assert len(files) > 1
    replayed = replay_mcap(files[-1])
    assert replayed.digest() == digest(d.poses)
    assert list(replayed.inputs) == [file.name for file in files]
    first = replay_mcap(files[0])
    assert 0 < len(first.poses) < len(d.poses)
    assert digest(d.poses[: len(first.poses)]) == first.digest()


def test_without_the_first_part_the_replay_says_that_it_is_another_run(tmp_path: Path) -> None:
    d = recorded(tmp_path, "flush_s: 0.1, max_file_mb: 1", seconds=200.0)
    recordings(tmp_path)[0].unlink()
    replayed = replay_mcap(recordings(tmp_path)[-1])
    assert replayed.notes == ["part 1 of the run is not there: the replay is not the live run, it begins from nothing"]
    assert 0 < len(replayed.poses) < len(d.poses)


def test_what_is_left_of_a_cut_file_is_the_live_runs_beginning(tmp_path: Path) -> None:
    d = recorded(tmp_path)
    (file,) = recordings(tmp_path)
    data = file.read_bytes()
    for part in (0.3, 0.6, 0.8):
        file.write_bytes(data[: int(part * len(data))])
        replayed = replay_mcap(file)
        assert 0 < len(replayed.poses) < len(d.poses)
        assert replayed.digest() == digest(d.poses[: len(replayed.poses)])
        assert "cut: " in replayed.notes[0]
        assert replayed.notes[-1].endswith("repeated to the bit")


def test_a_hole_in_the_recording_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    d = drive(tmp_path)
    recorder = d.start()

    def hole(tick: int) -> None:
        monkeypatch.setattr(recorder_module, "QUEUE_ENTRIES", 0 if 200 <= tick < 250 else 50_000)

    d.run(20.0, hole)
    recorder.close(5.0)
    notes = replay_mcap(recordings(tmp_path)[0]).notes
    assert f"{recorder.lost} entries are missing: what was lost or cut is not replayed" in notes
    assert "the replay differs from the live run from pose" in notes[-1]


def test_another_calibration_or_configuration_takes_the_recordeds_place(tmp_path: Path) -> None:
    d = recorded(tmp_path)
    (file,) = recordings(tmp_path)
    other = tmp_path / "other.yaml"
    other.write_text((tmp_path / "calibration.yaml").read_text().replace("a0: [0.1,", "a0: [0.2,"))
    replayed = replay_mcap(file, calibration=other)
    assert replayed.notes == []
    assert str(other) in replayed.inputs
    assert replayed.digest() != digest(d.poses)
    config = tmp_path / "robot2.yaml"
    config.write_text((tmp_path / "robot.yaml").read_text().replace("tread_m: 0.6", "tread_m: 0.7"))
    assert replay_mcap(file, config=config).config.robot.tread_m == 0.7
    assert replay_mcap(file, config=tmp_path / "robot.yaml").digest() == digest(d.poses)


def test_a_part_of_a_configuration_changes_the_recorded_one(tmp_path: Path) -> None:
    d = recorded(tmp_path)
    (file,) = recordings(tmp_path)
    (tmp_path / "calibration.yaml").unlink()  # the recorded one goes on holding
    part = tmp_path / "part.yaml"
    part.write_text("estimation: {gate_sigma: 5}\n")  # as recorded
    assert replay_mcap(file, config=part).digest() == digest(d.poses)
    part.write_text("robot: {tread_m: 0.7}\n")
    replayed = replay_mcap(file, config=part)
    assert (replayed.config.robot.tread_m, replayed.config.robot.wheel_radius_m) == (0.7, 0.11)
    assert replayed.calibration == d.pipeline.calibration
    part.write_text("encoders: {latency_s: 0.1}\n")
    live, earlier = replay_mcap(file), replay_mcap(file, config=part)
    assert (earlier.poses[-1].t_ns - live.poses[-1].t_ns) / NS_PER_S == pytest.approx(-0.1, abs=1e-3)
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "other.yaml").write_text(CALIBRATION.replace("a0: [0.1,", "a0: [0.2,"))
    (folder / "part.yaml").write_text("calibration: {file: other.yaml}\n")
    replayed = replay_mcap(file, config=folder / "part.yaml")
    assert replayed.config.calibration.file == str(folder / "other.yaml")
    assert replayed.digest() != digest(d.poses)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("robot:\n  tread: 0.7\n", r"part.yaml:2: robot.tread: expected one of"),
        ("encoders: {right: {node: 1}}\n", r"part.yaml:1: encoders.right.node: expected a node other"),
        (
            "encoders: {counts_per_revolution: null}\n",
            r"part.yaml:1: encoders.counts_per_revolution: .*cia406 reads counts",
        ),
        ("encoders: {latency_s: 0.3}\n", r"part.yaml: encoders.silent_after_s: expected more than a sample's age"),
    ],
)
def test_a_part_that_cannot_be_used_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    recorded(tmp_path, seconds=1.0)
    part = tmp_path / "part.yaml"
    part.write_text(text)
    with pytest.raises(ConfigError, match=expected):
        replay_mcap(recordings(tmp_path)[0], config=part)


def test_a_file_without_a_configuration_is_refused(tmp_path: Path) -> None:
    recorded(tmp_path, seconds=1.0)
    (file,) = recordings(tmp_path)
    file.write_bytes(file.read_bytes()[:60])
    with pytest.raises(ConfigError, match="expected a recording of drd"):
        replay_mcap(file)
    assert open_mcap(file).is_cut


@pytest.mark.parametrize(
    ("topic", "payload"),
    [
        (RAW_FOG, b'{"monotonic_ns": 5}'),
        (RAW_FOG, b'{"monotonic_ns": 5, "data": "?"}'),
        (RAW_CAN, b'{"frames": 5}'),
        (RAW_EVENTS, b"[]"),
        (RAW_EVENTS, b'{"event": "set_pose", "monotonic_ns": 5, "x_m": "a"}'),
        (POSE, b"{}"),
        (POSE, b"\xff"),
        # Found by the fuzzer.
        (RAW_FOG, b'{"monotonic_ns": ' + b"9" * 400 + b', "data": ""}'),
        (RAW_CAN, b'{"frames": [{"monotonic_ns": "2", "can_id": 385, "extended": false, "data": ""}]}'),
        (RAW_CAN, b'{"frames": [{"monotonic_ns": 2, "can_id": Infinity, "extended": false, "data": ""}]}'),
        (RAW_EVENTS, b"[" * 2000),
        (RAW_EVENTS, b'{"event": "tick", "monotonic_ns": Infinity}'),
        (RAW_EVENTS, b'{"event": ["tick"], "monotonic_ns": -1}'),
        (RAW_EVENTS, b'{"event": "reload", "monotonic_ns": 1, "files": {}}'),
        (
            RAW_EVENTS,
            b'{"event": "set_pose", "monotonic_ns": 1, "x_m": 0, "y_m": 0, "heading_rad": Infinity, "sigma_m": 0, '
            b'"sigma_rad": 0}',
        ),
    ],
)
def test_what_drd_did_not_write_is_refused(tmp_path: Path, topic: str, payload: bytes) -> None:
    in_force = {IN_FORCE: b"robot: {wheel_radius_m: 0.1, tread_m: 0.5}\nencoders: {counts_per_revolution: 4096}\n"}
    file = RecordingFile(tmp_path / "odd.mcap", {"part": "x"}, in_force, 0)
    file.add(Message(topic, 0, payload), 1, 0, 0)
    file.finish({})
    with pytest.raises(ConfigError, match=rf"odd\.mcap, {topic}, number 1"):
        replay_mcap(tmp_path / "odd.mcap")


def test_a_copy_under_another_name_replays(tmp_path: Path) -> None:
    d = recorded(tmp_path, seconds=5.0)
    copy = tmp_path / "copy.mcap"
    shutil.copy(recordings(tmp_path)[0], copy)
    assert replay_mcap(copy).digest() == digest(d.poses)


def test_one_bit_makes_two_poses_differ(tmp_path: Path) -> None:
    d = recorded(tmp_path, seconds=5.0)
    a, b = d.poses[-1], replay_mcap(recordings(tmp_path)[0]).poses[-1]
    assert bits(a) == bits(b)
    b.x_m = math.nextafter(b.x_m, math.inf)
    assert bits(a) != bits(b)
