"""The daemon as a process of its own, seen from other processes."""

import json
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

import numpy as np
import pytest
import zenoh
from harness import Robot, farthest_m
from rosbags.typesys import Stores, get_typestore

from drd.output.session import isolated_config

pytestmark = pytest.mark.process

SUBSCRIBER = """\
import json, sys, time, zenoh
from drd.output.session import isolated_config
with zenoh.open(isolated_config("client", (), (sys.argv[1],))) as session:
    poses = session.declare_subscriber("drd/pose", zenoh.handlers.FifoChannel(1000))
    time.sleep(3.0)
    heard = []
    while (sample := poses.try_recv()) is not None:
        heard.append(json.loads(sample.payload.to_bytes()))
print(json.dumps(heard))
"""


def drd(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-W", "error", "-m", "drd", *map(str, arguments)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **options)


def end(process: subprocess.Popen[str]) -> tuple[int, str]:
    process.send_signal(signal.SIGTERM)
    _, log = process.communicate(timeout=15.0)
    return process.returncode, log


@pytest.fixture
def process(robot: Robot) -> Iterator[subprocess.Popen[str]]:
    robot.emulator.plug_in()
    process = drd("run", robot.file)
    try:
        robot.drive()
        yield process
    finally:
        code, log = end(process)
    assert code == 0, log


@pytest.fixture
def served(robot: Robot, process: subprocess.Popen[str]) -> Robot:
    assert process.poll() is None
    return robot


def test_another_process_receives_twenty_poses_a_second(served: Robot) -> None:
    served.wait("a valid pose", lambda p: p["validity"] == "valid")
    out = subprocess.run(
        [sys.executable, "-c", SUBSCRIBER, served.endpoint], capture_output=True, text=True, check=True, timeout=30
    )
    poses = json.loads(out.stdout)
    numbers = [p["sequence"] for p in poses]
    assert numbers == list(range(numbers[0], numbers[0] + len(poses)))
    intervals_s = np.diff([p["monotonic_ns"] for p in poses]) * 1e-9
    assert intervals_s.sum() > 2.0
    # The median: on a busy machine the emulated robot may stall.
    assert np.median(intervals_s) == pytest.approx(0.05, rel=0.05)


def test_samples_that_waited_for_a_stalled_host_are_all_used(robot: Robot, process: subprocess.Popen[str]) -> None:
    robot.wait("a moving robot", lambda p: p["validity"] == "valid" and p["speed_m_s"] > 0.5, 15.0)
    before = robot.get("health")["counters"]["estimator"]
    for _ in range(3):
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.8)
        process.send_signal(signal.SIGCONT)
        time.sleep(0.5)
    after = robot.get("health")["counters"]["estimator"]
    assert after["poses"] > before["poses"] + 60
    unused = ("late_gyro", "late_wheels", "gyro_gaps", "wheel_gaps")
    assert {name: after[name] - before[name] for name in unused} == dict.fromkeys(unused, 0)


def test_pose_odom_and_queries_agree(served: Robot) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with zenoh.open(isolated_config("client", (), (served.endpoint,))) as session:
        odom = session.declare_subscriber("drd/odom", zenoh.handlers.FifoChannel(1000))
        served.wait("a moving robot", lambda p: p["validity"] == "valid" and p["speed_m_s"] > 0.5, 15.0)
        raw = odom.recv().payload.to_bytes()
        while (sample := odom.try_recv()) is not None:
            raw = sample.payload.to_bytes()
        message: Any = store.deserialize_cdr(raw, "nav_msgs/msg/Odometry")
    stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
    time.sleep(0.2)
    pose = next(p for p in served.poses if p["wall_ns"] == stamp_ns)
    assert (message.pose.pose.position.x, message.pose.pose.position.y) == (pose["x_m"], pose["y_m"])
    assert message.twist.twist.linear.x == pose["speed_m_s"]
    assert message.pose.covariance[0] == pose["covariance_m_rad"][0][0]
    latest = served.get("pose")
    assert latest["sequence"] >= pose["sequence"]
    health = served.get("health")
    assert health["robot"] == "test"
    assert health["counters"]["estimator"]["accepted"] > 0
    assert health["latency_max_ms"] > 0
    assert health["wheel_rate_hz"] == pytest.approx(20.0, rel=0.15)
    assert health["fog_rate_hz"] == pytest.approx(10.0, rel=0.05)
    config = served.get("config")
    assert config["config"]["robot"]["tread_m"] == 0.6
    assert config["origins"]["robot.tread_m"].endswith("robot.yaml:1")
    assert config["origins"]["fog.baud"] == "default"


