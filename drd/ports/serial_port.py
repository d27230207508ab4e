"""The gyro's serial port: bytes with their arrival time, through unplugging and replugging."""

import logging
import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

import serial

from drd.config.keys import Fog
from drd.ports.port import FIRST_WAIT_S, Port, reason_of

log = logging.getLogger(__name__)

# More than a tty holds (N_TTY_BUF_SIZE, 4096 bytes).
READ_BYTES: Final = 65536


class SerialPort(Port):
    """Reads `fog.port` until cancelled and calls `on_bytes(data, t_ns)` with each piece that arrives.

    `t_ns` is CLOCK_MONOTONIC at the wake-up for that piece, taken before it is read. The port is opened exclusively,
    which keeps out only programs that also lock it (flock). A port that is absent, unplugged, or replaced behind its
    symbolic link is waited for.
    """

    def __init__(self, fog: Fog, on_bytes: Callable[[bytes, int], None], on_state: Callable[[str | None], None]):
        super().__init__(fog.port, on_state)
        self.counters |= {"bytes": 0, "low_latency_refused": 0}
        self._fog = fog
        self._on_bytes = on_bytes
        self._port: serial.Serial | None = None

    def _open(self) -> None:
        self._port = serial.Serial(self._device, self._fog.baud, timeout=0, exclusive=True)
        if self._fog.low_latency and not request_low_latency(self._port):
            self.counters["low_latency_refused"] += 1
            if self.counters["low_latency_refused"] == 1:
                log.info("port=%s low_latency=refused", self._device)

    def _close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            with suppress(OSError):
                port.close()

    def _start_reading(self) -> None:
        assert self._port is not None
        self._loop.add_reader(self._port.fileno(), self._on_readable, self._port)

    def _stop_reading(self) -> None:
        if self._port is not None:
            self._loop.remove_reader(self._port.fileno())

    def read_waiting(self) -> None:
        """Deliver the data that have arrived, now and not in a later turn of the loop."""
        if self._is_open and self._port is not None:
            self._on_readable(self._port)

    def _on_readable(self, port: serial.Serial) -> None:
        t_ns = time.monotonic_ns()
        try:
            # With timeout 0 this is one select() and one read(). The select matters: in pyserial's mode (VMIN 0) a
            # tty answers a read without data like one after a hang-up.
            data = port.read(READ_BYTES)
        except OSError as error:  # SerialException is one
            self._lose(reason_of(error))
            return
        if data:
            self._wait_s = FIRST_WAIT_S
            self.counters["bytes"] += len(data)
            self._on_bytes(data, t_ns)

    def _vanished(self) -> str | None:
        assert self._port is not None
        try:
            same = Path(self._device).stat().st_rdev == os.fstat(self._port.fileno()).st_rdev
        except OSError as error:
            return reason_of(error)
        return None if same else "another device has taken its name"


def request_low_latency(port: serial.Serial) -> bool:
    """Ask the driver to hand over bytes at once (ASYNC_LOW_LATENCY; FTDI adapters otherwise wait up to 16 ms).

    False if it refuses, as ptys and many drivers do.
    """
    try:
        port.set_low_latency_mode(True)
    except (ValueError, OSError, NotImplementedError):
        return False
    return True
