"""The daemon as a node of rmw_zenoh, over the loopback; messages are read and written by rosbags, not by drd."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any

import numpy as np
import pytest
import zenoh
import zenoh.ext
from links import HANDLERS, POSE, a_link, first_sample, subscribe
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drd.config.keys import Ros2Topics
from drd.output import ros2
from drd.output.diagnostics import OK, WARN, diagnostics
from drd.output.forms import pose_request
from drd.output.messages import Refused
from drd.samples import WheelTurns

STORE = get_typestore(Stores.ROS2_KILTED)
STORE.register(
    get_types_from_msg("geometry_msgs/PoseWithCovarianceStamped pose", "robot_localization/msg/SetPose_Request")
    | get_types_from_msg("uint8 structure_needs_at_least_one_member", "std_srvs/msg/Trigger_Request")
    | get_types_from_msg("bool success\nstring message", "std_srvs/msg/Trigger_Response")
)
WALL_NS = 1_700_000_000_000_000_001
GID = bytes(range(16))
TIMES_NS = count(1)  # each sample of the wheels has a later one
TURNS = WheelTurns(9, 1.5, -2.5, 0.25, -0.5)
HEALTH = {
    "robot": "carl",
    "validity": "degraded",
    "reasons": [{"source": "fog", "text": "silent", "since_s": 1.0}],
    "wall_ns": WALL_NS,
    "pose_rate_hz": 20.0,
    "recording": None,
}
TYPES = {
    "robot1/odom": "nav_msgs/msg/Odometry",
    "tf": "tf2_msgs/msg/TFMessage",
    "robot1/imu": "sensor_msgs/msg/Imu",
    "robot1/joint_states": "sensor_msgs/msg/JointState",
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
ROBOT1 = {"ros2": True, "ros2_topic": "/robot1/odom", "ros2_joints": ("left", "right")}


def publish(link: Any) -> None:
    link.publish_pose(POSE, WALL_NS)
    link.publish_turns(TURNS._replace(t_ns=next(TIMES_NS)), WALL_NS)
    link.publish_health(HEALTH)


def first(link: Any, other: Any, key: str) -> bytes:
    data: bytes = first_sample(subscribe(other, key), lambda: publish(link)).payload.to_bytes()
    return data


def dds(type_name: str) -> str:
    package, folder, name = type_name.split("/")
    return f"{package}::{folder}::dds_::{name}_"


def kinds_of(attachment: Any) -> tuple[int, int, bytes]:
    kinds: Any = tuple[zenoh.ext.Int64, zenoh.ext.Int64, bytes]
    sequence, stamp, gid = zenoh.ext.z_deserialize(kinds, attachment)
    return int(sequence), int(stamp), gid


@pytest.mark.parametrize("with_hash", [True, False])
@pytest.mark.parametrize("topic", TYPES)
def test_each_topic_has_its_key_attachment_and_message(topic: str, with_hash: bool) -> None:
    with a_link(**ROBOT1, ros2_domain=3, ros2_hash=with_hash) as (link, other):
        name = TYPES[topic]
        last = ros2.TYPE_HASHES[name] if with_hash else "TypeHashNotSupported"
        subscriber = subscribe(other, f"3/{topic}/{dds(name)}/{last}")
        sample = first_sample(subscriber, lambda: publish(link))
        STORE.deserialize_cdr(sample.payload.to_bytes(), name)
        sequence, stamp, gid = kinds_of(sample.attachment)
        assert (sequence >= 1, stamp, len(gid)) == (True, WALL_NS, 16)
        publish(link)
        following = kinds_of(subscriber.recv().attachment)
        assert following == (sequence + 1, WALL_NS, gid)


def test_node_publishers_and_services_are_visible() -> None:
    with a_link(**ROBOT1, commands=True) as (_, other):
        tokens = {str(r.ok.key_expr) for r in other.liveliness().get("@ros2_lv/**", timeout=5.0)}
        # behind domain, session, node and number
        seen = {tuple(token.split("/")[4:12]) for token in tokens}
    assert ("0", "NN", "%", "%robot1", "drd") in seen
    publishers = [("MP", topic, name) for topic, name in TYPES.items()]
    services = [
        ("SS", "robot1/set_pose", "robot_localization/srv/SetPose"),
        ("SS", "robot1/reset", "std_srvs/srv/Trigger"),
    ]
    expected = {(kind, f"%{topic.replace('/', '%')}", dds(name)) for kind, topic, name in publishers + services}
    assert {(parts[1], parts[5], parts[6]) for parts in seen if len(parts) > 5} == expected


def test_a_finding_is_a_warning_of_the_monitors_own() -> None:
    monitor = {"state": "running", "reason": None, "dropped": 0}
    found = {"text": "The left tyre loses air.", "until_ns": None}
    for findings, level, text in (([], OK, "running"), ([found], WARN, found["text"])):
        pose, told = diagnostics(HEALTH | {"monitor": monitor, "findings": findings})
        assert (told.level, told.name, told.message) == (level, "drd: monitor", text)
        assert pose == diagnostics(HEALTH)[0]


def test_the_sequence_of_ros_2_starts_at_1() -> None:
    with a_link(ros2=True) as (link, _):
        link.publish_pose(POSE, 1)
        assert link._ros2 is not None
        assert link._ros2.odometry.sequence == 1


def test_without_ros_2_nothing_of_it_is_announced() -> None:
    with a_link(commands=True) as (_, other):
        assert list(other.liveliness().get("@ros2_lv/**", timeout=5.0)) == []


def test_what_is_not_wanted_is_not_there() -> None:
    topics = Ros2Topics(tf=None, imu=None, diagnostics=None)
    with a_link(ros2=True, ros2_topics=topics) as (link, other):
        publish(link)
        assert not link.wants_turns  # no joint is named
        tokens = [str(r.ok.key_expr) for r in other.liveliness().get("@ros2_lv/**", timeout=5.0)]
        assert sorted(token.split("/")[5] for token in tokens) == ["MP", "NN"]
        assert link.counters["put_errors"] == 0


def test_joint_states_say_each_sample_once() -> None:
    with a_link(**ROBOT1) as (link, other):
        key = f"0/robot1/joint_states/{dds(TYPES['robot1/joint_states'])}/*"
        subscriber = subscribe(other, key)
        sample = first_sample(subscriber, lambda: publish(link))
        message: Any = STORE.deserialize_cdr(sample.payload.to_bytes(), "sensor_msgs/msg/JointState")
        assert (message.name, message.position.tolist()) == (["left", "right"], [1.5, -2.5])
        assert message.velocity.tolist() == [0.25, -0.5]
        while subscriber.try_recv():
            pass
        for t_ns, wall_ns in ((10**9, 1), (10**9, 2), (10**9 + 1, 3)):
            link.publish_turns(TURNS._replace(t_ns=t_ns), wall_ns)
        assert [kinds_of(subscriber.recv().attachment)[1] for _ in range(2)] == [1, 3]


def test_the_imu_is_in_the_robots_frame_and_the_transform_from_the_poses() -> None:
    with a_link(ros2=True, frame_id="world", child_frame_id="carl") as (link, other):
        imu: Any = STORE.deserialize_cdr(first(link, other, "0/imu/**"), "sensor_msgs/msg/Imu")
        tf: Any = STORE.deserialize_cdr(first(link, other, "0/tf/**"), "tf2_msgs/msg/TFMessage")
    assert imu.header.frame_id == "carl"
    [transform] = tf.transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("world", "carl")
    assert (transform.transform.translation.x, transform.transform.translation.y) == (POSE.x_m, POSE.y_m)


def test_diagnostics_tell_validity_and_reasons() -> None:
    with a_link(ros2=True) as (link, other):
        subscriber = subscribe(other, "0/diagnostics/**")
        sample = first_sample(subscriber, lambda: publish(link))
    message: Any = STORE.deserialize_cdr(sample.payload.to_bytes(), "diagnostic_msgs/msg/DiagnosticArray")
    [status] = message.status
    assert (status.level, status.name, status.hardware_id) == (1, "drd: pose", "carl")
    assert status.message == "degraded; fog: silent"
    values = {pair.key: pair.value for pair in status.values}
    assert (values["fog"], values["pose_rate_hz"]) == ("silent", "20")


@contextmanager
def a_service(**handlers: Any) -> Iterator[tuple[Any, Any]]:
    """What calls a service as rmw_zenoh's client does, and the link."""
    with a_link(HANDLERS | handlers, ros2=True, commands=True) as (link, other):

        def call(name: str, type_name: str, request: bytes, attachment: bytes | None) -> Any:
            key = f"0/{name}/{dds(type_name)}/{ros2.TYPE_HASHES[type_name]}"
            options: Any = {"target": zenoh.QueryTarget.ALL_COMPLETE, "timeout": 30.0}
            options["consolidation"] = zenoh.ConsolidationMode.NONE
            [reply] = other.get(key, payload=request, attachment=attachment, **options)
            return reply

        yield call, link


