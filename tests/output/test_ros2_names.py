import struct

import pytest
import zenoh
import zenoh.ext
from rosbags.typesys import Stores, get_typestore

from drd.output import ros2

ZID = "8b20917502ee955ac4476e0266340d5c"


def test_the_topic_key_is_domain_topic_type_and_hash() -> None:
    names = ros2.Ros2Odometry(2, "robot1/odom", ros2.ODOMETRY_HASH, ZID)
    assert names.key == (
        "2/robot1/odom/nav_msgs::msg::dds_::Odometry_/"
        "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
    )


def test_the_hash_is_what_an_independent_implementation_computes() -> None:
    assert get_typestore(Stores.ROS2_JAZZY).hash_rihs01("nav_msgs/msg/Odometry") == ros2.ODOMETRY_HASH


def test_humble_has_no_hashes() -> None:
    names = ros2.Ros2Odometry(0, "odom", ros2.HUMBLE_HASH, ZID)
    assert names.key == "0/odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported"


def test_node_and_publisher_tokens_have_their_slashes_mangled() -> None:
    names = ros2.Ros2Odometry(0, "odom", ros2.HUMBLE_HASH, ZID)
    assert names.node_token == f"@ros2_lv/0/{ZID}/0/0/NN/%/%/drd"
    assert names.publisher_token == (
        f"@ros2_lv/0/{ZID}/0/1/MP/%/%/drd/%odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported/1:2:1,10:,:,:,,"
    )


def test_a_topic_in_a_namespace_puts_the_node_there_too() -> None:
    names = ros2.Ros2Odometry(0, "fleet/robot1/odom", ros2.HUMBLE_HASH, ZID)
    assert names.node_token.endswith("/NN/%/%fleet%robot1/drd")
    assert "/MP/%/%fleet%robot1/drd/%fleet%robot1%odom/" in names.publisher_token


def test_tokens_and_keys_are_valid_zenoh_keys() -> None:
    names = ros2.Ros2Odometry(0, "a/odom", ros2.ODOMETRY_HASH, ZID)
    for key in (names.key, names.node_token, names.publisher_token):
        assert str(zenoh.KeyExpr(key)) == key


def test_the_gid_is_16_bytes_stable_and_the_publishers_own() -> None:
    one, two = (ros2.Ros2Odometry(0, topic, ros2.ODOMETRY_HASH, ZID) for topic in ("odom", "odom2"))
    assert len(one.gid) == 16
    assert one.gid == ros2.Ros2Odometry(0, "odom", ros2.ODOMETRY_HASH, ZID).gid
    assert one.gid != two.gid


def test_the_attachment_is_what_zenohs_own_serializer_makes() -> None:
    gid = bytes(range(16))
    data = ros2.attachment(3, 1_700_000_000_000_000_000, gid)
    fields = (zenoh.ext.Int64(3), zenoh.ext.Int64(1_700_000_000_000_000_000), gid)
    assert data == zenoh.ext.z_serialize(fields).to_bytes()
    assert len(data) == 33
    assert struct.unpack("<q", data[:8]) == (3,)


@pytest.mark.parametrize(("text", "name"), [("odom", "odom"), ("/odom", "odom"), ("/a/b_2/odom/", "a/b_2/odom")])
def test_outer_slashes_of_a_topic_do_not_matter(text: str, name: str) -> None:
    assert ros2.topic_name(text) == name


@pytest.mark.parametrize("text", ["/", "a//b", "2odom", "odom*", "a/**", "od om", "~/odom", "ödom", "a?b"])
def test_a_name_that_ros_2_would_not_take_is_none(text: str) -> None:
    assert ros2.topic_name(text) is None