def test_commands_change_the_pose_and_bad_ones_are_refused(served: Robot) -> None:
    served.wait("a valid pose", lambda p: p["validity"] == "valid")
    assert served.get("set_pose", {"x_m": 100.0, "y_m": -50.0, "heading_rad": 1.0, "sigma_m": 0.1}) == {
        "x_m": 100.0, "y_m": -50.0, "heading_rad": 1.0, "sigma_m": 0.1, "sigma_rad": 0.0}  # fmt: skip
    pose = served.wait("the new pose", lambda p: abs(p["x_m"] - 100.0) < 10.0)
    assert pose["position_bound_99_m"] > 0.2
    bad: list[tuple[dict[str, Any], str]] = [
        ({"x_m": 1.0}, "y_m"),
        ({"x_m": "1", "y_m": 0, "heading_rad": 0}, "x_m"),
        ({"x_m": 1, "y_m": 0, "heading_rad": 0, "sigma_m": -1}, "sigma_m"),
        ({"x_m": 1, "y_m": 0, "heading_rad": 0, "z_m": 1}, "z_m"),
    ]
    for request, text in bad:
        assert text in served.get("set_pose", request)["error"]
    assert served.get("reset") == {"reset": True}
    served.wait("the origin", lambda p: abs(p["x_m"]) < 10.0)
    answer = served.get("calibrate_bias")
    assert "measuring_s" in answer or "standstill" in answer["error"]


def test_systemd_hears_ready_status_watchdog_and_stopping(robot: Robot, tmp_path: Path) -> None:
    address = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as inbox:
        inbox.bind(str(address))
        inbox.settimeout(15.0)
        robot.emulator.start()
        environment = {**os.environ, "NOTIFY_SOCKET": str(address), "WATCHDOG_USEC": "1000000"}
        process = drd("run", robot.file, env=environment)
        heard = inbox.recv(4096).decode()
        while "READY=1" not in heard:
            heard = inbox.recv(4096).decode()
        assert "STATUS=" in heard
        stamps: list[float] = []
        while len(stamps) < 4:
            if "WATCHDOG=1" in inbox.recv(4096).decode():
                stamps.append(time.monotonic())
        assert stamps[-1] - stamps[0] < 3.0
        code, log = end(process)
        assert code == 0, log
        rest = b""
        inbox.setblocking(False)
        while b"STOPPING=1" not in rest:
            rest = inbox.recv(4096)


def test_a_bad_configuration_stops_the_start_with_the_keys_path(robot: Robot) -> None:
    robot.file.write_text(robot.file.read_text().replace("tread_m: 0.6", "tread_m: -1"))
    process = drd("run", robot.file)
    _, log = process.communicate(timeout=15.0)
    assert process.returncode == 2
    assert "robot.yaml:1: robot.tread_m: expected a number in m from 0.02 to 20, got '-1'" in log


def test_a_taken_end_point_stops_the_start_and_names_the_key(robot: Robot) -> None:
    host, port = robot.endpoint.removeprefix("tcp/").split(":")
    with socket.socket() as taken:
        taken.bind((host, int(port)))
        taken.listen()
        process = drd("run", robot.file)
        _, log = process.communicate(timeout=20.0)
    assert process.returncode == 2
    assert "output.listen" in log


def test_without_any_hardware_the_daemon_runs_says_so_and_ends_at_once(robot: Robot) -> None:
    process = drd("run", robot.file)
    try:
        robot.listen()
        pose = robot.wait("a pose without sensors", lambda p: len(p["reasons"]) >= 3)
        assert pose["validity"] == "initialising"
        assert {"fog.port", "encoders.port"} <= {r["source"] for r in pose["reasons"]}
    finally:
        began = time.monotonic()
        code, log = end(process)
    assert code == 0, log
    assert time.monotonic() - began < 6.0


def test_a_process_that_stood_still_for_seconds_loses_nothing_and_does_not_jump(robot: Robot) -> None:
    robot.emulator.plug_in()
    process = drd("run", robot.file)
    try:
        robot.drive()
        robot.wait("a moving robot", lambda p: p["validity"] == "valid" and p["speed_m_s"] > 1.0, 20.0)
        stalls_s = (0.4, 1.0, 2.5)
        for stall_s in stalls_s:
            process.send_signal(signal.SIGSTOP)
            time.sleep(stall_s)
            process.send_signal(signal.SIGCONT)
            time.sleep(1.5)
        driven_m = 1.5 * max(stalls_s)  # in the longest one
        pose = robot.wait(
            "a pose that knows where it is",
            lambda p: p["validity"] == "valid" and p["position_bound_99_m"] < driven_m,
        )
        poses = robot.poses.copy()
        assert max(p["speed_m_s"] for p in poses) < 3.0  # it drives 1.5 m/s; stamps scatter on a busy machine
        for a, b in pairwise(poses):
            assert b["monotonic_ns"] >= a["monotonic_ns"]
            assert math.hypot(b["x_m"] - a["x_m"], b["y_m"] - a["y_m"]) <= farthest_m(a, b)
        truth = min(robot.emulator.truth.copy(), key=lambda row: abs(row.t_ns - pose["monotonic_ns"]))
        assert math.hypot(pose["x_m"] - truth.x_m, pose["y_m"] - truth.y_m) < pose["position_bound_99_m"]
    finally:
        process.send_signal(signal.SIGCONT)
        code, log = end(process)
    assert code == 0, log
