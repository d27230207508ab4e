"""`drd ros2` against another node of rclpy, with the middleware that rclpy has; on the loopback only."""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from links import HANDLERS, PATIENCE_S, POSE, a_link, free_endpoint

from drd.output.messages import Refused
from drd.output.ros2 import TYPE_HASHES

rclpy: Any = pytest.importorskip("rclpy", reason="rclpy is not installed; `make ros2-test` brings it")

# Of lark, by which rclpy reads definitions.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

FIRST_NS = 1_700_000_000_000_000_000
PERIOD_NS = 50_000_000
PARAMETERS = "-p connect:={0} -p topics.odom:=wheels/odom -r __ns:=/robot1"
# DDS discovery on a busy machine.
DISCOVERY_S = 60.0


@pytest.fixture(scope="module")
def reader() -> Iterator[Any]:
    """A node beside drd's."""
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        environment.setenv("ROS_DOMAIN_ID", str(random.randrange(1, 101)))
        rclpy.init()
        node = rclpy.create_node("reader")
        yield node
        node.destroy_node()
        rclpy.shutdown()


def kind(module: str, name: str) -> Any:
    """A type of ROS 2, which there is only where there is rclpy."""
    return getattr(import_module(module), name)


@contextlib.contextmanager
def a_node(tmp_path: Path, handlers: Any = HANDLERS) -> Iterator[Any]:
    """The command beside a daemon's link, which it yields."""
    endpoint = free_endpoint()
    with a_link(handlers, commands=True, listen=(endpoint,)) as (link, _):
        command = [sys.executable, "-m", "drd", "ros2", "--ros-args", *PARAMETERS.format(endpoint).split()]
        node = subprocess.Popen(command, env=os.environ | {"ROS_LOG_DIR": str(tmp_path)})
        try:
            yield link
        finally:
            node.send_signal(signal.SIGINT)
            assert node.wait(30.0) == 0


def spin_until(reader: Any, condition: Callable[[], Any], each: Callable[[], None] = lambda: None) -> None:
    deadline = time.monotonic() + DISCOVERY_S
    while not condition():
        assert time.monotonic() < deadline
        each()
        rclpy.spin_once(reader, timeout_sec=0.05)


@pytest.mark.parametrize("name", TYPE_HASHES)
def test_the_hash_of_a_type_is_that_of_the_installed_package(name: str) -> None:
    prefixes = os.environ.get("AMENT_PREFIX_PATH", sys.prefix).split(os.pathsep)
    files = [Path(prefix, "share", name).with_suffix(".json") for prefix in prefixes]
    file = next((file for file in files if file.exists()), None)
    if file is None:
        pytest.skip(f"the package of {name} is not installed")
    [found] = [h["hash_string"] for h in json.loads(file.read_text())["type_hashes"] if h["type_name"] == name]
    assert found == TYPE_HASHES[name]


class Drive:
    """Poses on and on: x counts them, and so does the time."""

    def __init__(self, link: Any):
        self.count = 0
        self._link = link

    def __call__(self) -> None:
        self.count += 1
        pose = replace(POSE, x_m=float(self.count))
        self._link.publish_pose(pose, FIRST_NS + self.count * PERIOD_NS)
        health = {"robot": "carl", "validity": "degraded", "reasons": [], "wall_ns": FIRST_NS}
        self._link.publish_health(health)


def test_another_node_reads_odometry_imu_and_diagnostics(reader: Any, tmp_path: Path) -> None:
    poses: list[Any] = []
    imus: list[Any] = []
    states: list[Any] = []
    reader.create_subscription(kind("nav_msgs.msg", "Odometry"), "/robot1/wheels/odom", poses.append, 10)
    reader.create_subscription(kind("sensor_msgs.msg", "Imu"), "/robot1/imu", imus.append, 10)
    reader.create_subscription(kind("diagnostic_msgs.msg", "DiagnosticArray"), "/diagnostics", states.append, 10)
    with a_node(tmp_path) as link:
        spin_until(reader, lambda: min(map(len, (poses, imus, states))) >= 10, Drive(link))
        [publisher] = reader.get_publishers_info_by_topic("/robot1/wheels/odom")
    assert (publisher.node_name, publisher.node_namespace) == ("drd", "/robot1")
    assert str(publisher.topic_type_hash).startswith("RIHS01_3cc97dc7fb7502f8")
    for message in poses:
        stamp = message.header.stamp
        count = round(message.pose.pose.position.x)
        assert stamp.sec * 10**9 + stamp.nanosec == FIRST_NS + count * PERIOD_NS
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
        assert [message.pose.covariance[i] for i in (0, 7, 14, 35)] == [1.0, 1.0, 1e6, 1.0]
    assert imus[0].angular_velocity.z == POSE.rate_rad_s
    assert imus[0].linear_acceleration_covariance[0] == -1.0
    assert states[0].status[0].message == "degraded"


def test_reset_and_set_pose_reach_the_daemon(reader: Any, tmp_path: Path) -> None:
    heard: list[Any] = []

    def hear(request: dict[str, Any]) -> dict[str, Any]:
        heard.append(request)
        return {}

    def refuse(_: dict[str, Any]) -> dict[str, Any]:
        raise Refused("not now")

    trigger, stamped = kind("std_srvs.srv", "Trigger"), kind("geometry_msgs.msg", "PoseWithCovarianceStamped")
    client = reader.create_client(trigger, "/robot1/reset")
    mover = reader.create_publisher(stamped, "/robot1/set_pose", 10)
    wanted = stamped()
    wanted.pose.pose.position.x, wanted.pose.pose.orientation.w = 5.0, 1.0
    with a_node(tmp_path, HANDLERS | {"set_pose": hear, "reset": refuse}) as link:
        spin_until(reader, client.service_is_ready)
        answers: list[Any] = []
        for _ in range(10):  # DDS may lose an answer to a client that its server has not yet found
            future = client.call_async(trigger.Request())
            rclpy.spin_until_future_complete(reader, future, timeout_sec=DISCOVERY_S / 10)
            if future.done():
                answers.append(future.result())
                break
        assert [(answer.success, answer.message) for answer in answers] == [(False, "not now")]
        drive = Drive(link)

        def move() -> None:
            drive()  # the node takes no pose before it knows the daemon's frame
            mover.publish(wanted)

        spin_until(reader, lambda: heard, move)
    assert heard[0] == {"x_m": 5.0, "y_m": 0.0, "heading_rad": 0.0, "sigma_m": 0.0, "sigma_rad": 0.0}


@pytest.mark.parametrize("arguments", ["-p topics.tf:=5", "-p topics.odom:=2odom", "-p", "--wrong", "-r __ns:=//"])
def test_arguments_that_ros_2_would_not_take_are_bad_usage(arguments: str) -> None:
    command = [sys.executable, "-m", "drd", "ros2", "--ros-args", *arguments.split()]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S * 3)
    assert result.returncode == 2
    assert result.stderr.splitlines()[-1].startswith("drd ros2: ")
