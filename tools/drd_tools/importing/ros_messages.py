"""Contents of ROS messages for dead reckoning: fields of rates and speeds, poses, joints, and a proposed command."""

import math
import shlex
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.config.schema import ConfigError

IMU: Final = "sensor_msgs/msg/Imu"
JOINTS: Final = "sensor_msgs/msg/JointState"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
# Forward speed and yaw rate.
WHEEL_FIELDS: Final = {
    ODOMETRY: ("twist.twist.linear.x", "twist.twist.angular.z"),
    "geometry_msgs/msg/TwistStamped": ("twist.linear.x", "twist.angular.z"),
    "geometry_msgs/msg/TwistWithCovarianceStamped": ("twist.twist.linear.x", "twist.twist.angular.z"),
    "geometry_msgs/msg/Twist": ("linear.x", "angular.z"),
}
# Fields of position and orientation.
REFERENCES: Final = {
    ODOMETRY: ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/PoseStamped": ("pose.position", "pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/TransformStamped": ("transform.translation", "transform.rotation"),
}


def field(message: Any, path: str) -> Any:
    """Get a field by a path such as twist.linear.x or axes.0. A wrong path raises Python's own errors."""
    value = message
    for part in path.split("."):
        value = value[int(part)] if part.isdecimal() else getattr(value, part)
    return value


def pose_of(message: Any, kind: str) -> tuple[float, float, float]:
    """x and y in m, and heading in rad, the yaw of the quaternion (textbook)."""
    position, q = (field(message, path) for path in REFERENCES[kind])
    heading = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return position.x, position.y, heading


class Joints(NamedTuple):
    """Contents of a JointState."""

    name: list[str]
    position: list[float]
    velocity: list[float]

    @classmethod
    def of(cls, message: Any) -> "Joints":
        """Copy them from a message."""
        return cls(list(message.name), message.position.tolist(), message.velocity.tolist())


def joint_columns(
    messages: list[Joints], joints: tuple[str, str] | None, unit: str | None, where: str
) -> tuple[Array, Array, str, str]:
    """Left and right, the unit, and a sentence; NaN where a message lacks one of the joints.

    Uses positions if all messages have them (nothing is lost between rows), otherwise velocities, averaged over a
    side's joints. Raises ConfigError if the joints' names do not show their side.
    """
    names = list(dict.fromkeys(name for message in messages for name in message.name))
    if joints is None:
        left = [n for n in names if "left" in n.lower()]
        right = [n for n in names if "right" in n.lower()]
        if not left or len(left) != len(right):
            raise ConfigError(where, "--joints", f"LEFT:RIGHT, of {', '.join(names)}", "nothing")
    else:
        left, right = (side.split("+") for side in joints)
    for name in (*left, *right):
        if name not in names:
            raise ConfigError(where, "--joints", f"some of {', '.join(names)}", repr(name))
    has_positions = all(len(m.position) == len(m.name) for m in messages)
    wanted = unit or ("rad" if has_positions else "rad_s")
    if wanted not in ("rad", "rad_s"):
        raise ConfigError(where, "--wheels-unit", "rad (positions) or rad_s (velocities) for joints", wanted)
    column = "position" if wanted == "rad" else "velocity"
    columns = [np.array([_mean(m, side, column) for m in messages]) for side in (left, right)]
    if not all(np.isfinite(values).any() for values in columns):
        raise ConfigError(where, "--wheels", f"joints with a {column}", "none")
    return columns[0], columns[1], wanted, f"{column} of {'+'.join(left)} and {'+'.join(right)}"


def _mean(message: Joints, names: list[str], column: str) -> float:
    """Mean of these joints' values; NaN if one is missing."""
    values = getattr(message, column)
    index = {name: k for k, name in enumerate(message.name)}
    if any(name not in index or index[name] >= len(values) for name in names):
        return math.nan
    return float(sum(values[index[name]] for name in names)) / len(names)


def proposal(types: dict[str, str], path: Path) -> list[str]:
    """Propose a command line from the topics' types and names, stating that it is a guess."""
    gyros = [t for t, kind in types.items() if kind == IMU]
    wheels = [t for t, kind in types.items() if kind == JOINTS]
    wheels += sorted((t for t, kind in types.items() if kind == ODOMETRY), key=_unlike_wheels)
    wheels += [t for t, kind in types.items() if kind in WHEEL_FIELDS and kind != ODOMETRY and "cmd" not in t]
    references = [t for t, kind in types.items() if kind in REFERENCES and kind != ODOMETRY]
    if not gyros and not wheels:
        return ["", "no topic of a type that is known here; name fields as TOPIC:FIELD (--help)"]
    words = ["drd import", shlex.quote(str(path))]
    words += [f"--gyro {gyros[0]} --axis auto --sign auto"] if gyros else []
    words += [f"--wheels {wheels[0]} --wheel-radius M --tread M"] if wheels else []
    words += [f"--reference {references[0]}"] if references else []
    return ["", "to begin with (a guess by types and names; put the robot's numbers in place of M):",
            "  " + " ".join([*words, "--output DIR"])]  # fmt: skip


def _unlike_wheels(topic: str) -> int:
    """Sort key: odometry of the drive's own controller first, fused or visual odometry last."""
    name = topic.lower()
    if any(word in name for word in ("filtered", "visual", "lidar", "gps", "ekf", "map", "truth")):
        return 2
    return 0 if any(word in name for word in ("controller", "wheel", "diff", "base")) else 1
