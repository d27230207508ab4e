"""Answers to Zenoh queries: the threads that ask stay outside, the handlers run in the daemon's event loop."""

import asyncio
import contextlib
import logging
import queue
import threading
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from drd.output.allowance import Allowance
from drd.output.command_log import CommandLog, neighbours
from drd.output.messages import MAX_REQUEST_BYTES, Refused, decode_request, encode

COMMANDS = ("set_pose", "reset", "calibrate_bias")
QUESTIONS = ("pose", "health", "config")
MAX_IN_FLIGHT = 64
# Beyond, queries are refused before anything is read: parsing them would take the time that poses need.
QUERIES_PER_S = 200.0
QUERIES_AT_ONCE = 100.0

Handler = Callable[[dict[str, Any]], dict[str, Any]]

log = logging.getLogger(__name__)


class QueryDesk:
    """Takes queries in, has them handled in `loop`, sends the replies from a thread of its own.

    The loop never replies itself: a getter that has stopped reading blocks a reply for 5 s, the time after which
    Zenoh gives the neighbour up. At most MAX_IN_FLIGHT queries are between arrival and reply, and QUERIES_PER_S are
    read; more are refused, whoever sent them. Commands are logged, carried out or refused; a get with a wildcard that
    only touches a command is none.
    """

    def __init__(
        self,
        handlers: Mapping[str, Handler],
        commands_allowed: bool,
        loop: asyncio.AbstractEventLoop,
        counters: dict[str, int],
    ):
        self._handlers = handlers
        self._commands_allowed = commands_allowed
        self._loop = loop
        self._allowance = Allowance(QUERIES_PER_S, QUERIES_AT_ONCE)
        self._lock = threading.Lock()
        self._in_flight = 0
        self._closed = False
        self._session: Any = None
        self._outbox: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._command_log = CommandLog(self._neighbours, self._outbox.put)
        self.counters = counters
        counters.update(dict.fromkeys(("queries", "query_errors", "queries_refused", "commands"), 0))
        threading.Thread(target=self._work, name="zenoh-replies", daemon=True).start()

    def declare(self, session: Any, prefix: str) -> None:
        """Make every handler's name a queryable under `prefix`.

        The callbacks run in Zenoh's receiving threads (`indirect=False`): threads of Python's own would keep the
        interpreter from exiting if the session were not closed.
        """
        self._session = session
        for name in (*QUESTIONS, *COMMANDS):
            key = f"{prefix}/{name}"
            callback = zenoh.handlers.Callback(self._callback(name, key), indirect=False)
            session.declare_queryable(key, callback)

    def close(self) -> None:
        """Refuse what comes from now on and let the reply thread end. Call before the session is closed."""
        self._closed = True
        self._outbox.put(None)

    def _callback(self, name: str, key: str) -> Callable[[Any], None]:
        return lambda query: self._receive(name, key, query)

    def _receive(self, name: str, key: str, query: Any) -> None:
        """In Zenoh's thread: only bounded work, and nothing raises."""
        self._count("queries")
        if name in COMMANDS and str(query.key_expr) != key:
            # A get on `prefix/**` means to read; it must not reset the robot.
            self._count("queries_refused")
            query.drop()
        elif name in COMMANDS and not self._commands_allowed:
            self._refuse(name, key, query, "queries_refused", f"{name} is not allowed: output.commands is false")
        elif not self._allowance.take():
            self._refuse(name, key, query, "queries_refused", f"more than {QUERIES_PER_S:g} queries a second")
        else:
            try:
                payload = self._payload(query)
            except Refused as error:
                self._refuse(name, key, query, "query_errors", str(error))
                return
            if not self._submit(name, key, query, payload):
                busy = f"stopping, or busy with {MAX_IN_FLIGHT} queries"
                self._refuse(name, key, query, "queries_refused", busy)

    @staticmethod
    def _payload(query: Any) -> dict[str, Any]:
        if query.payload is None:
            return {}
        # Looked at before the bytes are copied.
        if len(query.payload) > MAX_REQUEST_BYTES:
            raise Refused(f"payload of {len(query.payload)} bytes; at most {MAX_REQUEST_BYTES} are read")
        return decode_request(query.payload.to_bytes())

    def _submit(self, name: str, key: str, query: Any, payload: dict[str, Any]) -> bool:
        with self._lock:
            if self._closed or self._in_flight >= MAX_IN_FLIGHT:
                return False
            self._in_flight += 1
        try:
            self._loop.call_soon_threadsafe(self._handle, name, key, query, payload)
        except RuntimeError:  # the loop is closed
            self._release()
            return False
        return True

    def _handle(self, name: str, key: str, query: Any, payload: dict[str, Any]) -> None:
        """In the event loop."""
        refusal = None
        try:
            answer = encode(self._handlers[name](payload))
            if name in COMMANDS:
                self._count("commands")
                self._command_log.accepted(key, query.payload)
        except Refused as error:
            refusal = str(error)
        except Exception:
            log.exception("zenoh: handler=%s failed", name)
            refusal = "internal error, see the log"
        if refusal is not None:
            answer = self._refusal(name, key, query, "query_errors", refusal)
        self._outbox.put(lambda: self._reply(query, key, answer, refusal is not None))
        self._outbox.put(self._release)

    def _work(self) -> None:
        while (work := self._outbox.get()) is not None:
            work()

    def _neighbours(self) -> list[str]:
        try:
            return neighbours(self._session) if self._session is not None else []
        except zenoh.ZError:  # the session is closed
            return []

    def _refuse(self, name: str, key: str, query: Any, counter: str, text: str) -> None:
        self._reply(query, "", self._refusal(name, key, query, counter, text), failed=True)

    def _refusal(self, name: str, key: str, query: Any, counter: str, text: str) -> bytes:
        """Count and log; the answer."""
        self._count(counter)
        if name in COMMANDS:
            self._command_log.refused(key, query.payload, text)
        return encode({"error": text})

    @staticmethod
    def _reply(query: Any, key: str, payload: bytes, failed: bool) -> None:
        # A session that closes meanwhile fails the reply; nobody waits for it any more. Leaving the query's context
        # finalises it, so that the getter ends at once.
        with contextlib.suppress(zenoh.ZError), query:
            if failed:
                query.reply_err(payload, encoding=zenoh.Encoding.APPLICATION_JSON)
            else:
                query.reply(key, payload, encoding=zenoh.Encoding.APPLICATION_JSON)

    def _release(self) -> None:
        with self._lock:
            self._in_flight -= 1

    def _count(self, counter: str) -> None:
        with self._lock:
            self.counters[counter] += 1
