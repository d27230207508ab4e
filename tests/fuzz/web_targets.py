"""The server of `drd web`: bytes of HTTP and WebSocket from browsers, and messages from the daemon."""

import asyncio
import json
import logging
import math
import re
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import Any, Final

import msgspec
from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from drd.output.messages import Refused
from drd_tools.web.daemon import Heard
from drd_tools.web.guard import Guard
from drd_tools.web.metrics import metrics_text
from drd_tools.web.server import Server
from drd_tools.web.state import State

TOKEN: Final = "0123456789abcdef"
# Between these the server has its turn: a browser's bytes come in several parts.
PAUSE: Final = b"\n=====\n"
TURNS: Final = 12
METRIC: Final = re.compile(r'[a-z0-9_]+(\{([a-z]+="([^"\\]|\\.)*",?)*\})? \S+|# (HELP|TYPE) .*', re.S)


class _Wire(asyncio.Transport):
    """A connection that takes everything."""

    def __init__(self) -> None:
        super().__init__()
        self.sent, self.closed = bytearray(), False

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return ("127.0.0.1", 1) if name == "peername" else default

    def write(self, data: Any) -> None:
        self.sent += data

    def close(self) -> None:
        self.closed = True

    def abort(self) -> None:
        self.closed = True

    def is_closing(self) -> bool:
        return self.closed

    def pause_reading(self) -> None:
        pass

    def resume_reading(self) -> None:
        pass


class _Link:
    """A daemon that grants every other command."""

    def __init__(self) -> None:
        self.poses, self.health = deque[Heard](), deque[Heard]()
        self.alive, self.starts = True, 1

    async def open(self) -> None:
        pass

    def close(self) -> None:
        pass

    def allows_commands(self) -> bool:
        return True

    def ask(self, name: str, payload: bytes | None) -> dict[str, Any]:
        if len(payload or name) % 2:
            raise Refused("odd")
        return {}


class _AtOnce(ThreadPoolExecutor):
    """No threads."""

    def submit(self, work: Any, /, *arguments: Any, **names: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(work(*arguments, **names))
        return done


class _Log(logging.Handler):
    """An error that the server calls its own."""

    def __init__(self) -> None:
        super().__init__()
        self.errors: list[BaseException] = []

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        # Those are the browser's: what is no HTTP, and leaving in the middle of a request.
        if error is not None and not isinstance(error, HttpProcessingError | ConnectionResetError):
            self.errors.append(error)


class _Site:
    """The server with its loop, once for all inputs."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.loop.set_default_executor(_AtOnce())
        self.log = _Log()
        logger = logging.Logger("fuzz")
        logger.addHandler(self.log)
        self.loop.set_exception_handler(lambda _, context: self.log.errors.append(
            context.get("exception") or RuntimeError(context["message"])))  # fmt: skip
        link: Any = _Link()
        runner = web.AppRunner(Server(link, Guard(TOKEN, (), 8080)).app, access_log=None, logger=logger)
        self.loop.run_until_complete(runner.setup())
        self.runner = runner

    async def serve(self, data: bytes) -> bytes:
        protocol: Any = self.runner.server()  # type: ignore[misc]
        wire = _Wire()
        protocol.connection_made(wire)
        for part in data.split(PAUSE):
            if not wire.closed:
                protocol.data_received(part)
            for _ in range(TURNS):
                await asyncio.sleep(0)
        protocol.connection_lost(None)
        for _ in range(TURNS):
            await asyncio.sleep(0)
        return bytes(wire.sent)


@cache
def _site() -> _Site:
    return _Site()


def web_request(data: bytes) -> None:
    """What a browser sends, in the parts that PAUSE separates."""
    site = _site()
    # A line's end is easier to type in a seed than CR LF.
    head, blank, body = data.partition(b"\n\n")
    if blank and b"\r" not in head:
        data = head.replace(b"\n", b"\r\n") + b"\r\n\r\n" + body
    sent = site.loop.run_until_complete(site.serve(data))
    errors, site.log.errors = site.log.errors, []
    for error in errors:
        raise error
    assert not sent.startswith(b"HTTP/1.1 500")


def web_message(data: bytes) -> None:
    """Messages of a daemon, in lines: byte 0 is odd for the health, even for a pose."""
    state, now_s = State(), 1000.0
    for number, line in enumerate(data.splitlines()):
        heard = Heard(line[1:], now_s + number, 10**18)
        if line[:1] and line[0] % 2:
            state.take_health(heard)
        else:
            state.take_poses([heard])
    now_s += 1.0
    for text in metrics_text(state, now_s, True, 1, 0).split("\n")[:-1]:
        assert METRIC.fullmatch(text), text
        assert text[0] == "#" or not math.isnan(float(text.rpartition(" ")[2])) or "NaN" in data.decode("latin-1")
    hello = {"events": state.history.events(), "health": state.health_message["health"],
             "pose": state.pose_message(1), "status": state.status_message(now_s, True, 1)}  # fmt: skip
    assert isinstance(json.loads(msgspec.json.encode(hello)), dict)
    state.history.rows().tobytes()
