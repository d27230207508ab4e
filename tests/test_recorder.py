"""The recorder on a pipeline without ports: what is in the files, and that nothing ever waits for them."""

import errno
import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from recorded_drive import CALIBRATION, drive, recordings

from drd.config.keys import Config, Recording, State
from drd.config.schema import ConfigError, loads
from drd.pipeline import Pipeline
from drd.recording import recorder as recorder_module
from drd.recording.folder import make_room
from drd.recording.in_force import AS_WRITTEN, IN_FORCE
from drd.recording.in_force import CALIBRATION as CALIBRATION_NAME
from drd.recording.recorder import Recorder
from drd.recording.topics import CHANNELS, RAW_CAN, RAW_EVENTS, RAW_FOG, SCENE_PERIOD_NS
from drd.samples import Pose
from drd_tools.recordings.mcap_file import open_mcap
from drd_tools.replay.mcap_source import replay_mcap
from drd_tools.replay.result import digest


def until(condition: Any) -> None:
    deadline = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_recording_holds_what_came_in_went_out_and_was_in_force(tmp_path: Path) -> None:
    d = drive(tmp_path)
    recorder = d.start()
    d.run(20.0)
    recorder.health_report({"monotonic_ns": 7, "validity": "valid"})
    assert recorder.close(5.0)
    (path,) = recordings(tmp_path)
    assert path.name.startswith("my_robot_1-")
    found = open_mcap(path)
    assert found.end == {"reason": "stopped", "lost": "0", "last_entry": str(recorder.health()["written"])}
    assert loads(found.attachments[IN_FORCE].decode(), Config).value == d.loaded.value
    assert found.attachments[AS_WRITTEN] == (tmp_path / "robot.yaml").read_bytes()
    assert found.attachments[CALIBRATION_NAME].decode() == CALIBRATION
    counts = {channel.topic: 0 for channel in CHANNELS}
    for message in found.messages():
        counts[message.topic] += 1
    counters = d.pipeline.counters()
    assert counts.pop("/fog") == counters["fog"]["samples"] > 150
    assert counts.pop("/wheels") == counters["encoders"]["samples"] > 350
    assert {counts.pop(name) for name in ("/pose", "/tf", "/odom", "/drd/pose")} == {len(d.poses)}
    assert counts.pop("/scene") == 1 + (d.poses[-1].t_ns - d.poses[0].t_ns) // SCENE_PERIOD_NS
    assert sum(len(m.value()["frames"]) for m in found.messages(RAW_CAN)) == counters["encoders"]["frames"]
    names = [m.value()["event"] for m in found.messages(RAW_EVENTS)]
    assert [n for n in names if n != "tick"] == ["port_state", "port_state", "set_pose", "calibrate_bias", "reset"]
    assert counts == {RAW_FOG: 400, RAW_CAN: 400, RAW_EVENTS: len(names), "/health": 1, "/findings": 0}


def test_what_only_viewers_need_can_be_left_out(tmp_path: Path) -> None:
    d = drive(tmp_path, "viewers: false")
    recorder = d.start()
    d.run(5.0)
    assert recorder.close(5.0)
    found = {message.topic for message in open_mcap(recordings(tmp_path)[0]).messages()}
    assert "/drd/pose" in found
    assert not found & {"/pose", "/tf", "/scene"}


def test_numbers_and_log_times_give_the_order_of_the_calls(tmp_path: Path) -> None:
    d = drive(tmp_path)
    recorder = d.start()
    d.run(5.0)
    recorder.close(5.0)
    messages = list(open_mcap(recordings(tmp_path)[0]).messages())
    numbers = [m.number for m in messages]
    assert numbers == sorted(numbers)
    assert set(numbers) == set(range(1, max(numbers) + 1))
    assert [m.log_ns for m in messages] == sorted(m.log_ns for m in messages)


