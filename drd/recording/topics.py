"""Topics, schemas and the encoding of each message; runs in the recorder's thread."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from drd.config.keys import Output
from drd.output import foxglove
from drd.output.cdr import OdometryEncoder
from drd.output.messages import encode, pose_dict
from drd.samples import CanFrame, GyroSample, Pose, WheelSample
from drd.units import NS_PER_S

RAW_FOG, RAW_CAN, RAW_EVENTS = "/raw/fog", "/raw/can", "/raw/events"
POSE: Final = "/drd/pose"
# The whole path is written each time, so that a viewer that jumps to any time finds all of it in one message.
SCENE_PERIOD_NS: Final = 2 * NS_PER_S

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
_FINDING = _object(effect=_TEXT, text=_TEXT, probability=_NUMBER, since_ns=_WHOLE, named_ns=_WHOLE)
_FRAME = _object(monotonic_ns=_WHOLE, can_id=_WHOLE, extended=_TRUTH, data=_BYTES)
_SAMPLE = {"monotonic_ns": _WHOLE, "interval_s": _NUMBER}
# Definitions from ROS 2's common_interfaces, without comments, concatenated as MCAP's registry specifies.
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


def _foxglove(topic: str, name: str) -> Channel:
    return Channel(topic, "protobuf", f"foxglove.{name}", "protobuf", foxglove.SCHEMA)


CHANNELS: Final = (
    _json(RAW_FOG, "drd.RawBytes", _object(monotonic_ns=_WHOLE, data=_BYTES)),
    _json(RAW_CAN, "drd.RawFrames", _object(frames=_array(_FRAME))),
    _json(RAW_EVENTS, "drd.Event", _object(event=_TEXT, monotonic_ns=_WHOLE)),
    _json("/fog", "drd.GyroSample", _object(**_SAMPLE, rate_rad_s=_NUMBER, temperature_c=_NUMBER)),
    _json(
        "/wheels",
        "drd.WheelSample",
        _object(**_SAMPLE, left_m=_NUMBER, right_m=_NUMBER, lost_s=_NUMBER, lost_m=_NUMBER),
    ),
    _json(POSE, "drd.Pose", _POSE),
    _foxglove("/pose", "PoseInFrame"),
    Channel("/odom", "cdr", "nav_msgs/msg/Odometry", "ros2msg", _ODOMETRY.encode()),
    _json("/health", "drd.Health", _object(validity=_TEXT, reasons=_array(_REASON), wall_ns=_WHOLE)),
    _json("/findings", "drd.Findings", _object(state=_TEXT, findings=_array(_FINDING), wall_ns=_WHOLE)),
    _foxglove("/tf", "FrameTransform"),
    _foxglove("/scene", "SceneUpdate"),
)


class Message(NamedTuple):
    """A message for the file; `t_ns` is the data's own time on CLOCK_MONOTONIC."""

    topic: str
    t_ns: int
    data: bytes


class ForViewers:
    """Makes the messages that viewers draw for each pose; the scene at most every `scene_period_ns`."""

    def __init__(self, frame_id: str, child_frame_id: str, scene_period_ns: int):
        self._pose = foxglove.PoseEncoder(frame_id, child_frame_id)
        self._scene = foxglove.Scene(frame_id, child_frame_id)
        self._period_ns, self._drawn_ns = scene_period_ns, -scene_period_ns

    def pose(self, pose: Pose, wall_ns: int) -> list[Message]:
        """The messages for a pose; `wall_ns` is CLOCK_REALTIME at `pose.t_ns`."""
        messages = [
            Message("/pose", pose.t_ns, self._pose.in_frame(pose, wall_ns)),
            Message("/tf", pose.t_ns, self._pose.transform(pose, wall_ns)),
        ]
        self._scene.add(pose)
        # Time running backwards means another run of the daemon, whose clock may have restarted.
        if not 0 <= pose.t_ns - self._drawn_ns < self._period_ns:
            self._drawn_ns = pose.t_ns
            messages.append(Message("/scene", pose.t_ns, self._scene.encode(pose, wall_ns)))
        return messages


class Encoder:
    """Messages of each kind; the methods' names are the kinds. `output` gives the frames' names.

    `viewers`: also make the messages that are only for drawing.
    """

    def __init__(self, output: Output, viewers: bool):
        frames = output.frame_id, output.child_frame_id
        self._odometry = OdometryEncoder(*frames)
        self._viewers = ForViewers(*frames, SCENE_PERIOD_NS) if viewers else None
        self.by_kind: dict[str, Callable[..., list[Message]]] = {
            "fog_bytes": self._fog_bytes,
            "frames": self._frames,
            "event": self._event,
            "gyro": self._gyro,
            "wheels": self._wheels,
            "pose": self._pose,
            "health": self._health,
            "findings": self._findings,
        }

    def _fog_bytes(self, data: bytes, arrival_ns: int) -> list[Message]:
        return [Message(RAW_FOG, arrival_ns, encode({"monotonic_ns": arrival_ns, "data": data}))]

    def _frames(self, frames: Sequence[CanFrame]) -> list[Message]:
        rows = [{"monotonic_ns": f.t_ns, "can_id": f.can_id, "extended": f.extended, "data": f.data} for f in frames]
        return [Message(RAW_CAN, frames[-1].t_ns, encode({"frames": rows}))]

    def _event(self, name: str, now_ns: int, values: Mapping[str, Any]) -> list[Message]:
        return [Message(RAW_EVENTS, now_ns, encode({"event": name, "monotonic_ns": now_ns, **values}))]

    def _gyro(self, sample: GyroSample) -> list[Message]:
        return [Message("/fog", sample.t_ns, _sample(sample))]

    def _wheels(self, sample: WheelSample) -> list[Message]:
        return [Message("/wheels", sample.t_ns, _sample(sample))]

    def _pose(self, pose: Pose, wall_ns: int) -> list[Message]:
        published = pose_dict(pose, wall_ns)
        for row, reason in zip(published["reasons"], pose.reasons, strict=True):
            row["since_ns"] = reason.since_ns  # since_s is rounded
        messages = [
            Message(POSE, pose.t_ns, encode(published)),
            Message("/odom", pose.t_ns, self._odometry.encode(pose, wall_ns)),
        ]
        return messages + self._viewers.pose(pose, wall_ns) if self._viewers is not None else messages

    def _health(self, health: Mapping[str, Any]) -> list[Message]:
        return [Message("/health", health["monotonic_ns"], encode(health))]

    def _findings(self, findings: Mapping[str, Any]) -> list[Message]:
        return [Message("/findings", findings["monotonic_ns"], encode(findings))]


def _sample(sample: GyroSample | WheelSample) -> bytes:
    values = sample._asdict()
    return encode({"monotonic_ns": values.pop("t_ns"), **values})
