"""The encoders' CAN bus: data frames with their receive time, through bus errors, unplugging and replugging."""

import errno
import fcntl
import logging
import os
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

import can

from drd.config.keys import Encoders
from drd.ports import can_errors
from drd.ports.bursts import Bursts
from drd.ports.clock import ReceiveClock
from drd.ports.port import FIRST_WAIT_S, Port, reason_of
from drd.ports.serial_port import request_low_latency
from drd.ports.slcan import SlcanBus, open_bus
from drd.samples import CanFrame
from drd.units import NS_PER_S

log = logging.getLogger(__name__)

# Some seconds of encoder frames: a burst that is read in parts cannot be told from one that was not. (drd.ports.bursts)
FRAMES_PER_WAKE_UP: Final = 256
FRAMES_PER_BATCH: Final = 256
# An slcan adapter that restarted, or whose channel another program closed, sends nothing until it is reopened.
SLCAN_SILENCE_NS: Final = 5 * NS_PER_S
THREAD_POLL_S: Final = 0.1
SENDS_WAITING: Final = 16
SEND_TIMEOUT_S: Final = 0.1
INTERFACE_GONE: Final = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO)
# The kernel caps this at net.core.rmem_max; a CAN frame takes some 700 bytes of it.
RECEIVE_BUFFER_BYTES: Final = 1 << 20
SLCAN_LINE_BYTES: Final = 4096
# linux/sock_diag.h, not in Python: the socket's memory as nine 32-bit numbers; the last counts the frames that the
# kernel dropped because the receive buffer was full.
SO_MEMINFO: Final = 55
MEMINFO: Final = struct.Struct("9I")


