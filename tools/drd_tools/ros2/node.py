"""The node: subscribes to the daemon over Zenoh, publishes through rclpy, and passes commands on."""

import json
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import zenoh
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.serialization import serialize_message

from drd.output.ask import ask
from drd.output.forms import pose_request
from drd.output.messages import Refused
from drd.output.session import isolated_config
from drd_tools.ros2.messages import Messages

__all__ = ["BAD_ARGUMENTS", "DrdNode", "ExternalShutdownException"]

# Exceptions of rclpy for unusable --ros-args; rcl's own error is a RuntimeError.
BAD_ARGUMENTS: Final = (RuntimeError, NameValidationException, ParameterException)

# As ROS 2 knows the types; those that an installation may lack come with the package that has them.
TYPES: Final = {
    "odom": ("nav_msgs", "msg", "Odometry"),
    "tf": ("tf2_msgs", "msg", "TFMessage"),
    "imu": ("sensor_msgs", "msg", "Imu"),
    "diagnostics": ("diagnostic_msgs", "msg", "DiagnosticArray"),
}
TOPICS: Final = {"odom": "odom", "tf": "/tf", "imu": "imu", "diagnostics": "/diagnostics"}
# As tf2's own broadcaster; the others take the last message only.
DEPTHS: Final = {"tf": 100}
DEPTH: Final = 10


class DrdNode(Node):  # type: ignore[misc]  # rclpy has no types here
    """A node of ROS 2 by the name of drd. Call `connect` once and `close` at the end.

    Parameters: `connect` (Zenoh endpoint of the daemon), `zenoh_config` (a file instead), `prefix` (the daemon's
    output.prefix), `frame_id` and `child_frame_id` (empty: the daemon's), `topics.odom`, `.tf`, `.imu` and
    `.diagnostics` (empty: not published). Services set_pose and reset, and the topic set_pose, are passed on; the
    daemon refuses them unless its output.commands is true.
    """

    def __init__(self) -> None:
        super().__init__("drd")
        self._messages = Messages(self._text("frame_id", ""), self._text("child_frame_id", ""))
        self._prefix = self._text("prefix", "drd")
        self._session: Any = None
        self._topics = {name: self._text(f"topics.{name}", topic) for name, topic in TOPICS.items()}
        self._ros_publishers = {name: self._publisher(name, topic) for name, topic in self._topics.items() if topic}
        self._commands()

    def _text(self, name: str, default: str) -> str:
        value: str = self.declare_parameter(name, default).value
        return value

    def _type(self, package: str, folder: str, name: str, use: str) -> Any:
        """Import a type of ROS 2; None, with a line in the log, if its package is not installed."""
        try:
            return getattr(import_module(f"{package}.{folder}"), name)
        except ModuleNotFoundError:
            self.get_logger().warning(f"{package} is not installed: {use} is left out")
            return None

    def _publisher(self, name: str, topic: str) -> Any:
        kind = self._type(*TYPES[name], f"topic {topic}")
        return None if kind is None else self.create_publisher(kind, topic, DEPTHS.get(name, DEPTH))

    def _commands(self) -> None:
        if (trigger := self._type("std_srvs", "srv", "Trigger", "service reset")) is not None:
            self.create_service(trigger, "reset", self._reset)
        if (set_pose := self._type("robot_localization", "srv", "SetPose", "service set_pose")) is not None:
            self.create_service(set_pose, "set_pose", self._set_pose)
        if (pose := self._type("geometry_msgs", "msg", "PoseWithCovarianceStamped", "topic set_pose")) is not None:
            self.create_subscription(pose, "set_pose", self._move, DEPTH, raw=True)

    # ---- to ROS 2 ----------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Open the session and subscribe, even if the daemon is not running yet. Raises zenoh.ZError."""
        file, endpoint = self._text("zenoh_config", ""), self._text("connect", "tcp/127.0.0.1:7447")
        # A peer keeps trying to connect; a client gives up if nobody answers at the start.
        config = zenoh.Config.from_file(Path(file)) if file else isolated_config("peer", (), (endpoint,))
        self._session = zenoh.open(config)
        for key, convert in (("odom", self._messages.of_odometry), ("health", self._messages.of_health)):
            self._session.declare_subscriber(f"{self._prefix}/{key}", self._taker(convert))
        self.get_logger().info(f"connecting to {file or endpoint}, prefix {self._prefix}")

    def _taker(self, convert: Callable[[bytes], Mapping[str, bytes]]) -> Callable[[Any], None]:
        def take(sample: Any) -> None:
            """Publish directly from Zenoh's thread, bypassing the executor."""
            try:
                messages = convert(sample.payload.to_bytes())
            except ValueError as error:
                self.get_logger().error(f"{sample.key_expr}: {error}", throttle_duration_sec=10.0)
                return
            for name, data in messages.items():
                if (publisher := self._ros_publishers.get(name)) is not None:
                    publisher.publish(data)

        return take

    # ---- to the daemon -----------------------------------------------------------------------------------------

    def _reset(self, _: Any, response: Any) -> Any:
        try:
            ask(self._session, f"{self._prefix}/reset")
            response.success = True
        except Refused as error:
            response.success, response.message = False, str(error)
        return response

    def _set_pose(self, request: Any, response: Any) -> Any:
        """Set the pose; log a refusal, since the service's response has no field for it."""
        self._move(serialize_message(request.pose))
        return response

    def _move(self, data: bytes) -> None:
        try:
            if not self._messages.frame_id:
                raise Refused("no odometry from drd yet: its frame is not known")
            request = pose_request(data, self._messages.frame_id)
            ask(self._session, f"{self._prefix}/set_pose", json.dumps(request).encode())
        except Refused as error:
            self.get_logger().error(f"set_pose: {error}")

    def close(self) -> None:
        """Close the session, then the node: nothing comes from Zenoh after this."""
        if self._session is not None:
            self._session.close()
        self.destroy_node()
