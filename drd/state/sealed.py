"""File content below a line with kind, version and checksum: a truncated or changed file is refused."""

import hashlib
import re
from typing import Final

_HEAD: Final = re.compile(rb"drd-([a-z]+)/(\d{1,9}) sha256=([0-9a-f]{64})\n")


class StateError(Exception):
    """A state file cannot be used; the text says why."""


def sealed(kind: str, version: int, body: bytes) -> bytes:
    """The file's bytes."""
    return f"drd-{kind}/{version} sha256={hashlib.sha256(body).hexdigest()}\n".encode() + body


def unsealed(kind: str, version: int, data: bytes) -> bytes:
    """The body; the inverse of `sealed`. Raises StateError; nothing else escapes."""
    head = _HEAD.match(data)
    if head is None or head[1].decode() != kind:
        raise StateError(f"it does not begin as a {kind} file of drd does")
    if (found := int(head[2])) != version:
        raise StateError(f"version {found}; this drd reads version {version}")
    body = data[head.end() :]
    if hashlib.sha256(body).hexdigest().encode() != head[3]:
        raise StateError("its checksum is wrong: it was cut or changed")
    return body
