import asyncio
import contextlib
import os
import select
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any

import can
import pytest

from drd.config.keys import Encoders
from drd.ports import port as port_module
from drd.ports.can_port import CanPort
from drd.ports.port import Port
from drd.ports.slcan import open_bus
from drd.samples import CanFrame

PATIENCE_S = 20.0


class Pty:
    """A serial line: the file number of its far end and the path of its near end."""

    def __init__(self) -> None:
        self.master, slave = os.openpty()
        self.path = os.ttyname(slave)
        os.close(slave)
        # Who writes runs on the reader's event loop: waiting for room in the line would never end.
        os.set_blocking(self.master, False)
        self._is_up = True

    def write(self, data: bytes) -> None:
        """Write what the line has room for (4,095 bytes at the least)."""
        assert os.write(self.master, data) == len(data)

    async def stream(self, data: bytes) -> None:
        """Write any amount, as fast as it is read."""
        while data:
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self.master, data) :]
            await asyncio.sleep(0)

    def hang_up(self) -> None:
        if self._is_up:
            self._is_up = False
            os.close(self.master)


@pytest.fixture
def make_pty() -> Iterator[Callable[[], Pty]]:
    made: list[Pty] = []

    def make() -> Pty:
        made.append(Pty())
        return made[-1]

    yield make
    for line in made:
        line.hang_up()


@contextlib.asynccontextmanager
async def _run_port(port: Port) -> AsyncIterator[asyncio.Task[None]]:
    task = asyncio.create_task(port.run())
    try:
        yield task
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


@pytest.fixture
def run_port() -> Callable[[Port], AbstractAsyncContextManager[asyncio.Task[None]]]:
    """A port that runs inside the `async with` block."""
    return _run_port


async def _eventually(holds: Callable[[], object]) -> None:
    give_up = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < give_up, "it never became true"
        await asyncio.sleep(0.002)


@pytest.fixture
def eventually() -> Callable[[Callable[[], object]], Awaitable[None]]:
    """Wait until a condition holds; fail when it never does."""
    return _eventually


@pytest.fixture
def quick_checks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look for vanished devices every 10 ms instead of every second."""
    monkeypatch.setattr(port_module, "VANISHED_CHECK_S", 0.01)


class CanRecord:
    """What a CAN port reported."""

    def __init__(self) -> None:
        self.frames: list[CanFrame] = []
        self.batches: list[int] = []
        self.states: list[str | None] = []

    def on_frames(self, frames: Sequence[CanFrame]) -> None:
        self.frames.extend(frames)
        self.batches.append(len(frames))

    @property
    def numbers(self) -> list[int]:
        """What `can_message` was given, of each frame."""
        return [int.from_bytes(frame.data, "little") for frame in self.frames]

    def port(
        self,
        can_ids: Sequence[tuple[int, bool]] = (),
        open_bus: Callable[..., can.BusABC] = open_bus,
        **keys: Any,
    ) -> CanPort:
        return CanPort(Encoders(**keys), can_ids, self.on_frames, self.states.append, open_bus)


class FakeBus(can.BusABC):
    """Stands for socketcan: a real file number to wait on; what is fed comes out of recv(), exceptions too."""

    def __init__(self, **arguments: Any):
        super().__init__(channel=arguments["channel"])
        self.arguments = arguments
        self.socket, self._peer = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.items: deque[can.Message | Exception] = deque()
        self.sent: list[can.Message] = []
        self.is_closed = False
        self.before_send: Callable[[], None] = lambda: None
        self.after_shutdown: Callable[[], None] = lambda: None

    def feed(self, *items: can.Message | Exception) -> None:
        for item in items:
            self.items.append(item)
            self._peer.send(b"x")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not select.select([self.socket], [], [], timeout)[0]:
            return None, True
        self.socket.recv(1)
        item = self.items.popleft()
        if isinstance(item, Exception):
            raise item
        return item, True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - python-can's signature
        self.before_send()
        self.sent.append(msg)

    def fileno(self) -> int:
        return self.socket.fileno()

    def shutdown(self) -> None:
        super().shutdown()
        self.is_closed = True
        self.socket.close()
        self._peer.close()
        self.after_shutdown()


class Garage:
    """Opens fake buses and remembers them."""

    def __init__(self) -> None:
        self.buses: list[FakeBus] = []
        self.refusals: list[Exception] = []

    def open(self, **arguments: Any) -> FakeBus:
        if self.refusals:
            raise self.refusals.pop(0)
        self.buses.append(FakeBus(**arguments))
        return self.buses[-1]


def _can_message(number: int = 0, can_id: int = 0x181, **keys: Any) -> can.Message:
    defaults: dict[str, Any] = {
        "data": number.to_bytes(4, "little"),
        "is_extended_id": False,
        "timestamp": time.time(),
    }
    return can.Message(arbitration_id=can_id, **(defaults | keys))


@pytest.fixture
def can_message() -> Callable[..., can.Message]:
    """Makes a data frame that carries a number, received now; keywords are can.Message's."""
    return _can_message


@pytest.fixture
def can_record() -> CanRecord:
    """Makes a CAN port and keeps what it reports."""
    return CanRecord()


@pytest.fixture
def garage() -> Garage:
    """Opens fake buses in the place of can.Bus."""
    return Garage()
