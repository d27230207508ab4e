"""The daemon as a node of ROS 2, through rmw_zenoh: its publishers and services."""

from collections.abc import Mapping
from typing import Any

import zenoh

from drd.config.keys import Output
from drd.output.cdr import ImuEncoder, JointStateEncoder, TransformEncoder, encode_diagnostics
from drd.output.diagnostics import diagnostics
from drd.output.forms import Form, SetPoseService, TriggerService
from drd.output.ros2 import Ros2Node, attachment, in_namespace, topic_name
from drd.samples import Pose, WheelTurns

ODOMETRY = "nav_msgs/msg/Odometry"


class _Publisher:
    """One topic; `put` counts and attaches what rmw_zenoh demands. Raises zenoh.ZError."""

    def __init__(self, session: Any, node: Ros2Node, topic: str, type_name: str, how: Mapping[str, Any]):
        endpoint = node.publisher(topic, type_name)
        encoding = zenoh.Encoding.APPLICATION_CDR.with_schema(type_name)
        self._publisher = session.declare_publisher(endpoint.key, encoding=encoding, **how)
        self._gid = endpoint.gid
        self.sequence = 0

    def put(self, payload: bytes, wall_ns: int) -> None:
        self.sequence += 1
        self._publisher.put(payload, attachment=attachment(self.sequence, wall_ns, self._gid))


class Ros2Publishers:
    """Declares the publishers of `output`. Each method raises zenoh.ZError.

    None waits for a slow reader; neither does the pose. Where `output.zenoh_config` keeps Zenoh's default queues, they
    hold two express messages per priority, and a third in the burst of one pose would be dropped on a busy machine: so
    the odometry has a priority of its own, below pose and odometry of `drd`, and the others go in Zenoh's batches, like
    its usual data.
    """

    def __init__(self, session: Any, output: Output):
        odometry = topic_name(output.ros2_topic)
        assert odometry is not None  # open_session has checked it
        namespace, topics = odometry.rpartition("/")[0], output.ros2_topics
        node = Ros2Node(output.ros2_domain, namespace, output.ros2_hash, str(session.zid()))
        usual: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.DROP}
        swift = usual | {"priority": zenoh.Priority.INTERACTIVE_HIGH, "express": True}

        def publisher(topic: str | None, type_name: str) -> _Publisher | None:
            if topic is None:
                return None
            return _Publisher(session, node, in_namespace(namespace, topic), type_name, usual)

        self.odometry = _Publisher(session, node, odometry, ODOMETRY, swift)
        self._tf = publisher(topics.tf, "tf2_msgs/msg/TFMessage")
        self._imu = publisher(topics.imu, "sensor_msgs/msg/Imu")
        self._diagnostics = publisher(topics.diagnostics, "diagnostic_msgs/msg/DiagnosticArray")
        joint_states = topics.joint_states if output.ros2_joints else None
        self._joints = publisher(joint_states, "sensor_msgs/msg/JointState")
        self._tf_encoder = TransformEncoder(output.frame_id, output.child_frame_id)
        self._imu_encoder = ImuEncoder(output.child_frame_id)
        self._joint_encoder = JointStateEncoder(output.ros2_joints)
        self._joints_ns = 0
        self.services: list[Form] = []
        if output.commands:
            name, type_name = in_namespace(namespace, "set_pose"), "robot_localization/srv/SetPose"
            self.services.append(SetPoseService("set_pose", node.service(name, type_name).key, output.frame_id))
            name, type_name = in_namespace(namespace, "reset"), "std_srvs/srv/Trigger"
            self.services.append(TriggerService("reset", node.service(name, type_name).key))
        self.tokens = node.tokens

    @property
    def wants_turns(self) -> bool:
        """Whether joint states are published."""
        return self._joints is not None

    def publish_pose(self, pose: Pose, odometry: bytes, wall_ns: int) -> None:
        """Publish the pose in all its forms; `odometry` is the pose as CDR."""
        self.odometry.put(odometry, wall_ns)
        if self._tf is not None:
            self._tf.put(self._tf_encoder.encode(pose, wall_ns), wall_ns)
        if self._imu is not None:
            self._imu.put(self._imu_encoder.encode(pose, wall_ns), wall_ns)

    def publish_turns(self, turns: WheelTurns, wall_ns: int) -> None:
        """Publish the wheels' turns, once per wheel sample; `wall_ns` is CLOCK_REALTIME at `turns.t_ns`."""
        if self._joints is None or turns.t_ns == self._joints_ns:
            return
        self._joints_ns = turns.t_ns
        positions, velocities = (turns.left_rad, turns.right_rad), (turns.left_rad_s, turns.right_rad_s)
        self._joints.put(self._joint_encoder.encode(positions, velocities, wall_ns), wall_ns)

    def publish_health(self, health: Mapping[str, Any]) -> None:
        """Publish the health as diagnostics."""
        if self._diagnostics is not None:
            wall_ns = health["wall_ns"]
            self._diagnostics.put(encode_diagnostics(diagnostics(health), wall_ns), wall_ns)