def an_ear() -> tuple[list[Any], Callable[[dict[str, Any]], dict[str, Any]]]:
    """A handler, and what it has been asked."""
    heard: list[Any] = []

    def hear(request: dict[str, Any]) -> dict[str, Any]:
        heard.append(request)
        return {}

    return heard, hear


def cdr(message: Any) -> bytes:
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def a_pose_request(frame_id: str = "odom", covariance: dict[int, float] | None = None, **turn: float) -> bytes:
    types: Any = STORE.types
    values = np.zeros(36)
    for i, value in (covariance or {}).items():
        values[i] = value
    orientation = types["geometry_msgs/msg/Quaternion"](**({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0} | turn))
    point = types["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=3.0)
    pose = types["geometry_msgs/msg/Pose"](position=point, orientation=orientation)
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](sec=5, nanosec=6), frame_id)
    with_covariance = types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=values)
    stamped = types["geometry_msgs/msg/PoseWithCovarianceStamped"](header=header, pose=with_covariance)
    return cdr(types["robot_localization/msg/SetPose_Request"](pose=stamped))


SET_POSE = ("set_pose", "robot_localization/srv/SetPose")
RESET = ("reset", "std_srvs/srv/Trigger")
EMPTY = b"\x00\x01\x00\x00\x00"
ATTACHMENT = ros2.attachment(41, 5, GID)


