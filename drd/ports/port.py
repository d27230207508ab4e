"""A device that is kept open: opened off the event loop, reopened after every loss, closed on every path."""

import asyncio
import errno
import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final

VANISHED_CHECK_S: Final = 1.0
# Waits before a device is reopened: each twice the previous one, until it has delivered data.
FIRST_WAIT_S: Final = 0.1
LONGEST_WAIT_S: Final = 2.0


class Port(ABC):
    """Opening, loss and reopening, common to the serial port and the CAN bus.

    `on_state(None)`: open; `on_state(text)`: why no data can arrive. It is called on changes only, from the event
    loop. Nothing that a device or driver does raises out of `run()`. An exception in a data callback, a bug of ours,
    goes to the loop's exception handler; reading continues.
    """

    def __init__(self, device: str, on_state: Callable[[str | None], None]):
        self.counters: dict[str, int] = {"opens": 0, "open_errors": 0, "losses": 0}
        self._device = device
        self._on_state = on_state
        self._state: str | None = "not opened yet"
        self._is_open = False
        self._wait_s = FIRST_WAIT_S  # before the next opening
        self._loop: asyncio.AbstractEventLoop
        self._worker: ThreadPoolExecutor
        self._lost: asyncio.Future[str]

    async def run(self) -> None:
        """Keep the device open and read it until cancelled."""
        self._loop = asyncio.get_running_loop()
        # A single thread does all blocking work in order: closing waits for an opening that was cancelled half way.
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"drd {self._device}")
        try:
            while True:
                await self._open_and_read()
                wait_s, self._wait_s = self._wait_s, min(2.0 * self._wait_s, LONGEST_WAIT_S)
                await asyncio.sleep(wait_s)
        finally:
            self._worker.shutdown(wait=False)

    async def _open_and_read(self) -> None:
        """One life of the device, from opening to closing."""
        self._lost = self._loop.create_future()
        try:
            try:
                await self._loop.run_in_executor(self._worker, self._open)
                self._is_open = True
                self._start_reading()
            except Exception as error:  # drivers raise anything: OSError, ValueError, termios.error, CanError
                self.counters["open_errors"] += 1
                reason = f"cannot open {self._device}: {reason_of(error)}"
            else:
                self.counters["opens"] += 1
                self._report(None)
                reason = f"lost {self._device}: {await self._until_lost()}"
                self.counters["losses"] += 1
            self._is_open = False
            self._report(reason)
        finally:
            self._is_open = False
            self._stop_reading()
            closing = self._loop.run_in_executor(self._worker, self._close)
            try:
                await asyncio.shield(closing)
            except asyncio.CancelledError:  # it may be the first; the one after it ends the wait for a stuck driver
                await asyncio.shield(closing)
                raise

    async def _until_lost(self) -> str:
        while not (await asyncio.wait({self._lost}, timeout=VANISHED_CHECK_S))[0]:
            if reason := self._vanished():
                return reason
        return self._lost.result()

    def _lose(self, reason: str) -> None:
        """End this life of the device. Call on the event loop; only the first reason counts."""
        if not self._lost.done():
            self._lost.set_result(reason)

    def _report(self, state: str | None) -> None:
        if state != self._state:
            self._state = state
            self._on_state(state)

    @abstractmethod
    def _open(self) -> None:
        """Open the device; runs in the worker thread, may block and raise."""

    @abstractmethod
    def _close(self) -> None:
        """Close anything that `_open` left open; runs in the worker thread, may block, never raises."""

    @abstractmethod
    def _start_reading(self) -> None:
        """Deliver arriving data, from the loop's next turn on; call `_lose` when no more can arrive."""

    @abstractmethod
    def _stop_reading(self) -> None:
        """Undo `_start_reading`, even if that raised half way or was never called."""

    @abstractmethod
    def _vanished(self) -> str | None:
        """Why the open device no longer has that name; asked each second, as drivers do not report it."""


def reason_of(error: Exception) -> str:
    """A phrase for a failure: the system's if an errno is known, else the library's."""
    for candidate in (error, error.__cause__):
        if isinstance(candidate, OSError) and candidate.errno:
            if candidate.errno == errno.EWOULDBLOCK:  # flock's answer
                return "in use by another program"
            return os.strerror(candidate.errno)
    return str(error) or type(error).__name__