def test_a_clock_that_is_not_set_yet_does_not_make_the_run_the_oldest(tmp_path: Path) -> None:
    """Parts of a run that began in 1970, the last one written when the clock had been set back, beside one of 2026."""
    own = "bot-19700101T000010Z-0123abcd"
    times_s = {"bot-20260314T071500Z-1f0c9a55-0001": 1_773_472_500, f"{own}-0001": 3600, f"{own}-0002": 60}
    for name, time_s in times_s.items():
        (tmp_path / f"{name}.mcap").write_bytes(b"x" * 1000)
        os.utime(tmp_path / f"{name}.mcap", (time_s, time_s))
    for limit_bytes, left in ((2000, [f"{own}-0001", f"{own}-0002"]), (1000, [f"{own}-0002"])):
        make_room(tmp_path, "bot", own, limit_bytes)
        assert sorted(file.stem for file in tmp_path.iterdir()) == left


def test_full_files_are_continued_the_oldest_deleted_and_the_rest_left_alone(tmp_path: Path) -> None:
    d = drive(tmp_path, "flush_s: 0.1, max_file_mb: 1, max_total_mb: 3")
    foreign = tmp_path / "records" / "my_robot_1-notes.mcap"
    foreign.parent.mkdir()
    foreign.write_bytes(b"x" * 5_000_000)
    recorder = d.start()
    most = 0

    def look(tick: int) -> None:
        nonlocal most
        with suppress(FileNotFoundError):  # one is deleted at this moment
            most = max(most, sum(file.stat().st_size for file in recordings(tmp_path) if file != foreign))
        if tick % 400 == 0:
            until(lambda: not recorder.health()["waiting"])

    d.run(300.0, look)
    recorder.close(5.0)
    files = [file for file in recordings(tmp_path) if file != foreign]
    parts = [int(file.stem[-4:]) for file in files]
    assert parts == list(range(parts[0], parts[-1] + 1))
    assert parts[0] > 1
    assert all(file.stat().st_size <= 1_000_000 for file in files)
    assert 2_000_000 < most <= 3_000_000
    assert foreign.exists()
    found = [open_mcap(file) for file in files]
    assert [part.end and part.end["reason"] for part in found] == ["continued"] * (len(found) - 1) + ["stopped"]
    assert len({part.information["run"] for part in found}) == 1
    assert recorder.health()["lost"] == 0


def test_an_old_file_is_continued(tmp_path: Path) -> None:
    d = drive(tmp_path, "flush_s: 0.1, max_file_age_s: 10")
    recorder = d.start()
    d.run(2.0)
    until(lambda: recorder.health()["written"] and not recorder.health()["waiting"])
    object.__setattr__(d.loaded.value.recording, "max_file_age_s", 0.0)
    until(lambda: recorder.health()["file"] is None)
    object.__setattr__(d.loaded.value.recording, "max_file_age_s", 10.0)
    d.run(2.0)
    recorder.close(5.0)
    assert len(recordings(tmp_path)) == 2


@pytest.mark.parametrize(("flush_s", "fsync_s"), [(0.5, 0.5), (1.0, 5.0), (0.7, 1.0), (2.0, 0.5)])
def test_what_a_kill_and_a_power_cut_may_lose_is_flushed_and_synced_in_time(
    tmp_path: Path, flush_s: float, fsync_s: float
) -> None:
    d = drive(tmp_path, f"flush_s: {flush_s}, fsync_s: {fsync_s}")
    recorder: Any = Recorder(d.loaded, tmp_path)
    flushed_s, synced_s, now_s = [0.0], [0.0], 0.0
    file: Any = SimpleNamespace(size=0, pending=0)
    file.flush, file.sync = lambda: flushed_s.append(now_s), lambda: synced_s.append(now_s)
    recorder._file, recorder._full_bytes = file, 1e9
    for i in range(1, 101):
        now_s = i * recorder_module.DRAIN_S
        recorder._keep(round(now_s * 1e9))
    assert max(np.diff([*flushed_s, now_s])) < flush_s
    assert max(np.diff([*synced_s, now_s])) < fsync_s
    assert set(synced_s) <= set(flushed_s)
    assert len(flushed_s) <= 2 + sum(now_s / (s - recorder_module.DRAIN_S) for s in (flush_s, fsync_s))


def test_no_more_is_lost_in_a_power_cut_than_promised() -> None:
    """At most 1 s of recording and 5 s of state, with as much time again for the disk."""
    assert max(Recording().flush_s, Recording().fsync_s) <= 0.5
    assert State().period_s <= 4.0


