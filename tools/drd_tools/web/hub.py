"""Connected browsers, each with its own short queue, so that a slow one does not affect the others."""

import asyncio
import contextlib
from collections import deque
from typing import Final

from aiohttp import ClientConnectionError, WSCloseCode, web

# Messages queued for one browser, about 1.5 s of them; if exceeded, the newest are kept.
QUEUE: Final = 20
MAX_CLIENTS: Final = 64
# A browser that takes nothing for this long is dropped: its tab sleeps, or the network is down. It will reconnect.
STALLED_S: Final = 20.0
_GOODBYE_S: Final = 0.5


class Client:
    """One browser's queue and the task that empties it."""

    def __init__(self, socket: web.WebSocketResponse):
        self._socket = socket
        self._queue: deque[str] = deque(maxlen=QUEUE)
        self._wake = asyncio.Event()
        self.dropped = 0

    def put(self, text: str) -> None:
        """Queue a message; never waits."""
        self.dropped += len(self._queue) == QUEUE
        self._queue.append(text)
        self._wake.set()

    async def work(self) -> None:
        """Send until the browser leaves or stalls."""
        try:
            while not self._socket.closed:
                await self._wake.wait()
                self._wake.clear()
                while self._queue:
                    async with asyncio.timeout(STALLED_S):
                        await self._socket.send_str(self._queue.popleft())
        except (TimeoutError, ConnectionError, ClientConnectionError):
            return

    async def close(self) -> None:
        """Say good-bye, if the browser still takes it."""
        with contextlib.suppress(TimeoutError, ConnectionError):
            async with asyncio.timeout(_GOODBYE_S):
                await self._socket.close(code=WSCloseCode.GOING_AWAY)


class Hub:
    """All browsers. A message is encoded once, by the caller, for all of them."""

    def __init__(self) -> None:
        self._clients: set[Client] = set()
        self._dropped = 0  # of those who have left

    def __len__(self) -> int:
        return len(self._clients)

    @property
    def dropped(self) -> int:
        """Messages that a slow browser did not get."""
        return self._dropped + sum(client.dropped for client in self._clients)

    def send(self, text: str) -> None:
        """Send to all browsers without waiting."""
        for client in self._clients:
            client.put(text)

    async def close(self, _: web.Application) -> None:
        """Tell all browsers that the server ends; they will try to reconnect."""
        await asyncio.gather(*(client.close() for client in self._clients))

    async def serve(self, request: web.Request, hello: str) -> web.StreamResponse:
        """Serve a browser, from its first message until it leaves.

        Raises HTTPServiceUnavailable beyond MAX_CLIENTS, HTTPBadRequest for what is no handshake.
        """
        if len(self._clients) >= MAX_CLIENTS:
            raise web.HTTPServiceUnavailable(text=f"{MAX_CLIENTS} browsers are connected already\n")
        # Our page sends nothing here, so a long message is not its own. Compression costs more than it gains.
        socket = web.WebSocketResponse(heartbeat=STALLED_S, max_msg_size=1024, compress=False)
        try:
            await socket.prepare(request)
        except ValueError as error:  # aiohttp's own, of headers that are not ASCII
            raise web.HTTPBadRequest(text="no WebSocket handshake\n") from error
        client = Client(socket)
        client.put(hello)
        self._clients.add(client)
        writer = asyncio.create_task(client.work())
        reader = asyncio.create_task(_read(socket))
        try:
            await asyncio.wait((writer, reader), return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._clients.discard(client)
            self._dropped += client.dropped
            for task in (writer, reader):
                task.cancel()
            if request.transport is not None and writer.done():
                request.transport.abort()  # what still waits for a stalled browser is let go
        return socket


async def _read(socket: web.WebSocketResponse) -> None:
    """Handle pings and the end; ignore messages of the browser."""
    async for _ in socket:
        pass
