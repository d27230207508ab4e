"""SIGHUP on the running, driving daemon: a good configuration is taken up, a bad one refused, and the pose goes on."""

import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from harness import Robot

from drd.estimation.learned_values import LEARNED, NOT_YET, OUTSIDE

pytestmark = pytest.mark.process

# Measured: 0.15 s. The rest is for a machine that is busy with other tests.
LONGEST_PAUSE_S = 2.0


class Served:
    """A driving robot, its daemon as systemd would run it, and what that hears."""

    def __init__(self, folder: Path):
        self.robot = Robot(folder)
        self.inbox = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.inbox.bind(str(folder / "notify"))
        self.inbox.setblocking(False)
        self.heard = ""
        self.robot.emulator.plug_in()
        environment = {**os.environ, "NOTIFY_SOCKET": str(folder / "notify")}
        command = [sys.executable, "-W", "error", "-m", "drd", "run", str(self.robot.file)]
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment
        )
        self.robot.drive()

    def rewrite(self, old: str, new: str) -> None:
        text = self.robot.file.read_text()
        assert old in text
        self.robot.file.write_text(text.replace(old, new))

    def reload(self) -> dict[str, Any]:
        """Ask for it as the unit does; the health once it is through."""
        before = self.robot.get("health")["reload"]
        self.listen_to_systemd()
        self.heard = ""
        self.process.send_signal(signal.SIGHUP)
        deadline = time.monotonic() + 10.0
        while True:
            health = self.robot.get("health")
            now = health["reload"]
            if now["done"] + now["refused"] > before["done"] + before["refused"]:
                break
            assert time.monotonic() < deadline
            time.sleep(0.02)
        time.sleep(0.1)
        self.listen_to_systemd()
        return health

    def listen_to_systemd(self) -> None:
        try:
            while True:
                self.heard += self.inbox.recv(4096).decode() + "\n"
        except BlockingIOError:
            pass

    def moving(self) -> None:
        self.robot.wait("a moving robot", lambda p: p["validity"] == "valid" and p["speed_m_s"] > 0.5, 25.0)

    def assert_continuous(self) -> None:
        """No pose is missing, none jumps, and none comes late."""
        poses = self.robot.poses.copy()
        assert [p["sequence"] for p in poses] == list(range(poses[0]["sequence"], poses[0]["sequence"] + len(poses)))
        for a, b in pairwise(poses):
            dt_s = (b["monotonic_ns"] - a["monotonic_ns"]) * 1e-9
            assert 0.0 <= dt_s < LONGEST_PAUSE_S
            # Where a busy machine opens the ports late, the pose stands, degraded, until the wheels tell the way; it
            # may also read a frame later by the frames' period.
            silent = "encoders" in {r["source"] for r in a["reasons"]}
            allowed_m = a["position_bound_99_m"] if silent else 2.0 * (max(dt_s, 0.05) + 0.05) + 0.03
            assert math.hypot(b["x_m"] - a["x_m"], b["y_m"] - a["y_m"]) < allowed_m
            assert abs(b["heading_rad"] - a["heading_rad"]) < 1.5 * dt_s + 0.05

    def error_m(self) -> float:
        pose = self.robot.poses[-1]
        truth = min(self.robot.emulator.truth.copy(), key=lambda row: abs(row.t_ns - pose["monotonic_ns"]))
        return math.hypot(pose["x_m"] - truth.x_m, pose["y_m"] - truth.y_m)


def test_the_unit_asks_for_a_reload_and_tells_the_boot() -> None:
    unit = (Path(__file__).parents[2] / "systemd" / "drd@.service").read_text().splitlines()
    assert "ExecReload=/bin/sh -c 'kill -HUP $MAINPID'" in unit
    assert "Environment=DRD_BOOT_ID=%b" in unit


