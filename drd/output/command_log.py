"""The log of commands from outside: command, sender as far as known, and outcome."""

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh

from drd.output.allowance import Allowance

log = logging.getLogger(__name__)

MAX_SHOWN = 200
MAX_NEIGHBOURS = 8
# Refusals beyond this are counted, not logged: a flood of commands must not fill the disk.
REFUSALS_PER_S = 2.0
REFUSALS_AT_ONCE = 10.0


class CommandLog:
    """Logs each command carried out, and refused ones up to REFUSALS_PER_S.

    A Zenoh query does not say who sent it; the line names the neighbours at the time of writing: address and, with TLS,
    the common name of the certificate. `later` takes the writing, which may wait for the disk; the rest only counts and
    may be called from any thread.
    """

    def __init__(
        self,
        neighbours: Callable[[], list[str]],
        later: Callable[[Callable[[], None]], None],
        clock_s: Callable[[], float] = time.monotonic,
    ):
        self._neighbours, self._later = neighbours, later
        self._allowance = Allowance(REFUSALS_PER_S, REFUSALS_AT_ONCE, clock_s)
        self._lock = threading.Lock()
        self._unwritten = 0

    def accepted(self, key: str, payload: Any) -> None:
        """Log a command that was carried out; `payload` is the query's, zenoh.ZBytes or None."""
        self._later(lambda: self._write(key, payload, "accepted"))

    def refused(self, key: str, payload: Any, reason: str) -> bool:
        """Log a command that was not carried out, unless there are too many; return whether it was logged."""
        allowed = self._allowance.take()
        with self._lock:
            unwritten = self._unwritten
            self._unwritten = 0 if allowed else unwritten + 1
        if allowed:
            outcome = f"refused reason={reason!a}" + (f" unwritten_before={unwritten}" if unwritten else "")
            self._later(lambda: self._write(key, payload, outcome))
        return allowed

    def _write(self, key: str, payload: Any, outcome: str) -> None:
        found = self._neighbours()
        more = [f"{len(found) - MAX_NEIGHBOURS} more"] if len(found) > MAX_NEIGHBOURS else []
        who = ", ".join(found[:MAX_NEIGHBOURS] + more)
        log.warning("zenoh: command=%s outcome=%s payload=%s neighbours=[%s]", key, outcome, _shown(payload), who)


def neighbours(session: Any) -> list[str]:
    """The other end of each open link of a zenoh.Session: its certificate's common name, if any, and address."""
    try:
        return [f"{link.auth_identifier or 'unknown'!a} at {link.dst}" for link in session.info.links()]
    except zenoh.ZError:  # the session is closed
        return []


def _shown(payload: Any) -> str:
    """The payload quoted, in ASCII and bounded: it can neither break the line nor fill the log."""
    data = payload.to_bytes() if payload is not None else b""
    return repr(data[:MAX_SHOWN])[1:] + ("..." if len(data) > MAX_SHOWN else "")
