import math
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from drd.output.cdr import (
    UNKNOWN_VARIANCE,
    Diagnostic,
    ImuEncoder,
    JointStateEncoder,
    OdometryEncoder,
    TransformEncoder,
    encode_diagnostics,
)
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


def decode(data: bytes, kind: str = "nav_msgs/msg/Odometry") -> Any:
    """What another implementation reads, which wrote the same bytes too."""
    message = ROS2.deserialize_cdr(data, kind)
    assert bytes(ROS2.serialize_cdr(message, kind)) == data
    return message


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


@given(NAMES, NAMES, st.integers(0, 2**60), st.tuples(FINITE, FINITE, st.floats(-1e4, 1e4)))
@settings(deadline=None)
def test_a_transform_is_the_pose_of_the_odometry(
    frame: str, child: str, wall_ns: int, state: tuple[float, ...]
) -> None:
    pose = a_pose(x_m=state[0], y_m=state[1], heading_rad=state[2])
    [transform] = decode(TransformEncoder(frame, child).encode(pose, wall_ns), "tf2_msgs/msg/TFMessage").transforms
    odometry = decode(OdometryEncoder(frame, child).encode(pose, wall_ns))
    assert (transform.header, transform.child_frame_id) == (odometry.header, child)
    assert transform.transform.rotation == odometry.pose.pose.orientation
    translation, position = transform.transform.translation, odometry.pose.pose.position
    assert (translation.x, translation.y, translation.z) == (position.x, position.y, position.z)


@given(NAMES)
@settings(deadline=None)
def test_an_imu_message_says_which_of_its_quantities_are_known(frame: str) -> None:
    message = decode(ImuEncoder(frame).encode(a_pose(), 3_000_000_004), "sensor_msgs/msg/Imu")
    stamp, q, rates = message.header.stamp, message.orientation, message.angular_velocity
    assert (message.header.frame_id, stamp.sec, stamp.nanosec) == (frame, 3, 4)
    assert (q.x, q.y, q.z, q.w) == (0.0, 0.0, pytest.approx(math.sin(0.25)), pytest.approx(math.cos(0.25)))
    assert (rates.x, rates.y, rates.z) == (0.0, 0.0, 4.0)
    unknown = [UNKNOWN_VARIANCE, 0, 0, 0, UNKNOWN_VARIANCE, 0, 0, 0]
    assert message.orientation_covariance.tolist() == [*unknown, 66.0]
    assert message.angular_velocity_covariance.tolist() == [*unknown, 0.0625]
    assert message.linear_acceleration_covariance.tolist() == [-1, 0, 0, 0, 0, 0, 0, 0, 0]


@given(st.lists(st.tuples(NAMES, FINITE, FINITE), max_size=4), st.booleans())
@settings(deadline=None)
def test_joint_states_keep_their_order(joints: list[tuple[str, float, float]], with_velocities: bool) -> None:
    names, positions, velocities = ([joint[i] for joint in joints] for i in range(3))
    encoder = JointStateEncoder(names)  # type: ignore[arg-type]
    data = encoder.encode(positions, velocities if with_velocities else (), 3_000_000_004)  # type: ignore[arg-type]
    message = decode(data, "sensor_msgs/msg/JointState")
    assert (message.header.frame_id, message.header.stamp.sec, message.header.stamp.nanosec) == ("", 3, 4)
    assert (message.name, message.position.tolist(), message.effort.tolist()) == (names, positions, [])
    assert message.velocity.tolist() == (velocities if with_velocities else [])


STATUS = st.tuples(st.integers(0, 3), NAMES, NAMES, NAMES, st.dictionaries(NAMES, NAMES, max_size=2))


# Drawing so many texts is slow where others use the machine, too.
@given(st.lists(STATUS, max_size=3))
@settings(deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow])
def test_diagnostics_keep_levels_texts_and_values(rows: list[Any]) -> None:
    statuses = [Diagnostic(*row) for row in rows]
    message = decode(encode_diagnostics(statuses, 3_000_000_004), "diagnostic_msgs/msg/DiagnosticArray")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 4)
    found = [
        Diagnostic(s.level, s.name, s.message, s.hardware_id, {v.key: v.value for v in s.values})
        for s in message.status
    ]
    assert found == statuses
