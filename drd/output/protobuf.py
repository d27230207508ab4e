"""Protocol Buffers without their library, for messages of fixed form: wire encoding and schemas.

Source: protobuf.dev/programming-guides/encoding, and google/protobuf/descriptor.proto for the schemas.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

_DOUBLE: Final = struct.Struct("<Bd")
# FieldDescriptorProto's types; other names are those of messages or enumerations.
_SCALARS: Final = {"double": 1, "int64": 3, "int32": 5, "fixed32": 7, "bool": 8, "string": 9, "bytes": 12}
_MESSAGE, _ENUM = 11, 14
_OPTIONAL, _REPEATED = 1, 3


def varint(value: int) -> bytes:
    """Encode an integer, seven bits per byte, lowest first; a negative one as 64-bit two's complement."""
    value &= (1 << 64) - 1
    data = bytearray()
    while value > 0x7F:
        data.append(0x80 | value & 0x7F)
        value >>= 7
    data.append(value)
    return bytes(data)


def whole(number: int, value: int) -> bytes:
    """Encode the field `number`: an integer, a boolean or an enumeration."""
    return varint(number << 3) + varint(value)


def doubles(**fields: float) -> bytes:
    """Encode double fields x, y, z, w, numbered from 1; those not given are 0 and take no bytes."""
    return b"".join(double(number, fields[name]) for number, name in enumerate("xyzw", 1) if name in fields)


def double(number: int, value: float) -> bytes:
    """Encode the field `number`, below 16: a double."""
    return _DOUBLE.pack(number << 3 | 1, value)


def field(number: int, data: bytes | str) -> bytes:
    """Encode the field `number`: a string, bytes or an embedded message."""
    data = data.encode("utf-8", "replace") if isinstance(data, str) else data
    return varint(number << 3 | 2) + varint(len(data)) + data


def schema_file(
    name: str,
    package: str,
    messages: Mapping[str, str],
    enums: Mapping[str, Sequence[str]] | None = None,
    imported: Mapping[str, Sequence[str]] | None = None,
) -> bytes:
    """A FileDescriptorProto, as a field of FileDescriptorSet: join several to get one.

    `messages`: the fields of each as "type name, ...", numbered from 1 in that order, `repeated` in front where they
    are. `enums`: values of an enumeration by its full name in the package, such as Outer.Type; it stands within that
    message. `imported`: names of the messages of other packages, by file.
    """
    enums, imported = enums or {}, imported or {}
    known = {m: f".{package}.{m}" for m in messages}
    for file, names in imported.items():
        known |= {n: f".{file.rpartition('/')[0].replace('/', '.')}.{n}" for n in names}
    data = field(1, name) + field(2, package) + b"".join(field(3, file) for file in imported)
    for message, text in messages.items():
        inner = {e.partition(".")[2]: values for e, values in enums.items() if e.partition(".")[0] == message}
        types = known | {e: f".{package}.{message}.{e}" for e in inner}
        parts = [field(2, part) for part in _fields(text, types, inner)]
        parts += [field(4, _enum(e, values)) for e, values in inner.items()]
        data += field(4, field(1, message) + b"".join(parts))
    return field(1, data + field(12, "proto3"))


def _fields(text: str, types: Mapping[str, str], enums: Mapping[str, Sequence[str]]) -> Iterator[bytes]:
    """A FieldDescriptorProto of each field."""
    for number, part in enumerate(text.split(", "), 1):
        *repeated, kind, name = part.split()
        scalar = _SCALARS.get(kind)
        yield b"".join(
            (
                field(1, name),
                whole(3, number),
                whole(4, _REPEATED if repeated else _OPTIONAL),
                whole(5, scalar or (_ENUM if kind in enums else _MESSAGE)),
                b"" if scalar else field(6, types[kind]),
            )
        )


def _enum(name: str, values: Sequence[str]) -> bytes:
    rows = (field(2, field(1, value) + whole(2, number)) for number, value in enumerate(values))
    return field(1, name) + b"".join(rows)
