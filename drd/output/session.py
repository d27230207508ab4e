"""Zenoh sessions that connect only to configured endpoints: no scouting, no shared memory."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

from drd.config.keys import Output
from drd.config.schema import ConfigError
from drd.output.ros2 import topic_name
from drd.units import NS_PER_US

# Larger messages are dropped on arrival, before they take memory. Zenoh's own limit is 1 GiB.
MAX_MESSAGE_BYTES = 65_536
# Queue length per neighbour, for each priority that the publishers use. Zenoh's default of 2 fills up when Zenoh's
# sending thread waits for its turn on a busy machine: of three express messages of one pose the third was lost. 16 is
# Zenoh's maximum.
QUEUES = ("real_time", "interactive_high", "data")
QUEUED_MESSAGES = 16

# Messages allowed between a neighbour and the daemon. The rest is not forwarded either: Zenoh connects a session's
# neighbours with each other, so that without this anybody could publish a pose under our name.
# `**` does not match chunks that begin with @.
_ACCESS: dict[str, Any] = {
    "enabled": True,
    "default_permission": "deny",
    "rules": [
        {
            "id": "in",
            "permission": "allow",
            "flows": ["ingress"],
            "messages": ["declare_subscriber", "query", "liveliness_query", "declare_liveliness_subscriber"],
            "key_exprs": ["**", "@ros2_lv/**"],
        },
        {
            "id": "out",
            "permission": "allow",
            "flows": ["egress"],
            "messages": ["put", "reply", "declare_queryable", "liveliness_token"],
            "key_exprs": ["**", "@ros2_lv/**"],
        },
    ],
    "subjects": [{"id": "everybody"}],
    "policies": [{"rules": ["in", "out"], "subjects": ["everybody"]}],
}


_TLS_FILES = (
    "root_ca_certificate",
    "listen_certificate",
    "listen_private_key",
    "connect_certificate",
    "connect_private_key",
)


def isolated_config(mode: str, listen: tuple[str, ...], connect: tuple[str, ...]) -> zenoh.Config:
    """A configuration with only these endpoints. Raises zenoh.ZError for one that is malformed.

    Shared memory is off: it needs mlock and /dev/shm, which a sandbox refuses. Gossip, by which neighbours learn of
    each other, is on only if this session connects somewhere: without it a ROS 2 peer behind the same router never
    hears us. A failed connection is retried for ever and does not fail the start.
    """
    config = zenoh.Config()
    values: dict[str, Any] = {
        "mode": mode,
        "listen/endpoints": list(listen),
        "listen/timeout_ms": 0,
        "listen/exit_on_failure": True,
        "connect/endpoints": list(connect),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": bool(connect),
        "adminspace/enabled": False,
        "plugins_loading/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
    }
    if mode == "peer":
        values |= {"connect/timeout_ms": -1, "connect/exit_on_failure": False}
    for path, value in values.items():
        config.insert_json5(path, json.dumps(value))
    return config


def session_config(output: Output) -> zenoh.Config:
    """The daemon's configuration: `output.zenoh_config` unchanged, else a peer that receives queries only.

    Raises ConfigError for a file, zenoh.ZError for endpoints that cannot be used.
    """
    if output.zenoh_config is not None:
        return _from_file(output.zenoh_config)
    config = isolated_config("peer", output.listen, output.connect)
    config.insert_json5("transport/unicast/max_sessions", json.dumps(output.max_sessions))
    for priority in QUEUES:
        config.insert_json5(f"transport/link/tx/queue/size/{priority}", json.dumps(QUEUED_MESSAGES))
    config.insert_json5("access_control", json.dumps(_ACCESS))
    return config


class Limits(NamedTuple):
    """Zenoh's silent limits: simultaneous sessions, and how long a put waits for room before it is dropped."""

    sessions: int
    wait_ns: int


def limits(output: Output) -> Limits:
    """The limits in force. Raises as `session_config` does."""
    config = session_config(output)
    wait_us = value_of(config, "transport/link/tx/queue/congestion_control/drop/wait_before_drop")
    return Limits(value_of(config, "transport/unicast/max_sessions"), wait_us * NS_PER_US)


def value_of(config: zenoh.Config, path: str) -> Any:
    """The value at `path`, as JSON."""
    return json.loads(config.get_json(path))


def check_output(output: Output) -> None:
    """Check all that can be checked without opening a session. Raises ConfigError naming the key."""
    _check_ros2(output)
    if output.zenoh_config is not None:
        _from_file(output.zenoh_config)
        return
    for name, endpoints in (("listen", output.listen), ("connect", output.connect)):
        for endpoint in endpoints:
            try:
                isolated_config("peer", (endpoint,), ())
            except zenoh.ZError as error:
                got = f"{endpoint!r}: {tidy(error)}"
                raise ConfigError("configuration", f"output.{name}", "Zenoh endpoints", got) from error


def _check_ros2(output: Output) -> None:
    topics = {f"topics.{name}": topic for name, topic in dataclasses.asdict(output.ros2_topics).items()}
    for name, topic in {"topic": output.ros2_topic, **topics}.items():
        if topic is not None and topic_name(topic) is None:
            raise ConfigError("configuration", f"output.ros2_{name}", "a ROS 2 topic name", repr(topic))
    if len(output.ros2_joints) not in (0, 2):
        raise ConfigError("configuration", "output.ros2_joints", "two joints, or none", f"{len(output.ros2_joints)}")


def _from_file(file: str) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(Path(file))
    except zenoh.ZError as error:
        got = f"{file}: {tidy(error)}"
        raise ConfigError("configuration", "output.zenoh_config", "a Zenoh configuration file", got) from error


def open_session(output: Output) -> Any:
    """The daemon's session: from `output.zenoh_config` unchanged, else a peer with `listen` and `connect`.

    Returns within about 0.5 s, even if nothing answers at `connect`. Raises ConfigError naming the key.
    The result is a zenoh.Session; it is Any because zenoh's stubs leave most results unannotated.
    """
    check_output(output)
    try:
        return zenoh.open(session_config(output))
    except zenoh.ZError as error:
        if output.zenoh_config is not None:
            reasons = "; ".join(unreadable_files(output)) or tidy(error)
            key, expected, got = "output.zenoh_config", "one that opens", f"{output.zenoh_config}: {reasons}"
        else:
            key, expected, got = _blamed(str(error), output), "Zenoh endpoints that can be opened", tidy(error)
        raise ConfigError("configuration", key, expected, got) from error


def unreadable_files(output: Output) -> list[str]:
    """Each TLS file of `output.zenoh_config` that cannot be opened, with the reason; Zenoh's error does not name it."""
    if output.zenoh_config is None:
        return []
    found, files = [], value_of(_from_file(output.zenoh_config), "transport/link/tls")
    for name in _TLS_FILES:
        if file := files[name]:
            try:
                Path(file).open("rb").close()
            except OSError as error:
                found.append(f"{name} {file}: {error.strerror}")
    return found


def tidy(error: zenoh.ZError) -> str:
    """The error's text without the source locations at its end."""
    return re.sub(r" at \S+\.rs:\d+\.?", "", str(error))


def _blamed(text: str, output: Output) -> str:
    """The key at fault: an unreachable neighbour does not fail the start, an unknown protocol in `connect` does."""
    for endpoint in output.connect:
        if f"for {endpoint.partition('/')[0]} protocol" in text:
            return "output.connect"
    return "output.listen"