class CanPort(Port):
    """Reads the bus until cancelled and calls `on_frames` on the event loop with batches of data frames, in order.

    `can_ids`: identifiers to receive, each with its extended flag; none = all. Frames wait in a queue of
    `encoders.queue_frames`; when it is full the oldest is dropped and counted, since the newest reading is worth
    most. `frames` counts all frames from the bus, dropped ones included. Receive times are CLOCK_MONOTONIC. The bus's
    own troubles (bus-off, error-passive) are reported as state until a data frame or the controller's restart.

    python-can's Notifier and AsyncBufferedReader are not used: the former takes one frame per wake-up and reports its
    exceptions to nobody, the latter's queue is unbounded.
    """

    def __init__(
        self,
        encoders: Encoders,
        can_ids: Sequence[tuple[int, bool]],
        on_frames: Callable[[Sequence[CanFrame]], None],
        on_state: Callable[[str | None], None],
        open_bus: Callable[..., can.BusABC] = open_bus,
    ):
        super().__init__(encoders.channel, on_state)
        names = ("frames", "kernel_dropped", "queue_dropped", "remote_frames", "bad_frames", "error_frames",
                 *can_errors.COUNTERS, "sent", "send_dropped", "send_errors", "close_errors")  # fmt: skip
        self._clock = ReceiveClock()
        self.counters |= dict.fromkeys(names, 0) | self._clock.counters
        self._encoders = encoders
        self._bus_arguments = _bus_arguments(encoders, can_ids)
        self._on_frames = on_frames
        self._open_bus = open_bus
        self._bus: can.BusABC | None = None
        self._reader: threading.Thread | None = None
        self._stop_reader = threading.Event()
        self._file_number: int | None = None
        self._interface_index: int | None = None
        # The bus's trouble as of the last frame read, as text; written by the reader thread.
        self._bus_state: str | None = None
        self._queue: deque[CanFrame] = deque()
        self._delivery_due = False
        self._bursts = Bursts(encoders.rate_hz)
        self._heard_ns = 0
        self._kernel_dropped = 0  # of the open socket
        self._guard: int | None = None  # holds the lock on an slcan adapter
        self._lock = threading.Lock()  # guards the queue and _delivery_due
        self._sends = threading.BoundedSemaphore(SENDS_WAITING)

    async def run(self) -> None:
        """Keep the bus open and read it until cancelled."""
        try:
            await super().run()
        finally:
            # A delivery may still be scheduled, but nothing may be handed over after the end.
            self._queue.clear()

    def send(self, can_id: int, data: bytes, extended: bool = False) -> None:
        """Send a data frame, in order and off the event loop. Refused and counted while the bus is away or stuck."""
        if not (self._is_open and self._sends.acquire(blocking=False)):
            self.counters["send_dropped"] += 1
            return
        self._worker.submit(self._send, can.Message(arbitration_id=can_id, data=data, is_extended_id=extended))

    def _send(self, message: can.Message) -> None:
        try:
            assert self._bus is not None
            self._bus.send(message, timeout=SEND_TIMEOUT_S)
            self.counters["sent"] += 1
        except Exception as error:  # vendor drivers raise their own
            self.counters["send_errors"] += 1
            log.debug("bus=%s send=%s", self._device, reason_of(error))
            # The kernel reports only once to a socket that its interface went down: the reader then never learns of it.
            if isinstance(error.__cause__, OSError) and error.__cause__.errno in INTERFACE_GONE:
                self._loop.call_soon_threadsafe(self._lose, reason_of(error))
        finally:
            self._sends.release()

    def _open(self) -> None:
        if self._encoders.interface == "slcan":
            # pyserial's `exclusive` cannot be given to slcan, which at once writes commands that would close another
            # program's channel. So the device is locked first, the way pyserial locks.
            self._guard = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            fcntl.flock(self._guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # Read before opening, so that an interface replaced in between is noticed.
        self._interface_index = _interface_index(self._device)
        self._bus = self._open_bus(**self._bus_arguments)
        self._bus_state = None
        self._kernel_dropped = 0
        self._heard_ns = time.monotonic_ns()
        if isinstance(self._bus, SlcanBus):
            request_low_latency(self._bus.serialPortOrig)
        sock = getattr(self._bus, "socket", None)
        if isinstance(sock, socket.socket):
            with suppress(OSError):
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            # Binding to an interface that is down succeeds and leaves ENETDOWN for the first read.
            if number := sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                raise OSError(number, "")

    def _close(self) -> None:
        if self._reader is not None:
            self._stop_reader.set()
            self._reader.join()
            self._reader = None
        bus, self._bus = self._bus, None
        if bus is not None:
            self._shut_down(bus)
        if self._guard is not None:
            os.close(self._guard)
            self._guard = None

    def _shut_down(self, bus: can.BusABC) -> None:
        try:
            bus.shutdown()
        except Exception:
            # slcan writes to its port first, which fails after a hang-up and leaves the port open.
            self.counters["close_errors"] += 1
            if isinstance(bus, SlcanBus):
                with suppress(OSError):
                    bus.serialPortOrig.close()

    def _start_reading(self) -> None:
        bus = self._bus
        assert bus is not None
        try:
            self._file_number = bus.fileno()
            self._loop.add_reader(self._file_number, self._on_readable, bus)
        except (NotImplementedError, OSError, ValueError, can.CanError):
            # virtual and most vendors' buses have nothing to wait on.
            self._file_number = None
            self._stop_reader.clear()
            self._reader = threading.Thread(target=self._read_in_thread, args=(bus,), name=f"drd {self._device} reader")
            self._reader.start()

    def _stop_reading(self) -> None:
        self._stop_reader.set()
        if self._file_number is not None:
            self._loop.remove_reader(self._file_number)
            self._file_number = None

    def _on_readable(self, bus: can.BusABC) -> None:
        if not self._is_open or bus is not self._bus:  # lost before its turn came
            return
        try:
            # Frames left after this many wake the loop again: only SlcanBus holds complete frames back.
            for _ in range(min(FRAMES_PER_WAKE_UP, self._encoders.queue_frames)):
                if not self._receive(bus, 0):
                    break
        except Exception as error:  # vendor drivers raise their own
            self._lose(reason_of(error))
        else:
            if isinstance(bus, SlcanBus) and bus.has_line:
                self._loop.call_soon(self._on_readable, bus)
        self._deliver()

    def _read_in_thread(self, bus: can.BusABC) -> None:
        try:
            while not self._stop_reader.is_set():
                if self._receive(bus, THREAD_POLL_S):
                    self._schedule_delivery()
        except Exception as error:  # vendor drivers raise their own
            self._loop.call_soon_threadsafe(self._lose, reason_of(error))

    def _receive(self, bus: can.BusABC, timeout_s: float) -> bool:
        """Take one frame from the bus; False if there is none. Raises when the bus is lost."""
        try:
            message = bus.recv(timeout_s)
        except Exception as error:
            # slcan raises these for a line that is not a frame, others if the adapter is gone.
            if not (isinstance(bus, SlcanBus) and isinstance(error, (ValueError, KeyError, IndexError))):
                raise
            self.counters["bad_frames"] += 1
            return True
        if message is None:
            if not isinstance(bus, SlcanBus):
                return False
            if bus.has_line:  # after one that is not a frame, or not wanted
                return True
            # Noise without line ends would grow the buffer for ever.
            if len(bus._buffer) > SLCAN_LINE_BYTES:
                bus._buffer.clear()
                self.counters["bad_frames"] += 1
            return False
        self._take(message)
        return True

    def _take(self, message: can.Message) -> None:
        """Sort one message: data into the queue, everything else into its counter."""
        data = bytes(message.data)
        if message.is_error_frame:
            self.counters["error_frames"] += 1
            reported = can_errors.problems(message.arbitration_id, data)
            for name in reported:
                self.counters[name] += 1
            self._bus_state = can_errors.state_after(reported, self._bus_state)
        elif message.is_remote_frame:
            self.counters["remote_frames"] += 1
        elif len(data) != message.dlc or not 0 <= message.arbitration_id <= _mask(message.is_extended_id):
            # slcan passes truncated lines as frames with too little data.
            self.counters["bad_frames"] += 1
        else:
            t_ns = self._clock.to_monotonic_ns(message.timestamp)
            self._bus_state = None
            self.counters["frames"] += 1
            with self._lock:
                if len(self._queue) >= self._encoders.queue_frames:
                    self._queue.popleft()
                    self.counters["queue_dropped"] += 1
                self._queue.append(CanFrame(t_ns, message.arbitration_id, message.is_extended_id, data))

    def _schedule_delivery(self) -> None:
        with self._lock:
            due, self._delivery_due = self._delivery_due, True
        if not due:
            self._loop.call_soon_threadsafe(self._deliver)

    def _deliver(self) -> None:
        """Hand over one batch; further batches take their turn in the loop."""
        with self._lock:
            self._delivery_due = False
            batch = [self._queue.popleft() for _ in range(min(FRAMES_PER_BATCH, len(self._queue)))]
            more = bool(self._queue)
        if more:
            self._schedule_delivery()
        self.counters.update(self._clock.counters)
        if self._is_open:
            self._report(self._bus_state)
        if batch:
            self._wait_s = FIRST_WAIT_S
            self._heard_ns = batch[-1].t_ns
            self._on_frames(self._bursts.spread(batch) if isinstance(self._bus, SlcanBus) else batch)

    def _count_kernel_drops(self) -> None:
        sock = getattr(self._bus, "socket", None)
        if isinstance(sock, socket.socket):
            with suppress(OSError, struct.error):  # before Linux 4.12
                dropped = dropped_by_kernel(sock)
                self.counters["kernel_dropped"] += (dropped - self._kernel_dropped) % 2**32
                self._kernel_dropped = dropped

    def _vanished(self) -> str | None:
        self._count_kernel_drops()
        if isinstance(self._bus, SlcanBus) and time.monotonic_ns() - self._heard_ns > SLCAN_SILENCE_NS:
            return "silent; its channel may have been closed"
        # The socket of an interface that was deleted and recreated stays silent for ever. Devices that are not network
        # interfaces never have an index.
        same = _interface_index(self._device) == self._interface_index
        return None if same else "the interface was deleted or recreated"


def _bus_arguments(encoders: Encoders, can_ids: Sequence[tuple[int, bool]]) -> dict[str, Any]:
    """Arguments of can.Bus. python-can's configuration files are not read: ours is complete."""
    filters = [{"can_id": i, "can_mask": _mask(extended), "extended": extended} for i, extended in can_ids]
    arguments: dict[str, Any] = {"interface": encoders.interface, "channel": encoders.channel, "ignore_config": True}
    arguments["can_filters"] = filters or None
    if encoders.bitrate is not None and encoders.interface != "socketcan":
        arguments["bitrate"] = encoders.bitrate
    if encoders.interface == "slcan":
        # slcan sleeps 2 s after opening unless told; timeout 0 keeps recv(0) from waiting for a byte.
        arguments |= {"sleep_after_open": encoders.open_delay_s, "timeout": 0}
    return arguments


def _interface_index(name: str) -> int | None:
    try:
        return socket.if_nametoindex(name)
    except OSError:
        return None


def _mask(extended: bool) -> int:
    return 0x1FFFFFFF if extended else 0x7FF


def dropped_by_kernel(sock: socket.socket) -> int:
    """Frames that this socket lost because its receive buffer was full, modulo 2^32. Raises OSError, struct.error."""
    *_, dropped = MEMINFO.unpack(sock.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size))
    return int(dropped)
