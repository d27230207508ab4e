import struct

import pytest
import zenoh
import zenoh.ext
from type_hashes import definitions, type_hash

from drd.output import ros2

ZID = "8b20917502ee955ac4476e0266340d5c"
ODOMETRY = "nav_msgs/msg/Odometry"


def a_node(namespace: str = "", *, with_hash: bool = False) -> ros2.Ros2Node:
    return ros2.Ros2Node(0, namespace, with_hash, ZID)


@pytest.mark.parametrize("name", ros2.TYPE_HASHES)
def test_a_types_hash_is_that_of_its_definition(name: str) -> None:
    assert type_hash(name, definitions()) == ros2.TYPE_HASHES[name]


def test_a_hash_of_ros_2s_own_packages_comes_out_of_the_computation() -> None:
    # share/std_srvs/srv/Trigger.json of std_srvs 5.5.1, whose parts rosidl itself has hashed.
    types = definitions()
    assert type_hash("std_srvs/srv/Trigger", types).startswith("RIHS01_eeff2cd6fa5ad9d2")
    assert type_hash("std_srvs/srv/Trigger_Event", types).startswith("RIHS01_ec4a1d26b0575e61")


def test_the_topic_key_is_domain_topic_type_and_hash() -> None:
    assert ros2.Ros2Node(2, "robot1", True, ZID).publisher("robot1/odom", ODOMETRY).key == (
        "2/robot1/odom/nav_msgs::msg::dds_::Odometry_/"
        "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
    )


def test_the_key_of_a_service_is_formed_alike() -> None:
    service = a_node(with_hash=True).service("reset", "std_srvs/srv/Trigger")
    assert service.key.startswith("0/reset/std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6")
    assert "/0/1/SS/%/%/drd/%reset/std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6" in service.token


def test_humble_has_no_hashes() -> None:
    assert a_node().publisher("odom", ODOMETRY).key == "0/odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported"


def test_node_and_publisher_tokens_have_their_slashes_mangled() -> None:
    node = a_node()
    assert node.publisher("odom", ODOMETRY).token == (
        f"@ros2_lv/0/{ZID}/0/1/MP/%/%/drd/%odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported/1:2:1,10:,:,:,,"
    )
    assert node.tokens == [f"@ros2_lv/0/{ZID}/0/0/NN/%/%/drd", node.tokens[1]]


def test_a_topic_in_a_namespace_puts_the_node_there_too() -> None:
    node = a_node("fleet/robot1")
    token = node.publisher("fleet/robot1/odom", ODOMETRY).token
    assert node.tokens[0].endswith("/NN/%/%fleet%robot1/drd")
    assert "/MP/%/%fleet%robot1/drd/%fleet%robot1%odom/" in token


def test_each_endpoint_of_a_node_has_a_number_of_its_own() -> None:
    node = a_node()
    tokens = [node.publisher("a", ODOMETRY).token, node.service("b", "std_srvs/srv/Trigger").token]
    assert [token.split("/")[4] for token in tokens] == ["1", "2"]
    assert node.tokens[1:] == tokens


def test_tokens_and_keys_are_valid_zenoh_keys() -> None:
    node = a_node("a", with_hash=True)
    for key in (node.publisher("a/odom", ODOMETRY).key, *node.tokens):
        assert str(zenoh.KeyExpr(key)) == key


def test_the_gid_is_16_bytes_stable_and_the_publishers_own() -> None:
    one, two = (a_node().publisher(topic, ODOMETRY) for topic in ("odom", "odom2"))
    assert len(one.gid) == 16
    assert one.gid == a_node().publisher("odom", ODOMETRY).gid
    assert one.gid != two.gid


def test_the_attachment_is_what_zenohs_own_serializer_makes() -> None:
    gid = bytes(range(16))
    data = ros2.attachment(3, 1_700_000_000_000_000_000, gid)
    fields = (zenoh.ext.Int64(3), zenoh.ext.Int64(1_700_000_000_000_000_000), gid)
    assert data == zenoh.ext.z_serialize(fields).to_bytes()
    assert len(data) == ros2.ATTACHMENT_BYTES == 33
    assert struct.unpack("<q", data[:8]) == (3,)


def test_a_reply_carries_the_requests_number_and_client_at_its_own_time() -> None:
    gid = bytes(range(16))
    assert ros2.reply_attachment(ros2.attachment(7, 1, gid), 99) == ros2.attachment(7, 99, gid)


@pytest.mark.parametrize(("text", "name"), [("odom", "odom"), ("/odom", "odom"), ("/a/b_2/odom/", "a/b_2/odom")])
def test_outer_slashes_of_a_topic_do_not_matter(text: str, name: str) -> None:
    assert ros2.topic_name(text) == name


@pytest.mark.parametrize("text", ["/", "a//b", "2odom", "odom*", "a/**", "od om", "~/odom", "ödom", "a?b"])
def test_a_name_that_ros_2_would_not_take_is_none(text: str) -> None:
    assert ros2.topic_name(text) is None


@pytest.mark.parametrize(
    ("namespace", "topic", "name"),
    [("", "imu", "imu"), ("a/b", "imu", "a/b/imu"), ("a", "/tf", "tf"), ("a", "imu/data", "a/imu/data")],
)
def test_a_topic_is_in_the_namespace_unless_it_is_absolute(namespace: str, topic: str, name: str) -> None:
    assert ros2.in_namespace(namespace, topic) == name
