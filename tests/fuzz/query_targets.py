"""The daemon's queryables, from a query's bytes to its reply, without Zenoh's network."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import zenoh

from drd.config.keys import Config
from drd.config.schema import Loaded, loads
from drd.output.allowance import Allowance
from drd.output.forms import COMMANDS, QUESTIONS, Form, JsonForm, SetPoseService, TriggerService
from drd.output.queries import QueryDesk
from drd.samples import Pose, Validity
from drd.service.daemon import Daemon

CONFIG: Final = """robot: {name: fuzz, wheel_radius_m: 0.11, tread_m: 0.6}
encoders: {counts_per_revolution: 20000}
state: {enabled: false}
output: {commands: true}
"""
POSE: Final = Pose(1, 2, 3.0, 4.0, 0.5, 1.0, 0.1, 0.01, 0.001, (1, 0, 0, 1, 0, 1), 0.2, Validity.VALID, ())
FORMS: Final[tuple[Form, ...]] = (
    *(JsonForm(name, f"drd/{name}") for name in (*QUESTIONS, *COMMANDS)),
    SetPoseService("set_pose", "0/set_pose/x/y", "odom"),
    TriggerService("reset", "0/reset/x/y"),
)


class _Query:
    """A zenoh.Query that keeps what it is answered."""

    def __init__(self, key: str, payload: bytes, attachment: bytes | None):
        self.key_expr, self.replies = key, list[tuple[bool, bytes]]()
        self.payload = zenoh.ZBytes(payload) if payload else None
        self.attachment = None if attachment is None else zenoh.ZBytes(attachment)
        self.ended = False

    def reply(self, _: str, payload: bytes, **__: Any) -> None:
        self.replies.append((True, payload))

    def reply_err(self, payload: bytes, **_: Any) -> None:
        self.replies.append((False, payload))

    def drop(self) -> None:
        self.ended = True

    def __enter__(self) -> "_Query":
        return self

    def __exit__(self, *_: object) -> None:
        self.ended = True


class _AtOnce:
    """An event loop and an outbox that do what they are given, now."""

    def call_soon_threadsafe(self, work: Callable[..., None], *arguments: Any) -> None:
        work(*arguments)

    def put(self, work: Callable[[], None] | None) -> None:
        if work is not None:
            work()


class _Link:
    """As much of a ZenohLink as the health asks for."""

    counters: Final = {"poses": 0}

    def neighbours(self) -> int:
        return 0


@cache
def _desk() -> QueryDesk:
    loaded: Loaded[Config] = loads(CONFIG, Config)
    daemon: Any = Daemon(loaded, Path())
    daemon._link, daemon._inputs, daemon._pose = _Link(), SimpleNamespace(counters=dict), POSE
    now: Any = _AtOnce()
    desk = QueryDesk(daemon._handlers(), True, now, {})
    desk.close()  # its thread ends; answers go out at once instead
    desk._closed, desk._outbox = False, now
    desk._allowance = Allowance(1e12, 1e12)
    # The log would be all that it does.
    desk._command_log._allowance, desk._command_log._later = Allowance(0.0, 0.0), lambda _: None
    return desk


def query(data: bytes) -> None:
    """Byte 0: which queryable, whether by a wildcard, and how many bytes of the rest are the attachment."""
    if not data:
        return
    desk, form = _desk(), FORMS[data[0] % len(FORMS)]
    size, rest = (33 if data[0] & 0x40 else data[0] % 7), data[1:]
    attachment = rest[:size] if data[0] & 0x10 else None
    made = _Query("drd/**" if data[0] & 0x80 else form.key, rest[size:] if attachment is not None else rest, attachment)
    desk._receive(form, made)
    assert made.ended
    is_touched = form.name in COMMANDS and made.key_expr != form.key
    assert len(made.replies) == (not is_touched)
    for _, payload in made.replies:
        assert b"internal error" not in payload
        if isinstance(form, JsonForm):
            assert isinstance(json.loads(payload), dict)
    assert desk._in_flight == 0
