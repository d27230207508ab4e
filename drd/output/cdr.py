"""ROS 2's messages as sent over the wire: classic CDR (OMG DDSI-RTPS 2.3, clause 10), little-endian.

An encoder lays its message out once for one pair of frames, and is not thread-safe. Every `wall_ns` is CLOCK_REALTIME
and becomes the message's stamp, limited to the message's int32 seconds.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from drd.samples import Pose
from drd.units import NS_PER_S

# Variance (m^2, rad^2, (m/s)^2, (rad/s)^2) of unknown quantities. Zero would mean "exact" to a fusing filter.
UNKNOWN_VARIANCE = 1e6
# First element of an Imu covariance whose quantity is not measured (REP-145, and Imu.msg itself).
NOT_MEASURED = -1.0

_ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR_LE, no options
EMPTY = _ENCAPSULATION + b"\0"  # a message without fields, for which rosidl puts a byte
_STAMP = struct.Struct("<iI")  # builtin_interfaces/Time: int32 sec, uint32 nanosec
_COUNT = struct.Struct("<I")
_POSE_COVARIANCE = 7
_TWIST = 43
_TWIST_COVARIANCE = 49
_IMU_RATE_Z = 15
_IMU_YAW_VARIANCE = 12
_IMU_RATE_Z_VARIANCE = 24


class CdrWriter:
    """Appends values to a message. Alignment counts from the end of the encapsulation header."""

    def __init__(self, start: bytes = _ENCAPSULATION) -> None:
        self.data = bytearray(start)

    def pad(self, alignment: int) -> None:
        """Append zeros up to the next multiple of `alignment` bytes."""
        self.data += bytes(-(len(self.data) - len(_ENCAPSULATION)) % alignment)

    def count(self, value: int) -> None:
        """Append a uint32, the length that precedes a sequence."""
        self.pad(4)
        self.data += _COUNT.pack(value)

    def text(self, text: str) -> None:
        """Append a string: uint32 length with the terminating zero, then the bytes and that zero."""
        data = text.encode("utf-8", "replace") + b"\0"
        self.count(len(data))
        self.data += data

    def doubles(self, values: Sequence[float]) -> None:
        """Append a sequence of float64."""
        self.count(len(values))
        if values:
            self.pad(8)
            self.data += struct.pack(f"<{len(values)}d", *values)

    def header(self, wall_ns: int, frame_id: str) -> None:
        """Append a std_msgs/Header."""
        self.pad(4)
        self.data += _stamp(wall_ns)
        self.text(frame_id)


class CdrReader:
    """Reads values from a message in order. Raises ValueError where the message does not contain them."""

    def __init__(self, data: bytes) -> None:
        if data[:2] != _ENCAPSULATION[:2]:
            raise ValueError("not little-endian CDR")
        self._body, self._at = data[len(_ENCAPSULATION) :], 0

    def header(self) -> tuple[int, str]:
        """Read a std_msgs/Header: stamp in ns, and frame."""
        seconds, nanoseconds = self._take(_STAMP, 4)
        return seconds * NS_PER_S + nanoseconds, self.text()

    def text(self) -> str:
        """Read a string."""
        (length,) = self._take(_COUNT, 4)
        end = self._at + length
        if not 0 < length <= len(self._body) - self._at:
            raise ValueError("a text goes beyond the end")
        data, self._at = self._body[self._at : end - 1], end
        return data.decode()

    def doubles(self, count: int) -> tuple[float, ...]:
        """Read `count` float64 values; the count is fixed and not in the message."""
        return self._take(struct.Struct(f"<{count}d"), 8)

    def _take(self, form: struct.Struct, alignment: int) -> tuple[Any, ...]:
        at = self._at + -self._at % alignment
        if at + form.size > len(self._body):
            raise ValueError("too short")
        self._at = at + form.size
        return form.unpack_from(self._body, at)


class _Template:
    """A message with fixed strings: header, texts, then only doubles, kept in `values`."""

    def __init__(self, before: bytes, texts: Sequence[str], values: list[float]):
        head = CdrWriter(_ENCAPSULATION + before)
        self._stamp_at = len(head.data)
        head.data += bytes(_STAMP.size)
        for text in texts:
            head.text(text)
        head.pad(8)
        self._doubles = struct.Struct(f"<{len(values)}d")
        self._doubles_at = len(head.data)
        self._buffer = head.data + bytes(self._doubles.size)
        self.values = values

    def encode(self, wall_ns: int) -> bytes:
        """The encoded message."""
        self._buffer[self._stamp_at : self._stamp_at + _STAMP.size] = _stamp(wall_ns)
        self._doubles.pack_into(self._buffer, self._doubles_at, *self.values)
        return bytes(self._buffer)


class OdometryEncoder:
    """nav_msgs/Odometry.

    The estimate is planar: z, roll and pitch are 0 with UNKNOWN_VARIANCE, since they are not observed. The twist is
    in the child frame: linear.x is the speed, angular.z the rate, each with its variance; linear.y is 0 with
    UNKNOWN_VARIANCE, since sideways slip is not observed.
    """

    def __init__(self, frame_id: str, child_frame_id: str):
        # position 3, quaternion 4, covariance 36, linear 3, angular 3, covariance 36
        values = [0.0] * 85
        for i in range(6):
            values[_POSE_COVARIANCE + 7 * i] = UNKNOWN_VARIANCE
            values[_TWIST_COVARIANCE + 7 * i] = UNKNOWN_VARIANCE
        self._message = _Template(b"", (frame_id, child_frame_id), values)

    def encode(self, pose: Pose, wall_ns: int) -> bytes:
        """One message."""
        v = self._message.values
        v[0], v[1] = pose.x_m, pose.y_m
        v[5], v[6] = quaternion_zw(pose.heading_rad)
        xx, xy, xh, yy, yh, hh = pose.covariance
        # Row-major 6x6 of x, y, z, roll, pitch, yaw; x, y and yaw are rows and columns 0, 1 and 5.
        c = _POSE_COVARIANCE
        v[c], v[c + 1], v[c + 5] = xx, xy, xh
        v[c + 6], v[c + 7], v[c + 11] = xy, yy, yh
        v[c + 30], v[c + 31], v[c + 35] = xh, yh, hh
        v[_TWIST], v[_TWIST + 5] = pose.speed_m_s, pose.rate_rad_s
        v[_TWIST_COVARIANCE], v[_TWIST_COVARIANCE + 35] = pose.speed_sigma_m_s**2, pose.rate_sigma_rad_s**2
        return self._message.encode(wall_ns)


class TransformEncoder:
    """tf2_msgs/TFMessage with one transform: from `frame_id` to the robot, `child_frame_id`."""

    def __init__(self, frame_id: str, child_frame_id: str):
        # translation 3, quaternion 4, after the sequence's length
        self._message = _Template(_COUNT.pack(1), (frame_id, child_frame_id), [0.0] * 7)

    def encode(self, pose: Pose, wall_ns: int) -> bytes:
        """One message."""
        v = self._message.values
        v[0], v[1] = pose.x_m, pose.y_m
        v[5], v[6] = quaternion_zw(pose.heading_rad)
        return self._message.encode(wall_ns)


class ImuEncoder:
    """sensor_msgs/Imu in the robot's own frame, `frame_id`: the bias-corrected yaw rate, and the heading.

    The orientation is that of the odometry: yaw with its variance, roll and pitch 0 with UNKNOWN_VARIANCE, and so
    are the rates about x and y. Acceleration is marked in its covariance as not measured.
    """

    def __init__(self, frame_id: str):
        # quaternion 4, covariance 9, rates 3, covariance 9, accelerations 3, covariance 9
        values = [0.0] * 37
        for at in (4, 8, 16, 20):
            values[at] = UNKNOWN_VARIANCE
        values[28] = NOT_MEASURED
        self._message = _Template(b"", (frame_id,), values)

    def encode(self, pose: Pose, wall_ns: int) -> bytes:
        """One message."""
        v = self._message.values
        v[2], v[3] = quaternion_zw(pose.heading_rad)
        v[_IMU_YAW_VARIANCE] = pose.covariance[5]
        v[_IMU_RATE_Z], v[_IMU_RATE_Z_VARIANCE] = pose.rate_rad_s, pose.rate_sigma_rad_s**2
        return self._message.encode(wall_ns)


class JointStateEncoder:
    """sensor_msgs/JointState of the joints `names`, without efforts."""

    def __init__(self, names: Sequence[str]):
        head = CdrWriter()
        head.header(0, "")
        head.count(len(names))
        for name in names:
            head.text(name)
        self._head = bytes(head.data)

    def encode(self, positions_rad: Sequence[float], velocities_rad_s: Sequence[float], wall_ns: int) -> bytes:
        """One message; each sequence is in the order of the names, or empty if unknown."""
        message = CdrWriter(self._head)
        message.data[len(_ENCAPSULATION) : len(_ENCAPSULATION) + _STAMP.size] = _stamp(wall_ns)
        for values in (positions_rad, velocities_rad_s, ()):
            message.doubles(values)
        return bytes(message.data)


class Diagnostic(NamedTuple):
    """diagnostic_msgs/DiagnosticStatus; `level`: 0 good, 1 warning, 2 error, 3 stale."""

    level: int
    name: str
    message: str
    hardware_id: str
    values: Mapping[str, str]


def encode_diagnostics(statuses: Sequence[Diagnostic], wall_ns: int) -> bytes:
    """diagnostic_msgs/DiagnosticArray."""
    message = CdrWriter()
    message.header(wall_ns, "")
    message.count(len(statuses))
    for status in statuses:
        message.data.append(status.level)
        for text in (status.name, status.message, status.hardware_id):
            message.text(text)
        message.count(len(status.values))
        for pair in status.values.items():
            for text in pair:
                message.text(text)
    return bytes(message.data)


def encode_trigger(success: bool, message: str) -> bytes:
    """The answer of std_srvs/Trigger."""
    writer = CdrWriter()
    writer.data.append(success)
    writer.text(message)
    return bytes(writer.data)


def _stamp(wall_ns: int) -> bytes:
    seconds, nanoseconds = divmod(wall_ns, NS_PER_S)
    return _STAMP.pack(max(-(2**31), min(seconds, 2**31 - 1)), nanoseconds)


def quaternion_zw(heading_rad: float) -> tuple[float, float]:
    """z and w of the quaternion of a heading; NaN if the heading is not finite."""
    # Wrapped first: half of a large angle loses digits. NaN passes through fmod; infinity would not.
    half = 0.5 * math.fmod(heading_rad, 4.0 * math.pi) if math.isfinite(heading_rad) else math.nan
    return math.sin(half), math.cos(half)
