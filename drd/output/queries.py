"""Answers to Zenoh queries: the threads that ask stay outside, the handlers run in the daemon's event loop."""

import asyncio
import contextlib
import logging
import queue
import threading
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from drd.output.messages import MAX_REQUEST_BYTES, Refused, decode_request, encode

COMMANDS = ("set_pose", "reset", "calibrate_bias")
QUESTIONS = ("pose", "health", "config")
MAX_IN_FLIGHT = 64

Handler = Callable[[dict[str, Any]], dict[str, Any]]

log = logging.getLogger(__name__)


class QueryDesk:
    """Takes queries in, has them handled in `loop`, sends the replies from a thread of its own.

    The loop never replies itself: a getter that has stopped reading blocks a reply for 5 s, the time after which
    Zenoh gives the neighbour up. At most MAX_IN_FLIGHT queries are between arrival and reply; more are refused.
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
        self._lock = threading.Lock()
        self._in_flight = 0
        self._closed = False
        self._outbox: queue.SimpleQueue[tuple[Any, str, bytes, bool] | None] = queue.SimpleQueue()
        self.counters = counters
        counters.update(dict.fromkeys(("queries", "query_errors", "queries_refused", "commands"), 0))
        threading.Thread(target=self._send_replies, name="zenoh-replies", daemon=True).start()

    def declare(self, session: Any, prefix: str) -> None:
        """Make every handler's name a queryable under `prefix`.

        The callbacks run in Zenoh's receiving threads (`indirect=False`): threads of Python's own would keep the
        interpreter from exiting if the session were not closed.
        """
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
            self._refuse(query, "queries_refused", f"{name} is not allowed: output.commands is false")
        else:
            try:
                payload = self._payload(query)
            except Refused as error:
                self._refuse(query, "query_errors", str(error))
                return
            if not self._submit(name, key, query, payload):
                self._refuse(query, "queries_refused", f"stopping, or busy with {MAX_IN_FLIGHT} queries")

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
        try:
            answer, failed = encode(self._handlers[name](payload)), False
            if name in COMMANDS:
                self._count("commands")
                log.warning("zenoh: command=%s payload=%s", name, encode(payload)[:200].decode("ascii"))
        except Refused as error:
            answer, failed = encode({"error": str(error)}), True
            self._count("query_errors")
        except Exception:
            log.exception("zenoh: handler=%s failed", name)
            answer, failed = encode({"error": "internal error, see the log"}), True
            self._count("query_errors")
        self._outbox.put((query, key, answer, failed))

    def _send_replies(self) -> None:
        while (item := self._outbox.get()) is not None:
            self._reply(*item)
            self._release()

    def _refuse(self, query: Any, counter: str, text: str) -> None:
        self._count(counter)
        self._reply(query, "", encode({"error": text}), failed=True)

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