def test_a_full_disk_is_told_what_was_flushed_reads_and_it_goes_on_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full, write = threading.Event(), os.write

    def limited(fd: int, data: bytes) -> int:
        if not full.is_set():
            return write(fd, data)
        if len(data) > 100:
            return write(fd, data[:100])  # the last bytes that fit
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "write", limited)
    monkeypatch.setattr(recorder_module, "RETRY_NS", 300_000_000)
    d = drive(tmp_path)
    recorder = d.start()

    def disk(tick: int) -> None:
        if tick == 100:
            until(lambda: not recorder.health()["waiting"])
            time.sleep(0.25)  # so that it is flushed
            full.set()
        elif tick == 200:
            until(lambda: recorder.health()["state"] == "degraded" and not recorder.health()["waiting"])
            assert "No space left on device" in str(recorder.health()["reason"])
            full.clear()
            time.sleep(0.35)  # until it is tried again

    d.run(20.0, disk)
    recorder.close(5.0)
    assert "entries lost" in str(recorder.trouble)
    assert "No space" not in str(recorder.trouble)
    first, second = (open_mcap(file) for file in recordings(tmp_path))
    assert first.is_cut
    assert first.cut_chunk_s is None
    assert not second.is_cut
    numbers = [m.number for part in (first, second) for m in part.messages()]
    assert recorder.lost == max(numbers) - len(set(numbers))
    assert len(set(numbers)) == recorder.health()["written"]
    notes = replay_mcap(second.path).notes
    assert f"{recorder.lost} entries are missing: what was lost or cut is not replayed" in notes


def test_what_failed_before_its_first_message_leaves_no_file_and_no_hole_in_the_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failures, write = [2], os.write

    def failing(fd: int, data: bytes) -> int:
        if failures[0] and len(data) > 100:
            failures[0] -= 1
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return write(fd, data)

    monkeypatch.setattr(os, "write", failing)
    monkeypatch.setattr(recorder_module, "RETRY_NS", 0)
    d = drive(tmp_path)
    recorder = d.start()
    d.run(1.0)
    until(lambda: recorder.health()["written"])
    recorder.close(5.0)
    (path,) = recordings(tmp_path)
    assert path.stem.endswith("-0001")
    assert open_mcap(path).information["lost_before"] == str(recorder.lost) == "2"


@pytest.mark.parametrize("blocked", [False, True])
def test_poses_do_not_depend_on_the_recorder(tmp_path: Path, blocked: bool) -> None:
    d = drive(tmp_path)
    if blocked:
        (tmp_path / "records").write_text("a file where the folder should be")
    recorder = d.start()
    d.run(10.0)
    until(lambda: not recorder.health()["waiting"])
    assert recorder.health()["state"] == ("degraded" if blocked else "recording")
    recorder.close(5.0)
    alone: list[Pose] = []
    unrecorded = Pipeline(d.loaded.value, tmp_path, lambda pose, _: alone.append(pose))
    recorded_poses, d.poses, d.pipeline = d.poses, [], unrecorded
    d.run(10.0)
    assert digest(alone) == digest(recorded_poses)
    if blocked:
        assert recorder.lost > 0
        assert "records: " in str(recorder.trouble)


def test_a_disk_that_hangs_holds_nothing_up_and_loses_what_is_too_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moving, write = threading.Event(), os.write
    monkeypatch.setattr(os, "write", lambda fd, data: moving.wait(30.0) and write(fd, data))
    monkeypatch.setattr(recorder_module, "QUEUE_ENTRIES", 500)
    d = drive(tmp_path)
    recorder = d.start()
    d.run(20.0)
    assert len(d.poses) > 350
    assert recorder.health()["waiting"] == 500
    assert "entries lost" in str(recorder.trouble)
    assert not recorder.close(0.0)
    moving.set()
    assert recorder.close(10.0)
    found = open_mcap(recordings(tmp_path)[0])
    assert len({m.number for m in found.messages()}) == recorder.health()["written"] >= 500


def test_a_file_in_force_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    d = drive(tmp_path)
    (tmp_path / "calibration.yaml").unlink()
    with pytest.raises(ConfigError, match=r"calibration\.file.*No such file"):
        d.start()


def test_mcap_is_loaded_only_to_record() -> None:
    code = "import sys, drd.service.daemon, drd.pipeline; sys.exit('mcap' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