def test_set_pose_hears_the_planar_part_and_answers_its_client() -> None:
    heard, hear = an_ear()
    with a_service(set_pose=hear) as (call, link):
        covariance = {0: 0.04, 7: 0.01, 35: 0.25, 14: 9.0}
        reply = call(*SET_POSE, a_pose_request(covariance=covariance, z=np.sin(0.6), w=np.cos(0.6)), ATTACHMENT)
        assert reply.ok.payload.to_bytes() == EMPTY
        sequence, stamp, gid = kinds_of(reply.ok.attachment)
        assert (sequence, gid, stamp > WALL_NS) == (41, GID, True)
        assert link.counters["commands"] == 1
    assert heard == [
        {
            "x_m": 1.0,
            "y_m": 2.0,
            "heading_rad": pytest.approx(1.2),
            "sigma_m": pytest.approx(0.2),
            "sigma_rad": pytest.approx(0.5),
        }
    ]


@pytest.mark.parametrize("digits", [0.65, 0.7, 0.71, 0.77])
def test_a_quaternion_of_few_digits_tells_the_same_heading(digits: float) -> None:
    request = pose_request(a_pose_request(z=digits, w=digits), "odom")
    assert request["heading_rad"] == pytest.approx(np.pi / 2)


def test_the_larger_axis_of_a_turned_ellipse_counts() -> None:
    heard, hear = an_ear()
    with a_service(set_pose=hear) as (call, _):
        # axes 0.5 and 0.1 m, turned by 45 degrees
        call(*SET_POSE, a_pose_request("", {0: 0.13, 7: 0.13, 1: 0.12, 6: 0.12}), ATTACHMENT)
    assert heard[0]["sigma_m"] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("request_bytes", "text"),
    [
        (a_pose_request("map"), "frame_id"),
        (a_pose_request(w=0.0), "quaternion"),
        (a_pose_request(x=np.nan), "finite"),
        (a_pose_request(covariance={35: -1.0}), "covariance"),
        (a_pose_request()[:-8], "PoseWithCovarianceStamped"),
        (a_pose_request()[:9], "PoseWithCovarianceStamped"),
        (b"", "CDR"),
        (b"\x00\x00" + a_pose_request()[2:], "CDR"),
        (a_pose_request()[:12] + b"\xff\xff\xff\xff" + a_pose_request()[16:], "PoseWithCovarianceStamped"),
    ],
)
def test_what_is_no_pose_is_refused_and_counted(request_bytes: bytes, text: str) -> None:
    with a_service() as (call, link):
        reply = call(*SET_POSE, request_bytes, ATTACHMENT)
        assert text in reply.err.payload.to_string()
        assert (link.counters["query_errors"], link.counters["commands"]) == (1, 0)


def test_reset_tells_whether_it_was_done() -> None:
    def refuse(_: Any) -> Any:
        raise Refused("not now")

    for handler, expected in ((HANDLERS["reset"], (True, "")), (refuse, (False, "not now"))):
        with a_service(reset=handler) as (call, _):
            reply = call(*RESET, EMPTY, ATTACHMENT)
            answer: Any = STORE.deserialize_cdr(reply.ok.payload.to_bytes(), "std_srvs/msg/Trigger_Response")
            assert (answer.success, answer.message) == expected
            assert kinds_of(reply.ok.attachment)[0] == 41


@pytest.mark.parametrize("attachment", [None, b"", ATTACHMENT[:32], bytes(5000)])
@pytest.mark.parametrize("service", [SET_POSE, RESET])
def test_a_call_without_rmw_zenohs_attachment_is_an_error(service: tuple[str, str], attachment: bytes | None) -> None:
    with a_service() as (call, link):
        request = a_pose_request() if service is SET_POSE else EMPTY
        assert "attachment" in call(*service, request, attachment).err.payload.to_string()
        assert link.counters["commands"] == 0


def test_a_get_with_a_wildcard_calls_no_service() -> None:
    with a_link(ros2=True, commands=True) as (link, other):
        assert list(other.get("0/reset/**", payload=EMPTY, attachment=ATTACHMENT, timeout=5.0)) == []
        assert (link.counters["queries_refused"], link.counters["commands"]) == (1, 0)


def test_without_commands_there_are_no_services() -> None:
    with a_link(ros2=True) as (_, other):
        tokens = [str(r.ok.key_expr) for r in other.liveliness().get("@ros2_lv/**", timeout=5.0)]
        assert not any("/SS/" in token for token in tokens)
        assert list(other.get("0/reset/**", payload=EMPTY, attachment=ATTACHMENT, timeout=5.0)) == []
