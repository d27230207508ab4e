"""The pose as Foxglove's Protobuf messages, which Foxglove and Rerun draw directly.

`PoseEncoder`: foxglove.FrameTransform and foxglove.PoseInFrame. `Scene`: foxglove.SceneUpdate with the path so far and
the bound. `SCHEMA` describes all three. Source: docs.foxglove.dev/docs/sdk/schemas.
"""

import math
import struct
from typing import Final

from drd.output.cdr import quaternion_zw
from drd.output.protobuf import double, doubles, field, schema_file, varint, whole
from drd.samples import Pose, Validity
from drd.units import NS_PER_S

_XYZ = "double x, double y, double z"
SCHEMA: Final = (
    schema_file("google/protobuf/timestamp.proto", "google.protobuf", {"Timestamp": "int64 seconds, int32 nanos"})
    + schema_file("google/protobuf/duration.proto", "google.protobuf", {"Duration": "int64 seconds, int32 nanos"})
    + schema_file(
        "foxglove.proto",
        "foxglove",
        {
            "Vector3": _XYZ,
            "Point3": _XYZ,
            "Quaternion": f"{_XYZ}, double w",
            "Pose": "Vector3 position, Quaternion orientation",
            "PoseInFrame": "Timestamp timestamp, string frame_id, Pose pose",
            "FrameTransform": "Timestamp timestamp, string parent_frame_id, string child_frame_id, "
            "Vector3 translation, Quaternion rotation",
            "Color": "double r, double g, double b, double a",
            "KeyValuePair": "string key, string value",
            "SceneEntityDeletion": "Timestamp timestamp, Type type, string id",
            "ArrowPrimitive": "Pose pose, double shaft_length, double shaft_diameter, double head_length, "
            "double head_diameter, Color color",
            "CubePrimitive": "Pose pose, Vector3 size, Color color",
            "SpherePrimitive": "Pose pose, Vector3 size, Color color",
            "CylinderPrimitive": "Pose pose, Vector3 size, double bottom_scale, double top_scale, Color color",
            "LinePrimitive": "Type type, Pose pose, double thickness, bool scale_invariant, repeated Point3 points, "
            "Color color, repeated Color colors, repeated fixed32 indices",
            "TriangleListPrimitive": "Pose pose, repeated Point3 points, Color color, repeated Color colors, "
            "repeated fixed32 indices",
            "TextPrimitive": "Pose pose, bool billboard, double font_size, bool scale_invariant, Color color, "
            "string text",
            "ModelPrimitive": "Pose pose, Vector3 scale, Color color, bool override_color, string url, "
            "string media_type, bytes data",
            "SceneEntity": "Timestamp timestamp, string frame_id, string id, Duration lifetime, bool frame_locked, "
            "repeated KeyValuePair metadata, repeated ArrowPrimitive arrows, repeated CubePrimitive cubes, "
            "repeated SpherePrimitive spheres, repeated CylinderPrimitive cylinders, repeated LinePrimitive lines, "
            "repeated TriangleListPrimitive triangles, repeated TextPrimitive texts, repeated ModelPrimitive models",
            "SceneUpdate": "repeated SceneEntityDeletion deletions, repeated SceneEntity entities",
        },
        {
            "SceneEntityDeletion.Type": ("MATCHING_ID", "ALL"),
            "LinePrimitive.Type": ("LINE_STRIP", "LINE_LOOP", "LINE_LIST"),
        },
        {"google/protobuf/timestamp.proto": ("Timestamp",), "google/protobuf/duration.proto": ("Duration",)},
    )
)

# x and y, then z and w of the quaternion, as two consecutive messages with the tags between the numbers.
_PLACE: Final = struct.Struct("<2sBdBd2sBdBd")
_POINT: Final = struct.Struct("<2sBdBd")
_X, _Y, _Z, _W = (number << 3 | 1 for number in (1, 2, 3, 4))

# A path is thinned to half at this many points: 20 kB, and steps of at most 2 m after a kilometre.
MOST_POINTS: Final = 1024
FIRST_STEP_M: Final = 0.05
# Points are on a grid of about a millimetre, so that the trailing zeros of each double compress well.
GRID_M: Final = 1.0 / 1024.0
# A step longer than the speed explains by this much was not driven: set_pose, reset, another run.
JUMP_M: Final = 1.0
PATH_PIXELS: Final = 3.0
DISC_M: Final = 0.01
# Red, green, blue, opacity.
PATH_COLOUR: Final = (0.2, 0.5, 1.0, 1.0)
BOUND_COLOURS: Final = {
    Validity.INITIALISING: (0.6, 0.6, 0.6, 0.3),
    Validity.VALID: (0.2, 0.8, 0.3, 0.3),
    Validity.DEGRADED: (1.0, 0.7, 0.1, 0.3),
    Validity.INVALID: (0.9, 0.2, 0.2, 0.3),
}


