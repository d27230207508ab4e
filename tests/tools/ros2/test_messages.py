"""What the node makes of the daemon's messages, without ROS 2."""

import json
import math

import pytest
from links import POSE

from drd.output.cdr import ImuEncoder, OdometryEncoder, TransformEncoder, encode_diagnostics
from drd.output.diagnostics import diagnostics
from drd_tools.ros2.messages import Messages

WALL_NS = 1_700_000_000_123_456_789
ODOMETRY = OdometryEncoder("odom", "base_link").encode(POSE, WALL_NS)
HEALTH = {"robot": "carl", "validity": "invalid", "reasons": [], "wall_ns": WALL_NS, "pose_rate_hz": 20.0}


def test_the_odometry_goes_on_as_it_is_and_the_rest_is_the_daemons_own() -> None:
    made = Messages().of_odometry(ODOMETRY)
    assert made == {
        "odom": ODOMETRY,
        "tf": TransformEncoder("odom", "base_link").encode(POSE, WALL_NS),
        "imu": ImuEncoder("base_link").encode(POSE, WALL_NS),
    }


def test_other_frames_are_put_in_the_place_of_the_daemons() -> None:
    messages = Messages("map", "")
    assert messages.of_odometry(ODOMETRY) == {
        "odom": OdometryEncoder("map", "base_link").encode(POSE, WALL_NS),
        "tf": TransformEncoder("map", "base_link").encode(POSE, WALL_NS),
        "imu": ImuEncoder("base_link").encode(POSE, WALL_NS),
    }
    assert messages.frame_id == "map"


def test_a_daemon_that_comes_back_with_other_frames_is_followed() -> None:
    messages = Messages()
    messages.of_odometry(ODOMETRY)
    other = OdometryEncoder("o", "b").encode(POSE, WALL_NS)
    assert messages.of_odometry(other)["tf"] == TransformEncoder("o", "b").encode(POSE, WALL_NS)
    assert messages.frame_id == "o"


def test_a_pose_that_is_not_known_goes_on_as_that() -> None:
    POSE_NAN = OdometryEncoder("odom", "base_link").encode(
        type(POSE)(**{f: getattr(POSE, f) for f in POSE.__slots__} | {"heading_rad": math.nan}), WALL_NS
    )
    made = Messages().of_odometry(POSE_NAN)
    assert made["odom"] == POSE_NAN


def test_health_becomes_diagnostics() -> None:
    made = Messages().of_health(json.dumps(HEALTH).encode())
    assert made == {"diagnostics": encode_diagnostics(diagnostics(HEALTH), WALL_NS)}


@pytest.mark.parametrize("data", [b"", b"\x00", ODOMETRY[:-1], ODOMETRY[:9], b"\x00\x00" + ODOMETRY[2:], bytes(2000)])
def test_what_is_no_odometry_is_an_error(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"CDR|short|text"):
        Messages().of_odometry(data)


@pytest.mark.parametrize("data", [b"", b"{}", b"[]", b"7", b'{"validity": "good"}', b"\xff"])
def test_what_is_no_health_is_an_error(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        Messages().of_health(data)
