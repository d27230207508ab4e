"""A serial CAN adapter, read in large pieces: python-can's own reader makes two system calls per byte."""

import re
from collections.abc import Sequence
from typing import Any, Final

import can
from can.exceptions import error_check
from can.interfaces.slcan import slcanBus
from serial import Timeout

END: Final = re.compile(rb"[\r\a]")
# A data frame up to its length: kind and identifier.
HEAD: Final = re.compile(rb"(t[0-7][0-9A-Fa-f]{2}|T[01][0-9A-Fa-f]{7})[0-8]")


class SlcanBus(slcanBus):
    """Reads many bytes at a time. It buffers lines: who waits for the file descriptor must also ask `has_line`.

    Data frames with identifiers not in `can_filters`, which must name single ones, are skipped unread.
    """

    _wanted: frozenset[bytes] | None = None

    @property
    def has_line(self) -> bool:
        """Whether `recv` has a buffered line."""
        return END.search(self._buffer) is not None

    def _apply_filters(self, filters: Sequence[Any] | None) -> None:
        heads = (b"T%08X" % f["can_id"] if f.get("extended") else b"t%03X" % f["can_id"] for f in filters or ())
        self._wanted = frozenset(heads) or None

    def _read(self, timeout: float | None) -> str | None:
        """The next line with its terminator. Raises ValueError if it is not ASCII."""
        waiting, line = Timeout(timeout), self._next_line()
        while line is None:
            with error_check("Could not read from serial device"):
                port = self.serialPortOrig  # its in_waiting says why it is gone; a read would not
                self._buffer += port.read(max(1, port.in_waiting))
            line = self._next_line()
            if line is None and waiting.expired():
                return None
        return line.decode("ascii")

    def _next_line(self) -> bytes | None:
        while end := END.search(self._buffer):
            line = bytes(self._buffer[: end.end()])
            del self._buffer[: end.end()]
            head = HEAD.match(line)
            if self._wanted is None or head is None or head[1][:1] + head[1][1:].upper() in self._wanted:
                return line
        return None


def open_bus(**arguments: Any) -> can.BusABC:
    """can.Bus, with this reader for slcan."""
    if arguments["interface"] != "slcan":
        return can.Bus(**arguments)
    return SlcanBus(**{name: value for name, value in arguments.items() if name not in {"interface", "ignore_config"}})
