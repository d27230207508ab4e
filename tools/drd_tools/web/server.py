"""Web server for one state, which forwards new messages to the browsers ten times a second."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from importlib import resources
from typing import Any, Final

import msgspec
from aiohttp import web

from drd.output.forms import COMMANDS
from drd.output.messages import MAX_REQUEST_BYTES, Refused, encode
from drd_tools.web.daemon import DaemonLink
from drd_tools.web.guard import Guard
from drd_tools.web.history import COLUMNS
from drd_tools.web.hub import Hub
from drd_tools.web.metrics import CONTENT_TYPE, metrics_text
from drd_tools.web.state import State

PERIOD_S: Final = 0.1
STATUS_S: Final = 1.0
# The daemon's answer about its commands may have been lost on the way.
_ASK_AGAIN_S: Final = 10.0
_TYPES: Final = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}


class Server:
    """Web server of one daemon. `app` is aiohttp's application, which opens and closes the link.

    `work`, which exists once it serves, ends only by a bug of ours.
    """

    work: asyncio.Task[None]

    def __init__(self, link: DaemonLink, guard: Guard):
        self._link = link
        self._state = State()
        self._hub = Hub()
        self._number = 0
        self._commanding = asyncio.Lock()
        folder = resources.files("drd_tools.web") / "page"
        self._files = {file.name: file.read_bytes() for file in folder.iterdir()}
        self.app = web.Application(middlewares=[guard.middleware], client_max_size=MAX_REQUEST_BYTES)
        self.app.add_routes(
            [
                web.get("/", self._page),
                web.get("/page/{name}", self._page),
                web.get("/stream", self._stream),
                web.get("/history", self._history),
                web.get("/metrics", self._metrics),
                web.post("/command/{name}", self._command),
            ]
        )
        self.app.cleanup_ctx.append(self._running)
        self.app.on_shutdown.append(self._hub.close)

    async def _running(self, _: web.Application) -> AsyncIterator[None]:
        self.work = asyncio.create_task(self._work())
        try:
            yield
        finally:
            self.work.cancel()
            await asyncio.wait([self.work])
            await asyncio.to_thread(self._link.close)

    async def _work(self) -> None:
        async with asyncio.TaskGroup() as group:
            for work in (self._link.open(), self._tell(), self._learn_permission()):
                group.create_task(work)

    # ---- from the daemon to the browsers ---------------------------------------------------------------------------

    async def _tell(self) -> None:
        next_s = next_status_s = time.monotonic()
        while True:
            self._look()
            if (now_s := time.monotonic()) >= next_status_s:
                next_status_s = now_s + STATUS_S
                self._send(self._status(now_s))
            next_s = max(next_s + PERIOD_S, now_s)
            await asyncio.sleep(next_s - now_s)

    def _look(self) -> None:
        """Process new messages; the browsers get only the newest pose."""
        state, link = self._state, self._link
        poses = [link.poses.popleft() for _ in range(len(link.poses))]
        for event in state.take_poses(poses):
            self._send({"type": "event", **event})
        if poses and (message := state.pose_message(self._number + 1)) is not None:
            self._number += 1
            self._send(message)
        while link.health:
            if state.take_health(link.health.popleft()):
                self._send(state.health_message)

    def _send(self, message: dict[str, Any]) -> None:
        if self._hub:
            self._hub.send(_text(message))

    def _status(self, now_s: float) -> dict[str, Any]:
        return self._state.status_message(now_s, self._link.alive, len(self._hub))

    async def _learn_permission(self) -> None:
        """Ask whether the daemon accepts commands, at each of its starts, and again while the answer is no."""
        asked = -1
        while True:
            if self._link.alive and (asked != self._link.starts or not self._state.commands_allowed):
                asked = self._link.starts
                self._state.commands_allowed = await asyncio.to_thread(self._link.allows_commands)
                if not self._state.commands_allowed:
                    await self._until_next_start(asked)
            await asyncio.sleep(STATUS_S)

    async def _until_next_start(self, asked: int) -> None:
        until_s = time.monotonic() + _ASK_AGAIN_S
        while time.monotonic() < until_s and self._link.starts == asked:
            await asyncio.sleep(STATUS_S)

    # ---- requests --------------------------------------------------------------------------------------------------

    async def _page(self, request: web.Request) -> web.Response:
        name = request.match_info.get("name", "page.html")
        if name not in self._files:
            raise web.HTTPNotFound
        host = request.headers["Host"]  # the guard has looked at it; some browsers' 'self' does not mean WebSockets
        policy = (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; base-uri 'none'; "
            f"form-action 'none'; frame-ancestors 'none'; connect-src 'self' ws://{host} wss://{host}"
        )
        headers = {"Content-Security-Policy": policy}
        kind = _TYPES[name.rpartition(".")[2]]
        return web.Response(body=self._files[name], content_type=kind, charset="utf-8", headers=headers)

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        now_s = time.monotonic()
        hello = {
            "type": "hello",
            "columns": COLUMNS,
            "events": self._state.history.events(),
            "health": self._state.health_message["health"],
            "pose": self._state.pose_message(self._number),
            "status": self._status(now_s),
        }
        return await self._hub.serve(request, _text(hello))

    async def _history(self, _: web.Request) -> web.Response:
        """Rows of COLUMNS, little-endian float64."""
        return web.Response(body=self._state.history.rows().tobytes(), content_type="application/octet-stream")

    async def _metrics(self, _: web.Request) -> web.Response:
        state, hub = self._state, self._hub
        text = metrics_text(state, time.monotonic(), self._link.alive, len(hub), hub.dropped)
        return web.Response(body=text.encode(), headers={"Content-Type": CONTENT_TYPE})

    async def _command(self, request: web.Request) -> web.Response:
        """Pass a command to the daemon, which checks and logs it; answer a refusal with 409."""
        name = request.match_info["name"]
        if name not in COMMANDS:
            raise web.HTTPNotFound
        payload = await request.read()
        async with self._commanding:
            try:
                status, answer = 200, await asyncio.to_thread(self._link.ask, name, payload or None)
            except Refused as error:
                status, answer = 409, {"error": str(error)}
        return web.Response(status=status, body=encode(answer), content_type="application/json")


def _text(message: dict[str, Any]) -> str:
    return msgspec.json.encode(message).decode()


@contextlib.asynccontextmanager
async def serving(server: Server, host: str, port: int) -> AsyncIterator[int]:
    """Serve; yield the port, which the system chooses if `port` is 0. Raises OSError if it is taken."""
    runner = web.AppRunner(server.app, access_log=None, shutdown_timeout=1.0)
    await runner.setup()
    try:
        await web.TCPSite(runner, host, port).start()
        yield runner.addresses[0][1]
    finally:
        await runner.cleanup()
