"""A ROS 2 bag in one MCAP file, as rosbag2 writes it: profile ros2, CDR, definitions as ros2msg."""

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from drd import __version__
from drd.config.schema import ConfigError
from drd.output.cdr import ImuEncoder, OdometryEncoder, TransformEncoder, encode_diagnostics
from drd.units import S_PER_NS
from drd_tools.export.poses import Exported

ODOM, TF, IMU, DIAGNOSTICS = "/odom", "/tf", "/imu", "/diagnostics"
TYPES: Final = {
    ODOM: "nav_msgs/msg/Odometry",
    TF: "tf2_msgs/msg/TFMessage",
    IMU: "sensor_msgs/msg/Imu",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}


class _Message(NamedTuple):
    topic: str
    stamp_ns: int
    data: bytes


def write_bag(file: Path, exported: Exported) -> dict[str, int]:
    """Write the bag; return the number of messages by topic. Raises OSError, and ConfigError for times below 0."""
    if exported.poses[0].stamp_ns < 0:
        got = f"a recording that begins at {exported.poses[0].stamp_ns * S_PER_NS:g} s"
        raise ConfigError("--ros2", "", "times from 0, as a bag has", got)
    topics = [topic for topic in TYPES if topic != DIAGNOSTICS or exported.health]
    counts = dict.fromkeys(topics, 0)
    store = get_typestore(Stores.ROS2_HUMBLE)
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library=f"drd {__version__}")
        channels = {}
        for topic in topics:
            name = TYPES[topic]
            definition, _ = store.generate_msgdef(name, ros_version=2)
            schema = writer.register_schema(name, "ros2msg", definition.encode())
            # Empty: rosbag2 plays the topic with its default quality of service.
            channels[topic] = writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": ""})
        for message in heapq.merge(_of_poses(exported), _of_health(exported), key=lambda m: m.stamp_ns):
            counts[message.topic] += 1
            at_ns = message.stamp_ns
            writer.add_message(channels[message.topic], at_ns, message.data, at_ns, sequence=counts[message.topic])
        writer.finish()  # type: ignore[no-untyped-call]
    return counts


def _of_poses(exported: Exported) -> Iterator[_Message]:
    frames = exported.output.frame_id, exported.output.child_frame_id
    odometry, transform, imu = OdometryEncoder(*frames), TransformEncoder(*frames), ImuEncoder(frames[1])
    for at_ns, pose in exported.poses:
        yield _Message(ODOM, at_ns, odometry.encode(pose, at_ns))
        yield _Message(TF, at_ns, transform.encode(pose, at_ns))
        yield _Message(IMU, at_ns, imu.encode(pose, at_ns))


def _of_health(exported: Exported) -> Iterator[_Message]:
    for at_ns, statuses in exported.health:
        yield _Message(DIAGNOSTICS, at_ns, encode_diagnostics(statuses, at_ns))
