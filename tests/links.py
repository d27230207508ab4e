"""A Zenoh link with its own event loop, and another session over the loopback."""

import asyncio
import contextlib
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import zenoh

from drd.config.keys import Output
from drd.output.forms import COMMANDS, QUESTIONS
from drd.output.session import isolated_config
from drd.output.zenoh_link import ZenohLink
from drd.samples import Pose, Validity

PATIENCE_S = 10.0
POSE = Pose(1, 2, 3.0, 4.0, 0.5, 1.0, 0.1, 0.01, 0.001, (1, 0, 0, 1, 0, 1), 0.2, Validity.VALID, ())


def free_endpoint() -> str:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{s.getsockname()[1]}"


def echo(name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda payload: {"handler": name, "payload": payload}


HANDLERS = {name: echo(name) for name in (*QUESTIONS, *COMMANDS)}


@contextlib.contextmanager
def event_loop() -> Iterator[asyncio.AbstractEventLoop]:
    """A loop that runs in another thread, as the daemon's does from the test's point of view."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        yield loop
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


@contextlib.contextmanager
def a_link(handlers: Any = HANDLERS, **output: Any) -> Iterator[tuple[ZenohLink, Any]]:
    """A link and, over loopback, another session."""
    output = {"listen": (free_endpoint(),)} | output
    [endpoint] = output["listen"]
    with event_loop() as loop:
        link = ZenohLink(Output(**output), handlers, loop)
        try:
            with zenoh.open(isolated_config("client", (), (endpoint,))) as other:
                yield link, other
        finally:
            assert link.close(PATIENCE_S)


def first_sample(subscriber: Any, publish: Callable[[], None]) -> Any:
    """Publish until the subscription is in place and a sample arrives."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        publish()
        time.sleep(0.01)
        if sample := subscriber.try_recv():
            return sample
    raise AssertionError("nothing was received")


def subscribe(session: Any, key: str) -> Any:
    return session.declare_subscriber(key, zenoh.handlers.RingChannel(16))


def ask(session: Any, key: str, payload: bytes | None = None) -> list[tuple[bool, Any]]:
    """(good, JSON) of each reply; the getter must end long before its timeout."""
    started = time.monotonic()
    replies = list(session.get(key, payload=payload, timeout=60.0))
    assert time.monotonic() - started < 30.0
    return [(r.ok is not None, json.loads((r.ok if r.ok is not None else r.err).payload.to_bytes())) for r in replies]


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)
