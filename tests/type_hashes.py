"""REP-2016 type hashes (RIHS01) from message definitions: SHA-256 of the type's description as JSON (REP-2011)."""

import hashlib
import json
from collections.abc import Iterator
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

# type_description_interfaces/msg/FieldType.msg; an array adds 48, a bounded sequence 96, an unbounded one 144.
IDS = {
    **{"int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9},
    # A char of a .msg file is a uint8 (rosidl_adapter).
    **{"float32": 10, "float64": 11, "char": 3, "bool": 15, "byte": 16, "string": 17},
}
NESTED, ARRAY, BOUNDED_SEQUENCE, SEQUENCE = 1, 48, 96, 144

Fields = list[tuple[str, Any]]
# A message without a field gets this one (rosidl).
EMPTY: Fields = [("structure_needs_at_least_one_member", (Nodetype.BASE, ("uint8", 0)))]
TEXT = (Nodetype.BASE, ("string", 0))
SERVICES: dict[str, tuple[Fields, Fields]] = {
    # pose --- (nothing)
    "robot_localization/srv/SetPose": (
        [("pose", (Nodetype.NAME, "geometry_msgs/msg/PoseWithCovarianceStamped"))],
        EMPTY,
    ),
    # (nothing) --- success, message
    "std_srvs/srv/Trigger": (EMPTY, [("success", (Nodetype.BASE, ("bool", 0))), ("message", TEXT)]),
}


def definitions() -> dict[str, Fields]:
    """The fields of each type: ROS 2's messages from rosbags, and SERVICES with the types that rosidl derives."""
    found: dict[str, Fields] = {name: list(f[1]) for name, f in get_typestore(Stores.ROS2_KILTED).fielddefs.items()}
    for name, (request, response) in SERVICES.items():
        parts = [f"{name}_{part}" for part in ("Request", "Response", "Event")]
        event: Fields = [
            ("info", (Nodetype.NAME, "service_msgs/msg/ServiceEventInfo")),
            *(
                (part, (Nodetype.SEQUENCE, ((Nodetype.NAME, f"{name}_{part.title()}"), 1)))
                for part in ("request", "response")
            ),
        ]
        found |= dict(zip(parts, (request, response, event), strict=True))
        names = ("request_message", "response_message", "event_message")
        found[name] = [(field, (Nodetype.NAME, part)) for field, part in zip(names, parts, strict=True)]
    return found


def type_hash(name: str, types: dict[str, Fields]) -> str:
    """The hash of `name`, as used in keys of rmw_zenoh."""
    others = sorted(set(_referenced(name, types)) - {name})
    description = {
        "type_description": _described(name, types),
        "referenced_type_descriptions": [_described(other, types) for other in others],
    }
    return f"RIHS01_{hashlib.sha256(json.dumps(description).encode()).hexdigest()}"


def _described(name: str, types: dict[str, Fields]) -> dict[str, Any]:
    return {"type_name": name, "fields": [{"name": field, "type": _type(kind)} for field, kind in types[name]]}


def _type(kind: Any) -> dict[str, Any]:
    offset, capacity = 0, 0
    if kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        is_array, (kind, capacity) = kind[0] is Nodetype.ARRAY, kind[1]
        offset = ARRAY if is_array else BOUNDED_SEQUENCE if capacity else SEQUENCE
    is_nested = kind[0] is Nodetype.NAME
    return {
        "type_id": offset + (NESTED if is_nested else IDS[kind[1][0]]),
        "capacity": capacity,
        "string_capacity": 0,
        "nested_type_name": kind[1] if is_nested else "",
    }


def _referenced(name: str, types: dict[str, Fields]) -> Iterator[str]:
    for _, kind in types[name]:
        inner = kind[1][0] if kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else kind
        if inner[0] is Nodetype.NAME:
            yield inner[1]
            yield from _referenced(inner[1], types)
