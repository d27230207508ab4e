"""Zenoh sessions that reach only what they are told to: no scouting, no shared memory."""

import json
import re
from pathlib import Path
from typing import Any

import zenoh

from drd.config import Output
from drd.output.ros2 import topic_name
from drd.schema import ConfigError

# A message above this is dropped where it arrives, before it takes memory. Zenoh's own limit is 1 GiB.
MAX_MESSAGE_BYTES = 65_536


def isolated_config(mode: str, listen: tuple[str, ...], connect: tuple[str, ...]) -> zenoh.Config:
    """A configuration with these end points only. Raises zenoh.ZError for one that is not of Zenoh's form.

    Shared memory is off: it needs mlock and /dev/shm, which a sandbox refuses. Gossip, by which neighbours learn of
    each other, is on only where this session connects somewhere: without it a ROS 2 peer behind the same router
    never hears us. A connection that fails is tried again for ever and does not fail the start.
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


def check_output(output: Output) -> None:
    """What can be known without opening a session. Raises ConfigError naming the key."""
    if topic_name(output.ros2_topic) is None:
        raise ConfigError("configuration", "output.ros2_topic", "a ROS 2 topic name", repr(output.ros2_topic))
    if output.zenoh_config is not None:
        _from_file(output.zenoh_config)
        return
    for name, endpoints in (("listen", output.listen), ("connect", output.connect)):
        for endpoint in endpoints:
            try:
                isolated_config("peer", (endpoint,), ())
            except zenoh.ZError as error:
                got = f"{endpoint!r}: {tidy(error)}"
                raise ConfigError("configuration", f"output.{name}", "Zenoh end points", got) from error


def _from_file(file: str) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(Path(file))
    except zenoh.ZError as error:
        got = f"{file}: {tidy(error)}"
        raise ConfigError("configuration", "output.zenoh_config", "a Zenoh configuration file", got) from error


def open_session(output: Output) -> Any:
    """The daemon's session: from `output.zenoh_config` as it stands, else a peer with `listen` and `connect`.

    Returns within about 0.5 s, also when nothing answers at `connect`. Raises ConfigError naming the key.
    The result is a zenoh.Session; it is Any because zenoh's stubs leave most results unannotated.
    """
    check_output(output)
    if output.zenoh_config is not None:
        try:
            return zenoh.open(_from_file(output.zenoh_config))
        except zenoh.ZError as error:
            got = f"{output.zenoh_config}: {tidy(error)}"
            raise ConfigError("configuration", "output.zenoh_config", "one that opens", got) from error
    try:
        return zenoh.open(isolated_config("peer", output.listen, output.connect))
    except zenoh.ZError as error:
        raise ConfigError(
            "configuration", _blamed(str(error), output), "Zenoh end points that open", tidy(error)
        ) from error


def tidy(error: zenoh.ZError) -> str:
    """The error's text without the places in Zenoh's source that it ends with."""
    return re.sub(r" at \S+\.rs:\d+\.?", "", str(error))


def _blamed(text: str, output: Output) -> str:
    """Unreachable neighbours fail no start, so only a protocol that Zenoh does not know can be `connect`'s fault."""
    for endpoint in output.connect:
        if f"for {endpoint.partition('/')[0]} protocol" in text:
            return "output.connect"
    return "output.listen"