class PoseEncoder:
    """Encodes poses of one pair of frames."""

    def __init__(self, frame_id: str, child_frame_id: str):
        self._in_frame = field(2, frame_id) + b"\x1a" + varint(_PLACE.size)
        self._transform = field(2, frame_id) + field(3, child_frame_id)

    def in_frame(self, pose: Pose, wall_ns: int) -> bytes:
        """A foxglove.PoseInFrame; `wall_ns` is CLOCK_REALTIME at `pose.t_ns`."""
        return _stamp(wall_ns) + self._in_frame + _place(pose, b"\x0a", b"\x12")

    def transform(self, pose: Pose, wall_ns: int) -> bytes:
        """A foxglove.FrameTransform from the odometry frame to the robot frame."""
        return _stamp(wall_ns) + self._transform + _place(pose, b"\x22", b"\x2a")


class Scene:
    """The path so far as one line, thinned when long, and the bound as a disc around the robot.

    The disc's colour shows the validity: green, amber (degraded), red (invalid) or grey (initialising).
    """

    def __init__(self, frame_id: str, child_frame_id: str):
        self._points = bytearray(MOST_POINTS * _POINT.size)
        self._count = 0
        self._step_m = FIRST_STEP_M
        self._last_m = (math.nan, math.nan)  # the newest point of the line
        self._before: Pose | None = None
        identity = field(1, b"") + field(2, doubles(w=1.0))
        for_ever = field(4, b"")  # a lifetime of 0 s, which some viewers require
        self._path = field(2, frame_id) + field(3, "path") + for_ever
        self._line = field(2, identity) + double(3, PATH_PIXELS) + whole(4, True) + field(6, _colour(PATH_COLOUR))
        self._bound = field(2, child_frame_id) + field(3, "bound") + for_ever + whole(5, True)
        self._disc = field(1, identity) + double(3, 1.0) + double(4, 1.0)
        self._colours = {v: field(5, _colour(c)) for v, c in BOUND_COLOURS.items()}

    def add(self, pose: Pose) -> None:
        """Extend the path once the robot has moved far enough; after a jump, start it anew."""
        x_m, y_m = pose.x_m, pose.y_m
        if not (math.isfinite(x_m) and math.isfinite(y_m)):
            return
        before, self._before = self._before, pose
        if before is not None:
            seconds = abs(pose.t_ns - before.t_ns) / NS_PER_S
            fastest_m_s = max(abs(pose.speed_m_s), abs(before.speed_m_s))
            if math.hypot(x_m - before.x_m, y_m - before.y_m) > JUMP_M + 2.0 * fastest_m_s * seconds:
                self._count, self._step_m, self._last_m = 0, FIRST_STEP_M, (math.nan, math.nan)
        if math.hypot(x_m - self._last_m[0], y_m - self._last_m[1]) < self._step_m:
            return
        if self._count == MOST_POINTS:
            self._thin()
        self._last_m = (x_m, y_m)
        x_m, y_m = ((value / GRID_M + 0.5) // 1.0 * GRID_M for value in (x_m, y_m))
        _POINT.pack_into(self._points, self._count * _POINT.size, b"\x2a\x12", _X, x_m, _Y, y_m)
        self._count += 1

    def encode(self, pose: Pose, wall_ns: int) -> bytes:
        """A foxglove.SceneUpdate with the path up to `pose`, and the bound there."""
        stamp = _stamp(wall_ns)
        points = bytes(memoryview(self._points)[: self._count * _POINT.size])
        path = stamp + self._path + field(11, self._line + points)
        across_m = 2.0 * pose.position_bound_m if math.isfinite(pose.position_bound_m) else 0.0
        size = field(2, doubles(x=across_m, y=across_m, z=DISC_M))
        bound = stamp + self._bound + field(10, self._disc + size + self._colours[pose.validity])
        return field(2, path) + field(2, bound)

    def _thin(self) -> None:
        """Keep every second point, including the first."""
        size = _POINT.size
        kept = [self._points[i * size : (i + 1) * size] for i in range(0, self._count, 2)]
        self._points[: len(kept) * size] = b"".join(kept)
        self._count, self._step_m = len(kept), 2.0 * self._step_m


def _place(pose: Pose, position: bytes, orientation: bytes) -> bytes:
    """Position and orientation, each after the tag of its field."""
    z, w = quaternion_zw(pose.heading_rad)
    return _PLACE.pack(position + b"\x12", _X, pose.x_m, _Y, pose.y_m, orientation + b"\x12", _Z, z, _W, w)


def _stamp(wall_ns: int) -> bytes:
    """Field 1 of all messages: google.protobuf.Timestamp."""
    seconds, nanoseconds = divmod(wall_ns, NS_PER_S)
    return field(1, whole(1, seconds) + whole(2, nanoseconds))


def _colour(rgba: tuple[float, float, float, float]) -> bytes:
    return b"".join(double(number, value) for number, value in enumerate(rgba, 1))
