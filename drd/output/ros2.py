"""Zenoh keys of a ROS 2 node, its publishers and services, as rmw_zenoh forms them.

Source: ros2/rmw_zenoh, rmw_zenoh_cpp/src/detail (liveliness_utils.cpp, attachment_helpers.cpp, qos.cpp,
rmw_service_data.cpp).
"""

import hashlib
import re
import struct
from dataclasses import dataclass, field
from typing import Final, NamedTuple

# REP-2016 hashes of all types in use; the same from Iron to Kilted. A wrong hash gives another key: no delivery.
TYPE_HASHES: Final = {
    "nav_msgs/msg/Odometry": "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "sensor_msgs/msg/Imu": "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    "sensor_msgs/msg/JointState": "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "diagnostic_msgs/msg/DiagnosticArray": "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    "robot_localization/srv/SetPose": "RIHS01_ba31db4232f0c06c0f43eb6c73e84d08cba08d54061698d13310fa4ccbe46c63",
    "std_srvs/srv/Trigger": "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
}
# Used in place of the hash by Humble, which has no type hashes.
HUMBLE_HASH: Final = "TypeHashNotSupported"
# reliability:durability:history,depth:deadline:lifespan:liveliness, numbers of rmw/types.h: reliable, volatile, keep
# the last 10. Empty fields mean the default; durability is written out since its default differs between versions.
QOS: Final = "1:2:1,10:,:,:,,"
NODE_NAME: Final = "drd"
ATTACHMENT_BYTES: Final = 33

_TOPIC = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_ATTACHMENT = struct.Struct("<qqB16s")


class Endpoint(NamedTuple):
    """A publisher or service: its Zenoh key, and the liveliness key that makes it visible."""

    key: str
    token: str

    @property
    def gid(self) -> bytes:
        """16 bytes that identify the publisher. rmw_zenoh takes XXH3-128 of the same text; any stable value does."""
        return hashlib.sha256(self.token.encode()).digest()[:16]


@dataclass
class Ros2Node:
    """The keys of one node. `zid` is the Zenoh session's id in hex, `namespace` has no outer slashes."""

    domain: int
    namespace: str
    with_hash: bool
    zid: str
    tokens: list[str] = field(init=False)

    def __post_init__(self) -> None:
        self.tokens = [f"@ros2_lv/{self.domain}/{self.zid}/0/0/NN/{self._names}"]

    def publisher(self, topic: str, type_name: str) -> Endpoint:
        """A new publisher; `topic` includes its namespace and has no outer slashes."""
        return self._endpoint("MP", topic, type_name)

    def service(self, name: str, type_name: str) -> Endpoint:
        """A new service, named like a topic."""
        return self._endpoint("SS", name, type_name)

    def _endpoint(self, kind: str, name: str, type_name: str) -> Endpoint:
        package, folder, last = type_name.split("/")
        dds_type = f"{package}::{folder}::dds_::{last}_"
        type_hash = TYPE_HASHES[type_name] if self.with_hash else HUMBLE_HASH
        token = (
            f"@ros2_lv/{self.domain}/{self.zid}/0/{len(self.tokens)}/{kind}/{self._names}/{_mangled('/' + name)}"
            f"/{dds_type}/{type_hash}/{QOS}"
        )
        self.tokens.append(token)
        return Endpoint(f"{self.domain}/{name}/{dds_type}/{type_hash}", token)

    @property
    def _names(self) -> str:
        """Enclave (none), namespace and node."""
        return f"%/{_mangled('/' + self.namespace)}/{NODE_NAME}"


def topic_name(text: str) -> str | None:
    """The topic without outer slashes, or None if ROS 2 does not allow the name (names.md of the ROS 2 design)."""
    name = text.strip("/")
    return name if _TOPIC.fullmatch(name) else None


def in_namespace(namespace: str, topic: str) -> str:
    """Full name, without outer slashes, of a topic, which is relative unless it begins with a slash."""
    return topic.strip("/") if topic.startswith("/") or not namespace else f"{namespace}/{topic.strip('/')}"


def attachment(sequence: int, wall_ns: int, gid: bytes) -> bytes:
    """The attachment without which rmw_zenoh drops a sample: 33 bytes; `sequence` starts at 1."""
    return _ATTACHMENT.pack(sequence, wall_ns, len(gid), gid)


def reply_attachment(request: bytes, wall_ns: int) -> bytes:
    """The attachment of a service's reply: the request's own, which identifies it to the client, with a new time."""
    return request[:8] + struct.pack("<q", wall_ns) + request[16:]


def _mangled(name: str) -> str:
    return name.replace("/", "%")
