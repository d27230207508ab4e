"""How ROS 2's rmw_zenoh names things on Zenoh, for one publisher of nav_msgs/Odometry.

Source: ros2/rmw_zenoh, rmw_zenoh_cpp/src/detail (liveliness_utils.cpp, attachment_helpers.cpp, qos.cpp).
"""

import hashlib
import re
import struct
from dataclasses import dataclass

ODOMETRY_TYPE = "nav_msgs::msg::dds_::Odometry_"
# REP-2016 type hash of nav_msgs/msg/Odometry; the same from Iron to Kilted. Another hash is another key: no delivery.
ODOMETRY_HASH = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
# What Humble, which has no type hashes, puts in the hash's place.
HUMBLE_HASH = "TypeHashNotSupported"
# reliability:durability:history,depth:deadline:lifespan:liveliness, numbers of rmw/types.h: reliable, volatile, keep
# the last 10. Empty fields mean the default, and durability's default differs between versions: it is written out.
QOS = "1:2:1,10:,:,:,,"
NODE_NAME = "drd"

_TOPIC = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_ATTACHMENT = struct.Struct("<qqB16s")


@dataclass(frozen=True)
class Ros2Odometry:
    """The names of one Odometry publisher. `zid` is the Zenoh session's id in hex."""

    domain: int
    topic: str  # without outer slashes
    type_hash: str
    zid: str

    @property
    def key(self) -> str:
        """The Zenoh key of the topic."""
        return f"{self.domain}/{self.topic}/{ODOMETRY_TYPE}/{self.type_hash}"

    @property
    def node_token(self) -> str:
        """Liveliness key that makes the node visible; its namespace is the topic's."""
        return f"@ros2_lv/{self.domain}/{self.zid}/0/0/NN/{self._names}"

    @property
    def publisher_token(self) -> str:
        """Liveliness key that makes the publisher visible."""
        topic = _mangled("/" + self.topic)
        return f"@ros2_lv/{self.domain}/{self.zid}/0/1/MP/{self._names}/{topic}/{ODOMETRY_TYPE}/{self.type_hash}/{QOS}"

    @property
    def gid(self) -> bytes:
        """16 bytes that identify the publisher. rmw_zenoh takes XXH3-128 of the same text; any stable value does."""
        return hashlib.sha256(self.publisher_token.encode()).digest()[:16]

    @property
    def _names(self) -> str:
        """Enclave (none), namespace and node."""
        return f"%/{_mangled('/' + self.topic.rpartition('/')[0])}/{NODE_NAME}"


def topic_name(text: str) -> str | None:
    """The topic without outer slashes, or None where ROS 2 would not take the name (names.md of the ROS 2 design)."""
    name = text.strip("/")
    return name if _TOPIC.fullmatch(name) else None


def attachment(sequence: int, wall_ns: int, gid: bytes) -> bytes:
    """What every sample must carry, else rmw_zenoh drops it: 33 bytes; `sequence` starts at 1."""
    return _ATTACHMENT.pack(sequence, wall_ns, len(gid), gid)


def _mangled(name: str) -> str:
    return name.replace("/", "%")