def test_a_terminal_that_is_closed_ends_it_as_ever(robot: Robot) -> None:
    master, slave = os.openpty()
    command = [sys.executable, "-m", "drd", "run", str(robot.file)]
    # Tests that run under nohup would hand down that the signal is ignored.
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    process = subprocess.Popen(command, stdin=slave, stderr=subprocess.DEVNULL)
    signal.signal(signal.SIGHUP, before)
    try:
        robot.listen()
        process.send_signal(signal.SIGHUP)
        assert process.wait(10.0) == -signal.SIGHUP
    finally:
        process.kill()
        process.wait(10.0)
        os.close(master)
        os.close(slave)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One daemon for all: each test asks it for another configuration, while the robot drives on."""
    made = Served(tmp_path_factory.mktemp("served"))
    try:
        yield made
    finally:
        made.process.send_signal(signal.SIGTERM)
        _, log = made.process.communicate(timeout=15.0)
        made.robot.close()
        made.inbox.close()
        assert made.process.returncode == 0, log


def test_a_good_configuration_is_taken_up_and_the_pose_goes_on(served: Served) -> None:
    served.moving()
    before = served.robot.get("health")
    assert before["reload"] == {"done": 0, "refused": 0, "error": None, "waiting": []}
    served.rewrite("estimation: {", "estimation: {gate_sigma: 6, ")
    served.rewrite("output: {commands: true,", "output: {commands: false, health_period_s: 0.5,")
    health = served.reload()
    assert health["reload"] == {"done": 1, "refused": 0, "error": None, "waiting": ["output.commands"]}
    assert "RELOADING=1\nMONOTONIC_USEC=" in served.heard
    assert served.heard.index("READY=1") > served.heard.index("RELOADING=1")
    assert "restart for output.commands" in served.heard
    config = served.robot.get("config")
    assert config["config"]["estimation"]["gate_sigma"] == 6
    assert config["config"]["output"]["health_period_s"] == 0.5
    assert config["config"]["output"]["commands"] is True  # in force: what was set up at the start
    # Ports and decoding were not touched, and no pose was left out.
    for part in ("fog.port", "encoders.port"):
        assert health["counters"][part]["opens"] == 1
    assert health["counters"]["encoders"]["samples"] >= before["counters"]["encoders"]["samples"]
    assert health["counters"]["estimator"]["poses"] >= before["counters"]["estimator"]["poses"]
    time.sleep(1.0)
    served.robot.wait("a valid pose", lambda p: p["validity"] == "valid")
    served.assert_continuous()
    assert served.error_m() < served.robot.poses[-1]["position_bound_99_m"]


BAD = {
    ("tread_m: 0.6", "tread_m: -1"): "robot.yaml:1: robot.tread_m: expected a number in m from 0.02 to 20, got '-1'",
    ("realtime:", "calibration: {file: none.yaml}\nrealtime:"): ": calibration.file: expected a readable YAML file",
    ("realtime:", "model: {file: none.yaml}\nrealtime:"): "model.file: expected a readable YAML file",
    ("robot:", "robott:"): "robot.yaml:1: robott: expected one of robot, fog",
    ("output: {", "output: {prefix: 'a//b', "): "output.prefix: expected a Zenoh key",
    ("output: {", "output: {zenoh_config: none.json5, "): ": output.zenoh_config: expected a Zenoh configuration file",
    ("modulus_counts: 65536", "modulus_counts: 4"): ": encoders.modulus_counts: expected more than",
}


def test_a_bad_configuration_is_refused_named_and_changes_nothing(served: Served) -> None:
    served.moving()
    before, done = served.robot.get("config"), served.robot.get("health")["reload"]["done"]
    good = served.robot.file.read_text()
    for i, ((old, new), text) in enumerate(BAD.items()):
        served.robot.file.write_text(good)
        served.rewrite(old, new)
        health = served.reload()
        assert health["reload"]["refused"] == i + 1
        assert text in health["reload"]["error"]
        assert "reload refused: " in served.heard
        assert "READY=1" in served.heard
        assert served.robot.get("config") == before
        assert health["validity"] == "valid"
    # The next good one ends the report.
    served.robot.file.write_text(good)
    again = served.reload()["reload"]
    assert (again["done"], again["refused"], again["error"]) == (done + 1, len(BAD), None)
    served.assert_continuous()


def test_ports_whose_section_changed_are_opened_anew_and_no_pose_jumps(served: Served) -> None:
    served.moving()
    before, done = served.robot.get("health")["learned"], served.robot.get("health")["reload"]["done"]
    served.rewrite("encoders: {", "encoders: {silent_after_s: 0.4, ")
    health = served.reload()
    assert health["reload"]["done"] == done + 1
    served.robot.wait("a valid pose", lambda p: p["validity"] == "valid")
    time.sleep(1.0)
    served.assert_continuous()
    assert served.error_m() < served.robot.poses[-1]["position_bound_99_m"]
    after = served.robot.get("health")
    assert after["counters"]["encoders.port"]["opens"] == 1
    assert after["learned"]["gyro_bias_rad_s"]["sigma"] < 1.5 * before["gyro_bias_rad_s"]["sigma"]


def test_another_geometry_goes_on_from_the_same_pose_and_learns_anew(served: Served) -> None:
    served.moving()
    served.rewrite("tread_m: 0.6", "tread_m: 0.63")
    served.reload()
    pose = served.robot.wait("a pose", lambda _: True)
    learned = served.robot.get("health")["learned"]
    assert learned["tread_m"]["sigma"] > 0.5 * 0.02 * 0.63
    assert {value["verdict"] for value in learned.values()} <= {LEARNED, NOT_YET, OUTSIDE}
    assert pose["validity"] in ("valid", "degraded")
    time.sleep(1.0)
    served.assert_continuous()
