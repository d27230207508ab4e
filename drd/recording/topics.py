"""Topics, schemas and the encoding of each message; runs in the recorder's thread."""

import base64
import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from drd.config.keys import Output
from drd.output.cdr import OdometryEncoder
from drd.output.messages import encode, pose_dict
from drd.samples import CanFrame, GyroSample, Pose, WheelSample
from drd.units import NS_PER_S

RAW_FOG, RAW_CAN, RAW_EVENTS = "/raw/fog", "/raw/can", "/raw/events"
POSE: Final = "/drd/pose"

_NUMBER: Final = {"type": "number"}
_WHOLE: Final = {"type": "integer"}
_TEXT: Final = {"type": "string"}
_TRUTH: Final = {"type": "boolean"}
_BYTES: Final = {"type": "string", "contentEncoding": "base64"}


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _array(items: Any) -> dict[str, Any]:
    return {"type": "array", "items": items}


_REASON = _object(source=_TEXT, text=_TEXT, since_s=_NUMBER, since_ns=_WHOLE)
_XYZ = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
# https://docs.foxglove.dev/docs/sdk/schemas/pose-in-frame
_POSE_IN_FRAME = _object(
    timestamp=_object(sec=_WHOLE, nsec=_WHOLE),
    frame_id=_TEXT,
    pose=_object(position=_XYZ, orientation=_object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)),
)
_POSE = _object(
    sequence=_WHOLE,
    monotonic_ns=_WHOLE,
    wall_ns=_WHOLE,
    **dict.fromkeys(
        ("x_m", "y_m", "heading_rad", "speed_m_s", "rate_rad_s", "speed_sigma_m_s", "rate_sigma_rad_s"), _NUMBER
    ),
    covariance_m_rad=_array(_array(_NUMBER)),
    position_bound_99_m=_NUMBER,
    validity=_TEXT,
    reasons=_array(_REASON),
)
_FRAME = _object(monotonic_ns=_WHOLE, can_id=_WHOLE, extended=_TRUTH, data=_BYTES)
_SAMPLE = {"monotonic_ns": _WHOLE, "interval_s": _NUMBER}
# Definitions of ROS 2's common_interfaces, without their comments, one after another as MCAP's registry has it.
_ODOMETRY: Final = """\
std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
{rule}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{rule}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{rule}
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
{rule}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{rule}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{rule}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
{rule}
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
float64[36] covariance
{rule}
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
{rule}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
""".format(rule="=" * 80)


class Channel(NamedTuple):
    """One topic: how its messages are encoded, and the schema's name, encoding and text."""

    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


def _json(topic: str, name: str, schema: Mapping[str, Any]) -> Channel:
    return Channel(topic, "json", name, "jsonschema", json.dumps(schema).encode())


CHANNELS: Final = (
    _json(RAW_FOG, "drd.RawBytes", _object(monotonic_ns=_WHOLE, data=_BYTES)),
    _json(RAW_CAN, "drd.RawFrames", _object(frames=_array(_FRAME))),
    _json(RAW_EVENTS, "drd.Event", _object(event=_TEXT, monotonic_ns=_WHOLE)),
    _json("/fog", "drd.GyroSample", _object(**_SAMPLE, rate_rad_s=_NUMBER, temperature_c=_NUMBER)),
    _json("/wheels", "drd.WheelSample", _object(**_SAMPLE, left_m=_NUMBER, right_m=_NUMBER, lost_s=_NUMBER)),
    _json(POSE, "drd.Pose", _POSE),
    _json("/pose", "foxglove.PoseInFrame", _POSE_IN_FRAME),
    Channel("/odom", "cdr", "nav_msgs/msg/Odometry", "ros2msg", _ODOMETRY.encode()),
    _json("/health", "drd.Health", _object(validity=_TEXT, reasons=_array(_REASON), wall_ns=_WHOLE)),
)


class Message(NamedTuple):
    """What goes into the file; `t_ns` is the data's own time on CLOCK_MONOTONIC."""

    topic: str
    t_ns: int
    data: bytes


class Encoder:
    """Messages of each kind; the methods' names are the kinds. `output` gives the frames' names."""

    def __init__(self, output: Output):
        self._frame_id = output.frame_id
        self._odometry = OdometryEncoder(output.frame_id, output.child_frame_id)
        self.by_kind: dict[str, Callable[..., list[Message]]] = {
            "fog_bytes": self._fog_bytes,
            "frames": self._frames,
            "event": self._event,
            "gyro": self._gyro,
            "wheels": self._wheels,
            "pose": self._pose,
            "health": self._health,
        }

    def _fog_bytes(self, data: bytes, arrival_ns: int) -> list[Message]:
        return [Message(RAW_FOG, arrival_ns, encode({"monotonic_ns": arrival_ns, "data": _text(data)}))]

    def _frames(self, frames: Sequence[CanFrame]) -> list[Message]:
        rows = [
            {"monotonic_ns": f.t_ns, "can_id": f.can_id, "extended": f.extended, "data": _text(f.data)} for f in frames
        ]
        return [Message(RAW_CAN, frames[-1].t_ns, encode({"frames": rows}))]

    def _event(self, name: str, now_ns: int, values: Mapping[str, Any]) -> list[Message]:
        return [Message(RAW_EVENTS, now_ns, encode({"event": name, "monotonic_ns": now_ns, **values}))]

    def _gyro(self, sample: GyroSample) -> list[Message]:
        return [Message("/fog", sample.t_ns, _sample(sample))]

    def _wheels(self, sample: WheelSample) -> list[Message]:
        return [Message("/wheels", sample.t_ns, _sample(sample))]

    def _pose(self, pose: Pose, wall_ns: int) -> list[Message]:
        seconds, nanoseconds = divmod(wall_ns, NS_PER_S)
        half = 0.5 * math.fmod(pose.heading_rad, 4.0 * math.pi) if math.isfinite(pose.heading_rad) else math.nan
        in_frame = {
            "timestamp": {"sec": seconds, "nsec": nanoseconds},
            "frame_id": self._frame_id,
            "pose": {
                "position": {"x": pose.x_m, "y": pose.y_m, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)},
            },
        }
        published = pose_dict(pose, wall_ns)
        for row, reason in zip(published["reasons"], pose.reasons, strict=True):
            row["since_ns"] = reason.since_ns  # since_s is rounded
        return [
            Message(POSE, pose.t_ns, encode(published)),
            Message("/pose", pose.t_ns, encode(in_frame)),
            Message("/odom", pose.t_ns, self._odometry.encode(pose, wall_ns)),
        ]

    def _health(self, health: Mapping[str, Any]) -> list[Message]:
        return [Message("/health", health["monotonic_ns"], encode(health))]


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _sample(sample: GyroSample | WheelSample) -> bytes:
    values = sample._asdict()
    return encode({"monotonic_ns": values.pop("t_ns"), **values})
