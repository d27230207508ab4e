"""Warnings about the access that the Zenoh configuration grants."""

import ipaddress
from collections.abc import Iterator

import zenoh

from drd.config.keys import Output
from drd.output.session import session_config, value_of

_ENCRYPTED = ("tls", "quic")


def exposure(output: Output) -> list[str]:
    """Sentences about access open to unauthorised people; empty if there is none.

    `output` must have passed session.check_output. Only the endpoints on which the daemon listens are checked: the
    router at `connect` decides by its own configuration who may connect through it.
    """
    config = session_config(output)
    source = "output.listen" if output.zenoh_config is None else output.zenoh_config
    return [f"{source}: {text}" for text in _open_doors(config, output)]


def _open_doors(config: zenoh.Config, output: Output) -> Iterator[str]:
    allowed = " and change it (output.commands)" if output.commands else ""
    outside = [endpoint for endpoint in _endpoints(config) if not is_local(endpoint)]
    plain = [endpoint for endpoint in outside if endpoint.partition("/")[0] not in _ENCRYPTED]
    if plain:
        yield f"anyone who reaches {', '.join(plain)} can read the robot's pose{allowed}: no encryption, no login"
    elif outside and not value_of(config, "transport/link/tls/enable_mtls"):
        yield f"anyone who reaches {', '.join(outside)} can read the robot's pose{allowed}: tls/enable_mtls is not true"
    elif outside and not value_of(config, "access_control/enabled"):
        yield f"any certificate of the authority can read the robot's pose{allowed}: access_control is off"
    if value_of(config, "scouting/multicast/enabled") is not False:
        yield "scouting/multicast is on: Zenoh connects to anyone who answers on the network"


def _endpoints(config: zenoh.Config) -> list[str]:
    """The endpoints on which it listens; Zenoh accepts one list for all modes, or one per mode."""
    found = value_of(config, "listen/endpoints")
    if isinstance(found, dict):
        found = found.get(value_of(config, "mode") or "peer", [])
    return [str(endpoint) for endpoint in found or []]


def is_local(endpoint: str) -> bool:
    """Whether only this machine can reach an endpoint such as tcp/127.0.0.1:7447."""
    protocol, _, address = endpoint.partition("/")
    if protocol.startswith(("unix", "serial", "vsock")):
        return True
    host = address.partition("?")[0].partition("#")[0].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:  # a name
        return host == "localhost"
