import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from drd.output.cdr import UNKNOWN_VARIANCE, OdometryEncoder
from drd.samples import Pose, Validity

ROS2 = get_typestore(Stores.ROS2_HUMBLE)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
NAMES = st.text(alphabet=st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=30)


def a_pose(**changes: Any) -> Pose:
    values: dict[str, Any] = {
        "t_ns": 1,
        "sequence": 1,
        "x_m": 1.0,
        "y_m": 2.0,
        "heading_rad": 0.5,
        "speed_m_s": 3.0,
        "rate_rad_s": 4.0,
        "speed_sigma_m_s": 0.5,
        "rate_sigma_rad_s": 0.25,
        "covariance": (11.0, 12.0, 16.0, 22.0, 26.0, 66.0),
        "position_bound_m": 0.1,
        "validity": Validity.VALID,
        "reasons": (),
    }
    return Pose(**(values | changes))


def decode(data: bytes) -> Any:
    return ROS2.deserialize_cdr(data, "nav_msgs/msg/Odometry")


def test_odom_and_base_link_take_724_bytes_behind_a_little_endian_header() -> None:
    data = OdometryEncoder("odom", "base_link").encode(a_pose(), 1_000_000_002)
    assert len(data) == 724
    assert data.hex(" ").startswith(
        "00 01 00 00 01 00 00 00 02 00 00 00 05 00 00 00 6f 64 6f 6d 00 00 00 00 0a 00 00 00 62 61 73 65"
    )


@given(NAMES, NAMES, st.integers(0, 2**62), st.tuples(*[FINITE] * 4), st.tuples(*[FINITE] * 6))
@settings(deadline=None)
def test_another_decoder_reads_what_was_sent(
    frame: str, child: str, wall_ns: int, state: tuple[float, ...], covariance: tuple[float, ...]
) -> None:
    x_m, y_m, speed_m_s, rate_rad_s = state
    pose = a_pose(x_m=x_m, y_m=y_m, speed_m_s=speed_m_s, rate_rad_s=rate_rad_s, covariance=covariance)
    message = decode(OdometryEncoder(frame, child).encode(pose, wall_ns))
    assert (message.header.frame_id, message.child_frame_id) == (frame, child)
    stamp = message.header.stamp
    assert stamp.sec == min(wall_ns // 10**9, 2**31 - 1)
    assert stamp.nanosec == wall_ns % 10**9
    position, linear, angular = message.pose.pose.position, message.twist.twist.linear, message.twist.twist.angular
    assert (position.x, position.y, position.z) == (x_m, y_m, 0.0)
    assert (linear.x, linear.y, linear.z) == (speed_m_s, 0.0, 0.0)
    assert (angular.x, angular.y, angular.z) == (0.0, 0.0, rate_rad_s)
    matrix = message.pose.covariance.reshape(6, 6)
    xx, xy, xh, yy, yh, hh = covariance
    assert matrix[[0, 1, 5]][:, [0, 1, 5]].tolist() == [[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]]


@given(st.floats(-1e4, 1e4))
@settings(deadline=None)
def test_the_quaternion_is_a_turn_about_the_vertical_by_the_heading(heading_rad: float) -> None:
    q = decode(OdometryEncoder("a", "b").encode(a_pose(heading_rad=heading_rad), 0)).pose.pose.orientation
    assert (q.x, q.y) == (0.0, 0.0)
    assert math.hypot(q.z, q.w) == pytest.approx(1.0)
    assert 1 - 2 * q.z**2 == pytest.approx(math.cos(heading_rad), abs=1e-11)
    assert 2 * q.w * q.z == pytest.approx(math.sin(heading_rad), abs=1e-11)


def test_what_a_planar_robot_does_not_observe_is_said_to_be_unknown() -> None:
    message = decode(OdometryEncoder("odom", "base_link").encode(a_pose(), 0))
    matrix = message.pose.covariance.reshape(6, 6)
    assert matrix.diagonal().tolist() == [11.0, 22.0, UNKNOWN_VARIANCE, UNKNOWN_VARIANCE, UNKNOWN_VARIANCE, 66.0]
    assert matrix[2:5].sum() == matrix[:, 2:5].sum() == 3 * UNKNOWN_VARIANCE
    twist = message.twist.covariance.reshape(6, 6)
    assert twist.diagonal().tolist() == [0.25, *[UNKNOWN_VARIANCE] * 4, 0.0625]
    assert twist.sum() == 4 * UNKNOWN_VARIANCE + 0.3125


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_pose_that_is_not_finite_is_encoded_all_the_same(bad: float) -> None:
    message = decode(OdometryEncoder("a", "b").encode(a_pose(heading_rad=bad, x_m=bad), -1))
    assert math.isnan(message.pose.pose.orientation.w)
    assert not math.isfinite(message.pose.pose.position.x)


def test_nothing_of_one_pose_is_left_in_the_next() -> None:
    encoder = OdometryEncoder("odom", "base_link")
    first = encoder.encode(a_pose(), 5)
    encoder.encode(a_pose(x_m=9.0, heading_rad=-2.0, covariance=(1, 2, 3, 4, 5, 6)), 6)
    assert encoder.encode(a_pose(), 5) == first
