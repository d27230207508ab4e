"""Recordings of other systems, written by their own libraries from a simulated drive."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
from import_data import RADIUS_M
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from drd.arrays import Array
from drd_tools.importing.examine import GyroRates, WheelTravel
from drd_tools.recordings.folder import ReferenceLog

EPOCH_NS = 1_700_000_000_000_000_000
LATE_NS = 20_000_000  # from a message's stamp to its reception
COUNTS = 4000.0
ROBOT = ("--wheel-radius", str(RADIUS_M), "--tread", "0.5")
Drive = tuple[GyroRates, WheelTravel, ReferenceLog]


def stamps_ns(time_s: Array) -> list[int]:
    return [EPOCH_NS + round(t * 1e9) for t in time_s]


class Messages:
    """ROS messages of a drive, as (topic, type, stamp, message), in the order of time."""

    def __init__(self, store: Any, *, ros1: bool, zero_stamps: bool = False):
        self.store, self.ros1, self.zero_stamps = store, ros1, zero_stamps

    def make(self, kind: str, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def header(self, stamp_ns: int) -> Any:
        stamp_ns = 0 if self.zero_stamps else stamp_ns
        stamp = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        extra = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="", **extra)

    def vector(self, x: float, y: float, z: float) -> Any:
        return self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def pose(self, x: float, y: float, heading: float) -> Any:
        point = self.make("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
        z, w = math.sin(heading / 2), math.cos(heading / 2)
        turn = self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=z, w=w)
        return self.make("geometry_msgs/msg/Pose", position=point, orientation=turn)

    def imu(self, t_ns: int, rate: Array, force: Array | None) -> Any:
        nine = np.zeros(9)
        no_force = np.array([-1.0, *[0.0] * 8])
        return self.make(
            "sensor_msgs/msg/Imu",
            header=self.header(t_ns),
            orientation=self.pose(0.0, 0.0, 0.0).orientation,
            orientation_covariance=nine,
            angular_velocity=self.vector(*rate.tolist()),
            angular_velocity_covariance=nine,
            linear_acceleration=self.vector(*(force.tolist() if force is not None else (0.0, 0.0, 0.0))),
            linear_acceleration_covariance=nine if force is not None else no_force,
        )

    def odometry(self, t_ns: int, pose: Any, speed: float, rate: float) -> Any:
        with_pose = self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))
        twist = self.make("geometry_msgs/msg/Twist", linear=self.vector(speed, 0.0, 0.0),
                          angular=self.vector(0.0, 0.0, rate))  # fmt: skip
        with_twist = self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
        return self.make("nav_msgs/msg/Odometry", header=self.header(t_ns), child_frame_id="base_link",
                         pose=with_pose, twist=with_twist)  # fmt: skip

    def joints(self, t_ns: int, left: float, right: float, *, speeds: bool = False) -> Any:
        values, none = np.array([left, right]), np.zeros(0)
        return self.make(
            "sensor_msgs/msg/JointState",
            header=self.header(t_ns),
            name=["wheel_left", "wheel_right"],
            position=none if speeds else values,
            velocity=values if speeds else none,
            effort=none,
        )

    def all(self, drive: Drive) -> Iterator[tuple[str, int, Any]]:
        """Topics: imu, joints, odom (of the wheels), left and right (Int16 counts that wrap), truth."""
        gyro, wheels, poses = drive
        force = gyro.acceleration_m_s2
        for k, t_ns in enumerate(stamps_ns(gyro.time_s)):
            yield "/imu", t_ns, self.imu(t_ns, gyro.rate_rad_s[k], None if force is None else force[k])
        step_s = np.diff(wheels.time_s, prepend=wheels.time_s[0] - 0.05)
        speed = np.diff(0.5 * (wheels.left_m + wheels.right_m), prepend=0.0) / step_s
        turned = (wheels.right_m - wheels.left_m) / wheels.tread_m
        rate = np.diff(turned, prepend=0.0) / step_s
        middle = turned - 0.5 * rate * step_s
        # Arcs, as exact odometry adds them up.
        chord = speed * step_s * np.sinc(rate * step_s / (2.0 * np.pi))
        x_m, y_m = np.cumsum(chord * np.cos(middle)), np.cumsum(chord * np.sin(middle))
        for k, t_ns in enumerate(stamps_ns(wheels.time_s)):
            left, right = wheels.left_m[k] / RADIUS_M, wheels.right_m[k] / RADIUS_M
            yield "/joints", t_ns, self.joints(t_ns, left, right)
            yield "/odom", t_ns, self.odometry(t_ns, self.pose(x_m[k], y_m[k], turned[k]), speed[k], rate[k])
            for topic, angle, skew_ns in (("/left", left, 0), ("/right", right, 3_000_000)):
                count = round(angle * COUNTS / (2.0 * math.pi))
                wrapped = (count + 2**15) % 2**16 - 2**15
                yield topic, t_ns + skew_ns, self.make("std_msgs/msg/Int16", data=wrapped)
        for k, t_ns in enumerate(stamps_ns(poses.time_s)):
            pose = self.pose(poses.x_m[k], poses.y_m[k], poses.heading_rad[k])
            yield "/truth", t_ns, self.make("geometry_msgs/msg/PoseStamped", header=self.header(t_ns), pose=pose)


def write_bag(path: Path, drive: Drive, *, zero_stamps: bool = False) -> Path:
    """Write a bag chosen by its name: .bag of ROS 1, otherwise a folder of ROS 2, as MCAP with mcap in the name."""
    ros1 = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if "mcap" in path.name else StoragePlugin.SQLITE3
    writer = Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    rows = sorted(Messages(store, ros1=ros1, zero_stamps=zero_stamps).all(drive), key=lambda row: row[1])
    with writer:
        connections: dict[str, Any] = {}
        for topic, t_ns, message in rows:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], t_ns + LATE_NS, serialize(message, kind))
    return path


def write_frames(path: Path, wheels: WheelTravel) -> Path:
    """Write AgileX odometer frames (0x311, mm) in python-can's format for the file's name, with a foreign one."""
    with can.Logger(path) as log:
        if isinstance(log, can.SqliteWriter):
            log.MAX_BUFFER_SIZE_BEFORE_WRITES = 1_000_000  # it loses data beyond one such buffer at the end
        for t_ns, left, right in zip(stamps_ns(wheels.time_s), wheels.left_m, wheels.right_m, strict=True):
            data = b"".join(round(side * 1e3).to_bytes(4, "big", signed=True) for side in (left, right))
            for can_id, content in ((0x311, data), (0x221, b"\1\2")):
                log.on_message_received(
                    can.Message(
                        timestamp=t_ns * 1e-9, arbitration_id=can_id, data=content, is_extended_id=False, channel=0
                    )
                )
    return path


def write_table(path: Path, columns: dict[str, Array]) -> Path:
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, "%.12g", ",", header=",".join(columns), comments="")
    return path
