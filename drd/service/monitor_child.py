"""The daemon's handle on the monitor's process: records go out in batches, reports come in, and nothing blocks."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from typing import Any, Final

import msgspec

from drd.service.monitor_channel import ARGUMENTS, BATCH_RECORDS, GAP, LARGEST_PACKET_BYTES, RECORD, Report, Setup
from drd.units import S_PER_NS

# Buffer for a slow monitor: some 10 s of samples, including the kernel's overhead per packet.
BUFFER_BYTES: Final = 1 << 16
# A monitor that takes nothing for so long is given up: on a machine that starves it, it would be useless anyway.
HUNG_S: Final = 60.0
# Time from its closing the channel to its end.
GRACE_S: Final = 0.5
END_S: Final = 2.0


class Ended(Exception):  # noqa: N818  # an outcome
    """The process is no longer usable; the text says why."""


class Child:
    """One run of the process, with a batch of records for it. Raises OSError where it cannot start."""

    def __init__(self, setup: Setup):
        self.channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            try:
                self.channel.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
                self.channel.setblocking(False)
                self.channel.send(msgspec.json.encode(setup))
                self.child = subprocess.Popen(
                    [sys.executable, *ARGUMENTS],
                    stdin=theirs.fileno(),
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    env=_environment(),
                )
            except BaseException:
                self.channel.close()
                raise
        self.began_ns = time.monotonic_ns()
        self._batch = bytearray((1 + BATCH_RECORDS) * RECORD.size)
        self._count = 1  # the first record is reserved for a gap
        self._gap_ns: int | None = None  # since when it has taken nothing
        self.dropped = 0

    def put(self, kind: int, sample: tuple[Any, ...], last: float = 0.0) -> None:
        """Add a sample, or a pose, to the batch; a full batch is handed over first."""
        if self._count > BATCH_RECORDS:
            self.flush()
        RECORD.pack_into(self._batch, self._count * RECORD.size, kind, *sample[:4], last)
        self._count += 1

    def flush(self) -> None:
        """Hand the batch over, or drop and count it if there is no room."""
        count, self._count = self._count - 1, 1
        first = RECORD.size
        if self._gap_ns is not None:
            first = 0
            RECORD.pack_into(self._batch, 0, GAP, 0, 0.0, 0.0, 0.0, 0.0)
        elif not count:
            return
        try:
            self.channel.send(memoryview(self._batch)[first : (1 + count) * RECORD.size])
        except BlockingIOError:
            self.dropped += count
            self._gap_ns = self._gap_ns or time.monotonic_ns()
        except OSError:  # it has ended, which will be noticed soon
            self.dropped += count
        else:
            self._gap_ns = None

    def check(self) -> None:
        """Raise Ended if the process has accepted nothing for too long."""
        if self._gap_ns is not None and (time.monotonic_ns() - self._gap_ns) * S_PER_NS > HUNG_S:
            raise Ended(f"it has accepted no samples for {HUNG_S:g} s")

    def report(self) -> Report | None:
        """The next report that has arrived, if any. Raises Ended."""
        try:
            packet = self.channel.recv(LARGEST_PACKET_BYTES)
        except BlockingIOError:
            return None
        except OSError as error:
            raise Ended(error.strerror or str(error)) from None
        if not packet:
            raise Ended("")
        report = msgspec.json.decode(packet, type=Report)
        if report.error is not None:
            raise Ended(report.error)
        return report

    def end(self, has_ended: bool = False) -> str:
        """Kill the process and wait for the kernel; return how it had already ended, in words.

        `has_ended`: it seems to have ended on its own.
        """
        self.channel.close()
        code = self.child.poll()
        if code is None and has_ended:  # it closes the channel just before it ends
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = self.child.wait(GRACE_S)
        self.child.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.child.wait(END_S)
        if code is None:
            return "ended by drd"
        return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def _environment() -> dict[str, str]:
    """The daemon's environment without systemd's variables; modules are found where the daemon found them."""
    found = {name: value for name, value in os.environ.items() if name not in ("NOTIFY_SOCKET", "WATCHDOG_USEC")}
    return found | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path), "OPENBLAS_NUM_THREADS": "1"}
