"""The forms of queries and answers: JSON, or a ROS 2 service."""

import math
import time
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import zenoh

from drd.output import ros2
from drd.output.cdr import EMPTY, CdrReader, encode_trigger
from drd.output.messages import Refused, decode_request, encode

COMMANDS = ("set_pose", "reset", "calibrate_bias")
QUESTIONS = ("pose", "health", "findings", "config")


class Reply(NamedTuple):
    """An answer; `failed`: sent as Zenoh's error, for which ROS 2 services have no field."""

    payload: bytes
    encoding: zenoh.Encoding
    failed: bool = False
    attachment: bytes | None = None


class Form(ABC):
    """How a query is read and answered. `name`: the handler's; `key`: the queryable's; `complete` as Zenoh has it."""

    complete = False

    def __init__(self, name: str, key: str):
        self.name, self.key = name, key

    @abstractmethod
    def read(self, payload: bytes, attachment: bytes) -> dict[str, Any]:
        """The handler's request. Raises Refused."""

    @abstractmethod
    def answer(self, attachment: bytes, values: dict[str, Any]) -> Reply:
        """The answer with the handler's values; `attachment` is the query's."""

    @abstractmethod
    def refusal(self, attachment: bytes, text: str) -> Reply:
        """The answer that states why the request is refused."""


class JsonForm(Form):
    """A JSON object in both directions, without attachments."""

    def read(self, payload: bytes, attachment: bytes) -> dict[str, Any]:  # noqa: ARG002  # others' clients may have one
        """See Form."""
        return decode_request(payload)

    def answer(self, attachment: bytes, values: dict[str, Any]) -> Reply:  # noqa: ARG002
        """See Form."""
        return Reply(encode(values), zenoh.Encoding.APPLICATION_JSON)

    def refusal(self, attachment: bytes, text: str) -> Reply:  # noqa: ARG002
        """See Form."""
        return Reply(encode({"error": text}), zenoh.Encoding.APPLICATION_JSON, failed=True)


class _Service(Form):
    """A service of rmw_zenoh: CDR in both directions; the answer returns the request's attachment, `done`."""

    complete = True  # rmw_zenoh queries complete queryables only
    done: bytes

    def read(self, payload: bytes, attachment: bytes) -> dict[str, Any]:  # noqa: ARG002
        """See Form."""
        if len(attachment) != ros2.ATTACHMENT_BYTES:
            raise Refused(f"attachment of {len(attachment)} bytes; expected {ros2.ATTACHMENT_BYTES} of rmw_zenoh")
        return {}

    def answer(self, attachment: bytes, values: dict[str, Any]) -> Reply:  # noqa: ARG002
        """See Form."""
        return _reply(attachment, self.done)

    def refusal(self, attachment: bytes, text: str) -> Reply:  # noqa: ARG002
        """See Form."""
        return Reply(text.encode(), zenoh.Encoding.TEXT_PLAIN, failed=True)


def _reply(attachment: bytes, payload: bytes) -> Reply:
    echo = ros2.reply_attachment(attachment, time.time_ns())
    return Reply(payload, zenoh.Encoding.APPLICATION_CDR, attachment=echo)


class TriggerService(_Service):
    """std_srvs/Trigger: an empty request, and an answer that states success."""

    done = encode_trigger(True, "")

    def refusal(self, attachment: bytes, text: str) -> Reply:
        """See Form."""
        if len(attachment) != ros2.ATTACHMENT_BYTES:
            return super().refusal(attachment, text)
        return _reply(attachment, encode_trigger(False, text))


class SetPoseService(_Service):
    """robot_localization/SetPose: PoseWithCovarianceStamped in, nothing out; so a refusal can only be Zenoh's error.

    Only the planar part is used: x, y, yaw, the larger standard deviation of the position's ellipse, that of yaw.
    """

    done = EMPTY

    def __init__(self, name: str, key: str, frame_id: str):
        super().__init__(name, key)
        self._frame_id = frame_id

    def read(self, payload: bytes, attachment: bytes) -> dict[str, Any]:
        """See Form."""
        super().read(payload, attachment)
        return pose_request(payload, self._frame_id)


def pose_request(data: bytes, frame_id: str) -> dict[str, Any]:
    """Read a `set_pose` request from a geometry_msgs/PoseWithCovarianceStamped in CDR. Raises Refused.

    Its frame must be `frame_id` or empty.
    """
    try:
        reader = CdrReader(data)
        _, frame = reader.header()
        values = reader.doubles(43)  # position 3, quaternion 4, covariance 36 (row-major, REP-103)
    except ValueError as error:
        raise Refused(f"payload is not a PoseWithCovarianceStamped: {error}") from error
    if frame not in ("", frame_id):
        raise Refused(f"header.frame_id: expected {frame_id!r}, got {frame!r}")
    if not all(map(math.isfinite, values)):
        raise Refused("pose: expected finite numbers")
    x_m, y_m, _, qx, qy, qz, qw = values[:7]
    xx, xy, yx, yy, hh = (values[7 + i] for i in (0, 1, 6, 7, 35))
    if not 0.9 < math.hypot(qx, qy, qz, qw) < 1.1:  # loose: single precision, and values typed with few digits
        raise Refused("pose.orientation: expected a unit quaternion")
    if min(xx, yy, hh) < 0:
        raise Refused("pose.covariance: expected variances of at least 0")
    # Larger eigenvalue of the symmetric part.
    largest = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), 0.5 * (xy + yx))
    return {
        "x_m": x_m,
        "y_m": y_m,
        # Right for a quaternion of any length; 1 - 2 (qy^2 + qz^2) in place of the squares needs a unit one.
        "heading_rad": math.atan2(2 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz),
        "sigma_m": math.sqrt(largest),
        "sigma_rad": math.sqrt(hh),
    }
