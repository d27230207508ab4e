"""Recordings of the real daemon: replayed to the bit, killed, and on a disk that is full."""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from harness import Robot

from drd_tools.recordings.mcap_file import open_mcap
from drd_tools.replay.mcap_source import replay_mcap

pytestmark = pytest.mark.process

FLUSH_S = 0.3


def drd(robot: Robot, **options: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-W", "error", "-m", "drd", "run", str(robot.file)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **options)


def end(process: subprocess.Popen[str]) -> str:
    process.send_signal(signal.SIGTERM)
    _, log = process.communicate(timeout=15.0)
    assert process.returncode == 0, log
    return log


@pytest.fixture
def recorded(robot: Robot, tmp_path: Path) -> Robot:
    with robot.file.open("a") as file:
        file.write(f"recording: {{enabled: true, folder: {tmp_path / 'records'}, flush_s: {FLUSH_S}}}\n")
    robot.emulator.plug_in()
    return robot


def recordings(folder: Path) -> list[Path]:
    return sorted((folder / "records").glob("*.mcap"))


def health(robot: Robot, what: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    deadline = time.monotonic() + 15.0
    while not (robot.health and what(robot.health)):
        assert time.monotonic() < deadline, robot.health
        time.sleep(0.05)
    return robot.health


def test_a_run_with_commands_and_an_unplugged_gyro_is_replayed_to_the_bit(recorded: Robot, tmp_path: Path) -> None:
    process = drd(recorded)
    try:
        recorded.drive()
        recorded.wait("a moving robot", lambda p: p["validity"] == "valid" and p["speed_m_s"] > 0.5, 20.0)
        recorded.get("set_pose", {"x_m": 1 / 3, "y_m": -7.1, "heading_rad": 0.1})
        recorded.emulator.unplug_fog()
        recorded.wait("the gyro's silence", lambda p: any(r["source"] == "fog.port" for r in p["reasons"]))
        recorded.emulator.replug_fog()
        recorded.wait("the gyro again", lambda p: p["validity"] == "valid", 10.0)
        recorded.get("reset")
        recorded.get("calibrate_bias")
        time.sleep(0.5)
        told = health(recorded, lambda h: h["recording"]["written"] > 100 and len(recorded.poses) > 80)["recording"]
    finally:
        end(process)
    assert told["state"] == "recording"
    assert (told["reason"], told["lost"]) == (None, 0)
    (file,) = recordings(tmp_path)
    assert told["file"] == str(file)
    replayed = replay_mcap(file)
    assert replayed.notes == [f"the {len(replayed.poses)} poses of the live run are repeated to the bit"]
    # What other processes heard is what the recording holds.
    by_sequence = {pose.sequence: pose for pose in replayed.poses}
    assert len(recorded.poses) > 80
    for heard in recorded.poses:
        pose = by_sequence[heard["sequence"]]
        assert (heard["monotonic_ns"], heard["x_m"], heard["y_m"]) == (pose.t_ns, pose.x_m, pose.y_m)
        assert (heard["heading_rad"], heard["position_bound_99_m"]) == (pose.heading_rad, pose.position_bound_m)
        assert heard["validity"] == pose.validity.value
    assert sum(1 for _ in open_mcap(file).messages("/health")) > 2


def test_a_killed_daemons_recording_reads_to_the_last_flush(recorded: Robot, tmp_path: Path) -> None:
    process = drd(recorded)
    recorded.drive()
    recorded.wait("a pose", lambda p: p["validity"] == "valid", 20.0)
    time.sleep(1.0)
    process.kill()
    process.communicate(timeout=15.0)
    last_ns = max(pose["monotonic_ns"] for pose in recorded.poses)
    (file,) = recordings(tmp_path)
    found = open_mcap(file)
    assert found.is_cut
    assert found.lost_if_killed_s == FLUSH_S
    replayed = replay_mcap(file)
    lost_s = (last_ns - replayed.poses[-1].t_ns) * 1e-9
    assert lost_s < FLUSH_S + 1.0  # no promise on a busy machine: the test's own slack
    assert found.sentence() in replayed.notes[0]
    assert replayed.notes[-1].endswith("repeated to the bit")


def test_a_full_disk_degrades_the_health_and_not_the_pose(recorded: Robot, tmp_path: Path) -> None:
    limit = 60_000
    process = drd(recorded, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)))
    try:
        recorded.drive()
        told = health(recorded, lambda h: h["recording"]["state"] == "degraded")["recording"]
        assert "File too large" in told["reason"]
        recorded.wait("a valid pose", lambda p: p["validity"] == "valid" and not p["reasons"], 15.0)
        assert health(recorded, lambda h: h["recording"]["lost"] > 0)["validity"] == "valid"
    finally:
        log = end(process)
    assert "failed=File too large" in log
    found = open_mcap(recordings(tmp_path)[0])
    assert found.seconds > 0.5
    assert found.cut_chunk_s is None


def test_the_folder_is_systemds_state_directory_under_systemd(recorded: Robot, tmp_path: Path) -> None:
    text = recorded.file.read_text()
    recorded.file.write_text(text.replace(f"folder: {tmp_path / 'records'}, ", ""))
    process = drd(recorded, env={**os.environ, "STATE_DIRECTORY": str(tmp_path / "state")})
    try:
        recorded.drive()
        told = health(recorded, lambda h: h["recording"]["file"] is not None)["recording"]
    finally:
        end(process)
    assert Path(told["file"]).parent == tmp_path / "state" / "recordings"
