"""The running daemon remembers: over SIGTERM, SIGKILL, a file that cannot be used, a folder that is none."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from harness import Robot

from drd.state.saved import decoded

pytestmark = pytest.mark.process


class Watched(Robot):
    """A robot that is listened to over several lives of its daemon."""

    def leave(self) -> None:
        self._session.close()
        self._session = None


class Daemon:
    """One life of the daemon, with a state directory as systemd gives it."""

    def __init__(self, robot: Watched, folder: Path | None):
        environment = {k: v for k, v in os.environ.items() if k != "STATE_DIRECTORY"}
        if folder is not None:
            environment["STATE_DIRECTORY"] = str(folder)
        command = [sys.executable, "-W", "error", "-m", "drd", "run", str(robot.file)]
        self._process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
        self._robot = robot
        robot.poses.clear()
        robot.drive()

    def health(self) -> dict[str, Any]:
        return self._robot.get("health")

    def end(self, number: int = signal.SIGTERM) -> str:
        """Its log."""
        self._process.send_signal(number)
        _, log = self._process.communicate(timeout=15.0)
        assert self._process.returncode == (0 if number == signal.SIGTERM else -number), log
        self._robot.leave()
        return log


def made(folder: Path, stand_s: float) -> Iterator[Watched]:
    robot = Watched(folder, stand_s=stand_s)
    robot.emulator.plug_in()
    try:
        yield robot
    finally:
        robot.close()


@pytest.fixture
def standing(tmp_path: Path) -> Iterator[Watched]:
    yield from made(tmp_path, 1000.0)


@pytest.fixture
def driving(tmp_path: Path) -> Iterator[Watched]:
    yield from made(tmp_path, 2.0)


def is_valid(pose: dict[str, Any]) -> bool:
    return bool(pose["validity"] == "valid")


def test_a_standing_robot_goes_on_where_it_stood_with_what_it_has_learned(standing: Watched, tmp_path: Path) -> None:
    folder = tmp_path / "state"
    daemon = Daemon(standing, folder)
    standing.wait("a valid pose", is_valid)
    standing.get("set_pose", {"x_m": 100.0, "y_m": -50.0, "heading_rad": 1.0})
    before = daemon.health()
    assert before["state"]["start"] == {"kind": "cold", "off_s": None, "text": "cold start, no state yet"}
    daemon.end()
    saved = decoded((folder / "test.state").read_bytes())
    assert saved.estimate.at_rest
    assert saved.robot == "test"
    daemon = Daemon(standing, folder)
    pose = standing.wait("a pose", lambda p: "encoders" not in {r["source"] for r in p["reasons"]})
    assert (pose["x_m"], pose["y_m"]) == pytest.approx((100.0, -50.0), abs=1e-6)
    assert pose["heading_rad"] == pytest.approx(1.0, abs=1e-6)
    assert pose["validity"] == "degraded"  # the bias is measured anew, but it is known well enough to go on with
    xx = pose["covariance_m_rad"][0][0]
    assert 0.04 <= xx < 0.042  # state.position_m, and what a robot may move before its wheels' lag is known
    told = daemon.health()["state"]
    assert told["start"]["kind"] == "warm"
    assert 0.0 < told["start"]["off_s"] < 20.0
    standing.wait("a valid pose", is_valid)
    log = daemon.end()
    assert "start=warm restart after" in log
    assert "where it stood, 0.2 m and 5 deg less certain" in log


def test_a_daemon_that_is_killed_on_the_move_does_not_claim_to_know_where_it_is(
    driving: Watched, tmp_path: Path
) -> None:
    driving.file.write_text(driving.file.read_text() + "state: {period_s: 1}\n")
    daemon = Daemon(driving, tmp_path / "state")
    driving.wait("a moving robot", lambda p: is_valid(p) and p["speed_m_s"] > 0.5, 25.0)
    time.sleep(1.5)
    last = driving.poses[-1]
    daemon.end(signal.SIGKILL)
    daemon = Daemon(driving, tmp_path / "state")
    pose = driving.wait("a pose", lambda p: "encoders" not in {r["source"] for r in p["reasons"]}, 10.0)
    text = daemon.health()["state"]["start"]["text"]
    assert "last seen, moving" in text
    unseen_m = 1.5 * (pose["monotonic_ns"] - last["monotonic_ns"]) * 1e-9 + 1.5
    assert abs(pose["x_m"] - last["x_m"]) < unseen_m
    assert pose["position_bound_99_m"] > unseen_m
    daemon.end()


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"drd-state/2 sha256=" + b"0" * 64 + b"\n{}", "its checksum is wrong: it was cut or changed"),
        (b"drd-state/9 sha256=" + b"0" * 64 + b"\n{}", "version 9; this drd reads version 2"),
    ],
    ids=["corrupt", "future"],
)
def test_a_file_that_cannot_be_used_is_kept_aside_and_told(
    standing: Watched, tmp_path: Path, content: bytes, text: str
) -> None:
    folder = tmp_path / "state"
    folder.mkdir()
    (folder / "test.state").write_bytes(content)
    daemon = Daemon(standing, folder)
    standing.wait("a valid pose", is_valid)
    told = daemon.health()["state"]
    assert told["start"]["kind"] == "cold"
    assert text in told["start"]["text"]
    assert told["refused"] == 1
    log = daemon.end()
    assert f"WARNING drd.state.keeper start=cold start, the state was refused: {folder / 'test.state'}: {text}" in log
    assert (folder / "test.state.refused-1").read_bytes() == content
    assert decoded((folder / "test.state").read_bytes()).robot == "test"


def test_a_folder_that_cannot_be_made_is_told_and_harms_nothing(standing: Watched, tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    daemon = Daemon(standing, blocked / "state")
    standing.wait("a valid pose", is_valid)
    deadline = time.monotonic() + 10.0
    while not (told := daemon.health())["state"]["trouble"]:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert told["validity"] == "valid"
    assert "Not a directory" in told["state"]["trouble"]
    assert told["state"]["written"] == 0
    daemon.end()


def test_without_a_folder_all_is_as_ever(standing: Watched, tmp_path: Path) -> None:
    before = set(tmp_path.rglob("*"))
    daemon = Daemon(standing, None)
    standing.wait("a valid pose", is_valid)
    assert daemon.health()["state"] is None
    assert "start=" not in daemon.end()
    assert {f for f in tmp_path.rglob("*") if f.suffix == ".state"} == set()
    assert set(tmp_path.rglob("*")) == before
