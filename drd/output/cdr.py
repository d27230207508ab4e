"""nav_msgs/Odometry as ROS 2 puts it on the wire: classic CDR (OMG DDSI-RTPS 2.3, clause 10), little-endian."""

import math
import struct

from drd.samples import Pose
from drd.units import NS_PER_S

# Variance (m^2, rad^2, (m/s)^2, (rad/s)^2) of what is not known. A zero would tell a fusing filter "exact".
UNKNOWN_VARIANCE = 1e6

_ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR_LE, no options
_STAMP = struct.Struct("<iI")  # builtin_interfaces/Time: int32 sec, uint32 nanosec
_DOUBLES = struct.Struct("<85d")  # position 3, quaternion 4, covariance 36, linear 3, angular 3, covariance 36
_POSE_COVARIANCE = 7
_TWIST = 43
_TWIST_COVARIANCE = 49


class OdometryEncoder:
    """Encodes poses of one pair of frames into a buffer laid out once. Not for several threads at a time.

    The robot is planar: z, roll and pitch are 0 with UNKNOWN_VARIANCE, as their truth is not observed. The twist is
    in the child frame: linear.x is the speed, angular.z the rate, each with its variance; linear.y is 0 with
    UNKNOWN_VARIANCE, as sideways slip is not observed.
    """

    def __init__(self, frame_id: str, child_frame_id: str):
        head = bytearray(_ENCAPSULATION + bytes(_STAMP.size))
        for text in (frame_id, child_frame_id):
            _append_string(head, text)
        # Alignment counts from behind the encapsulation header: doubles lie on multiples of 8 from there.
        _pad(head, 8)
        self._doubles_at = len(head)
        self._buffer = head + bytes(_DOUBLES.size)
        self._values = [0.0] * 85
        for i in range(6):
            self._values[_POSE_COVARIANCE + 7 * i] = UNKNOWN_VARIANCE
            self._values[_TWIST_COVARIANCE + 7 * i] = UNKNOWN_VARIANCE

    def encode(self, pose: Pose, wall_ns: int) -> bytes:
        """One message; `wall_ns` (CLOCK_REALTIME) becomes its stamp, held at int32 seconds as the message has them."""
        seconds, nanoseconds = divmod(wall_ns, NS_PER_S)
        _STAMP.pack_into(self._buffer, len(_ENCAPSULATION), max(-(2**31), min(seconds, 2**31 - 1)), nanoseconds)
        v = self._values
        v[0], v[1] = pose.x_m, pose.y_m
        # Wrapped first: half of a large angle loses digits. NaN passes through fmod; infinity would not.
        half = 0.5 * math.fmod(pose.heading_rad, 4.0 * math.pi) if math.isfinite(pose.heading_rad) else math.nan
        v[5], v[6] = math.sin(half), math.cos(half)
        xx, xy, xh, yy, yh, hh = pose.covariance
        # Row-major 6x6 of x, y, z, roll, pitch, yaw; x, y and yaw are rows and columns 0, 1 and 5.
        c = _POSE_COVARIANCE
        v[c], v[c + 1], v[c + 5] = xx, xy, xh
        v[c + 6], v[c + 7], v[c + 11] = xy, yy, yh
        v[c + 30], v[c + 31], v[c + 35] = xh, yh, hh
        v[_TWIST], v[_TWIST + 5] = pose.speed_m_s, pose.rate_rad_s
        v[_TWIST_COVARIANCE], v[_TWIST_COVARIANCE + 35] = pose.speed_sigma_m_s**2, pose.rate_sigma_rad_s**2
        _DOUBLES.pack_into(self._buffer, self._doubles_at, *v)
        return bytes(self._buffer)


def _append_string(buffer: bytearray, text: str) -> None:
    """uint32 length with the terminating zero, then the bytes and that zero."""
    data = text.encode("utf-8", "replace") + b"\0"
    _pad(buffer, 4)
    buffer += struct.pack("<I", len(data)) + data


def _pad(buffer: bytearray, alignment: int) -> None:
    buffer += bytes(-(len(buffer) - len(_ENCAPSULATION)) % alignment)
