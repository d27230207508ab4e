"""Gyro, wheels and reference from a ROS bag's topics."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd.units import NS_PER_S
from drd_tools.importing.bag import Bag
from drd_tools.importing.ros_messages import (
    IMU,
    JOINTS,
    ODOMETRY,
    REFERENCES,
    WHEEL_FIELDS,
    Joints,
    field,
    joint_columns,
    pose_of,
    proposal,
)
from drd_tools.importing.streams import Gyro, Origin, Reference, Source, Times, Wheels, in_order
from drd_tools.report.terminal import columns

VECTORS: Final = {IMU: "angular_velocity", "geometry_msgs/msg/Vector3Stamped": "vector"}
# Counters wrap at the range of their type.
MODULI: Final = {f"std_msgs/msg/{kind}": 2**bits for bits in (8, 16, 32) for kind in (f"Int{bits}", f"UInt{bits}")}


class RosSource(Source):
    """A bag file, a bag's folder, or an MCAP file. Raises ConfigError.

    `joints`: names of the left and right ones. `pose`: derive wheels from an odometry's poses, not its speeds.
    """

    def __init__(
        self,
        path: Path,
        stamps: str,
        wheel_unit: str | None,
        joints: tuple[str, str] | None,
        *,
        pose: bool,
    ):
        self._bag, self._unit, self._joints, self._pose = Bag(path, stamps), wheel_unit, joints, pose
        self.path, self._where = path, str(path)

    def listing(self) -> list[str]:
        """Table of topics, and a proposed command. Rates are means over the whole recording."""
        bag = self._bag
        rows = [["topic", "type", "messages", "Hz"]]
        for topic, kind in sorted(bag.types.items()):
            rate = f"{bag.counts[topic] / bag.seconds:.1f}" if bag.seconds > 0.0 else "-"
            rows.append([topic, kind, str(bag.counts[topic]), rate])
        return [f"{bag.path}: {bag.seconds:.1f} s", *columns(rows, (0, 1), ""), *proposal(bag.types, bag.path)]

    def gyro(self, name: str) -> tuple[Gyro, Origin]:
        """Read a topic of Imu or Vector3Stamped, or TOPIC:FIELD with one number."""
        topic, path = _parts(name)
        kind = self._bag.kind(topic, "--gyro")
        if path:
            time_ns, values, origin = self._bag.numbers(topic, self._picker(topic, path))
            return Gyro(time_ns, values, ("",)), origin
        if kind not in VECTORS:
            raise ConfigError(self._where, f"--gyro {topic}", f"one of {', '.join(VECTORS)}, or TOPIC:FIELD", kind)
        vector = VECTORS[kind]
        if kind != IMU:
            time_ns, values, origin = self._bag.numbers(topic, lambda m: _xyz(getattr(m, vector)))
            return Gyro(time_ns, values, ("x", "y", "z")), origin
        time_ns, picked, origin = self._bag.read(topic, _imu)
        values = np.array(picked)
        rates, force, covariance = values[:, :3], values[:, 3:6], values[:, 6]
        if not np.isfinite(rates).all():
            raise ConfigError(self._where, topic, "finite rates", "others")
        # The first covariance is -1 if there is no such sensor (sensor_msgs/Imu).
        has_force = bool((covariance != -1.0).all() and np.isfinite(force).all())
        return Gyro(time_ns, rates, ("x", "y", "z"), force if has_force else None), origin

    def wheels(self, name: str) -> tuple[Wheels, Origin]:
        """Read a topic of a known type, or LEFT,RIGHT, each as TOPIC:FIELD."""
        if "," in name:
            return self._two_fields(name)
        topic, path = _parts(name)
        kind = self._bag.kind(topic, "--wheels")
        if path:
            raise ConfigError(self._where, "--wheels", "LEFT,RIGHT where fields are named", repr(name))
        if kind == JOINTS:
            return self._from_joints(topic)
        if kind not in WHEEL_FIELDS:
            expected = f"one of {', '.join(WHEEL_FIELDS)}, {JOINTS}, or LEFT,RIGHT (TOPIC:FIELD each)"
            raise ConfigError(self._where, f"--wheels {topic}", expected, kind)
        if self._pose:
            return self._from_poses(topic, kind)
        forward, yaw = WHEEL_FIELDS[kind]
        time_ns, values, origin = self._bag.numbers(topic, lambda m: (field(m, forward), field(m, yaw)))
        origin.notes.append("speed and yaw rate of the robot, turned into wheel speeds with tread_m and radius_m")
        return Wheels(time_ns, values[:, 0], values[:, 1], "twist"), origin

    def reference(self, name: str) -> tuple[Reference, Origin]:
        """Read a topic of poses."""
        kind = self._bag.kind(name, "--reference")
        if kind not in REFERENCES:
            why = " (a fix has no heading)" if kind == "sensor_msgs/msg/NavSatFix" else ""
            raise ConfigError(self._where, f"--reference {name}", f"one of {', '.join(REFERENCES)}", kind + why)
        time_ns, poses, origin = self._bag.numbers(name, lambda m: pose_of(m, kind))
        return Reference(time_ns, *poses.T), origin

    def _from_poses(self, topic: str, kind: str) -> tuple[Wheels, Origin]:
        """Mean speed and yaw rate between an odometry's poses, over the interval that ends at each row."""
        if kind != ODOMETRY:
            raise ConfigError(self._where, f"--wheels {topic}", f"{ODOMETRY} for --wheels-from pose", kind)
        poses, origin = in_order(*self.reference(topic))
        step_s = np.diff(poses.time_ns) / NS_PER_S
        turn = np.diff(np.unwrap(poses.heading_rad))
        middle = poses.heading_rad[:-1] + 0.5 * turn
        ahead_m = np.diff(poses.x_m) * np.cos(middle) + np.diff(poses.y_m) * np.sin(middle)
        # A circle's arc is longer than its chord.
        ahead_m /= np.sinc(turn / (2.0 * np.pi))
        origin.notes.append("differences of the odometry's poses, turned into wheel speeds with tread_m and radius_m")
        forward, yaw = (np.concatenate([[0.0], column / step_s]) for column in (ahead_m, turn))
        return Wheels(poses.time_ns, forward, yaw, "twist"), origin

    def _from_joints(self, topic: str) -> tuple[Wheels, Origin]:
        time_ns, rows, origin = self._bag.read(topic, Joints.of)
        left, right, unit, told = joint_columns(rows, self._joints, self._unit, f"{self._where}: {topic}")
        known = np.isfinite(left) & np.isfinite(right)
        if not known.all():
            origin.notes.append(f"{int((~known).sum())} messages without these joints were left out")
        origin.notes.append(told)
        return Wheels(time_ns[known], left[known], right[known], unit), origin

    def _two_fields(self, name: str) -> tuple[Wheels, Origin]:
        if name.count(",") != 1:
            raise ConfigError(self._where, "--wheels", "TOPIC or LEFT,RIGHT", repr(name))
        if self._unit is None:
            raise ConfigError("command line", "--wheels-unit", "what the two fields are", "nothing")
        read = []
        for part in name.split(","):
            topic, path = _parts(part)
            kind = self._bag.kind(topic, "--wheels")
            path = path or ("data" if kind.startswith("std_msgs/") else "")
            if not path:
                raise ConfigError(self._where, f"--wheels {topic}", "TOPIC:FIELD", kind)
            read.append((topic, kind, *self._bag.numbers(topic, self._picker(topic, path))))
        (one, kind, time_ns, left, origin), (other, other_kind, other_ns, right, _) = read
        modulus = MODULI.get(kind) if self._unit == "counts" else None
        origin.source, origin.kind = name, ", ".join(dict.fromkeys((kind, other_kind)))
        left, right = left[:, 0], right[:, 0]
        if one != other:
            nearest, kept = _nearest(time_ns, other_ns, origin)
            time_ns, left, right = time_ns[kept], left[kept], right[nearest][kept]
        return Wheels(time_ns, left, right, self._unit, modulus), origin

    def _picker(self, topic: str, path: str) -> Callable[[Any], tuple[float]]:
        def pick(message: Any) -> tuple[float]:
            try:
                return (float(field(message, path)),)
            except (AttributeError, IndexError, TypeError, ValueError) as error:
                names = [name for name in vars(message) if not name.startswith("__")]
                expected = f"a number in {self._bag.types[topic]} ({', '.join(names)})"
                raise ConfigError(self._where, f"{topic}:{path}", expected, str(error)) from error

        return pick


def _parts(name: str) -> tuple[str, str]:
    topic, _, path = name.partition(":")
    return topic, path


def _xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _imu(message: Any) -> tuple[float, ...]:
    force = _xyz(message.linear_acceleration)
    return (*_xyz(message.angular_velocity), *force, float(message.linear_acceleration_covariance[0]))


def _nearest(left_ns: Times, right_ns: Times, origin: Origin) -> tuple[npt.NDArray[np.int_], npt.NDArray[np.bool_]]:
    """Find the right row nearest in time to each left row, and whether it is close enough to be its pair."""
    order = np.argsort(right_ns, kind="stable")
    times = right_ns[order]
    after = np.minimum(np.searchsorted(times, left_ns), len(times) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(times[after] - left_ns) < np.abs(times[before] - left_ns), after, before)
    apart: Array = np.abs(times[nearest] - left_ns) / NS_PER_S
    period_s = float(np.median(np.diff(np.sort(left_ns)))) / NS_PER_S if len(left_ns) > 1 else math.inf
    kept = apart <= period_s
    origin.notes.append(
        f"each left row with the right one nearest in time, {np.median(apart):.4f} s apart (median); "
        f"{int((~kept).sum())} rows without one within {period_s:.3f} s left out"
    )
    return order[nearest], kept
