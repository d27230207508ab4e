"""Answer Zenoh queries: Zenoh's threads only hand them over, the handlers run in the daemon's event loop."""

import asyncio
import contextlib
import logging
import queue
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import zenoh

from drd.output.allowance import Allowance
from drd.output.command_log import CommandLog, neighbours
from drd.output.forms import COMMANDS, QUESTIONS, Form, JsonForm, Reply
from drd.output.messages import MAX_REQUEST_BYTES, Refused

MAX_IN_FLIGHT = 64
# Beyond this rate queries are refused unread: parsing them would take time that the poses need.
QUERIES_PER_S = 200.0
QUERIES_AT_ONCE = 100.0

Handler = Callable[[dict[str, Any]], dict[str, Any]]

log = logging.getLogger(__name__)


class QueryDesk:
    """Receives queries, has them handled in `loop`, and sends the replies from its own thread.

    The loop never replies itself: a getter that has stopped reading blocks a reply for 5 s, until Zenoh gives the
    neighbour up. At most MAX_IN_FLIGHT queries are between arrival and reply, and at most QUERIES_PER_S are read; more
    are refused, whoever sent them. Commands are logged, whether carried out or refused; a get whose wildcard happens to
    match a command is not one.
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
        self._command_log = CommandLog(lambda: neighbours(self._session), self._outbox.put)
        self.counters = counters
        counters.update(dict.fromkeys(("queries", "query_errors", "queries_refused", "commands"), 0))
        self._replies = threading.Thread(target=self._work, name="zenoh-replies", daemon=True)
        self._replies.start()

    def declare(self, session: Any, prefix: str, services: Sequence[Form] = ()) -> None:
        """Declare a queryable under `prefix` for every handler's name, and one for each of `services`.

        The callbacks run in Zenoh's receiving threads (`indirect=False`): Python threads would keep the interpreter
        from exiting if the session were not closed.
        """
        self._session = session
        for form in (*(JsonForm(name, f"{prefix}/{name}") for name in (*QUESTIONS, *COMMANDS)), *services):
            callback = zenoh.handlers.Callback(partial(self._receive, form), indirect=False)
            session.declare_queryable(form.key, callback, complete=form.complete)

    def close(self) -> None:
        """Refuse queries from now on and let the reply thread end. Call before closing the session."""
        self._closed = True
        self._outbox.put(None)

    def join(self) -> None:
        """Wait for the reply thread. Call after closing the session, which fails a reply that waits for a neighbour.

        An interpreter that exits while the thread is inside a Zenoh function kills it there, whereupon Zenoh aborts the
        process (PyO3, pull request 4874).
        """
        self._replies.join()

    def _receive(self, form: Form, query: Any) -> None:
        """Accept a query; runs in Zenoh's thread, so does bounded work and never raises."""
        self._count("queries")
        if form.name in COMMANDS and str(query.key_expr) != form.key:
            # A get on `prefix/**` is meant to read; it must not reset the robot.
            self._count("queries_refused")
            query.drop()
        elif form.name in COMMANDS and not self._commands_allowed:
            self._refuse(form, query, "queries_refused", f"{form.name} is not allowed: output.commands is false")
        elif not self._allowance.take():
            self._refuse(form, query, "queries_refused", f"more than {QUERIES_PER_S:g} queries per second")
        else:
            try:
                request = form.read(_bytes(query.payload, "payload"), _attachment(query))
            except Refused as error:
                self._refuse(form, query, "query_errors", str(error))
                return
            if not self._submit(form, query, request):
                self._refuse(form, query, "queries_refused", f"stopping, or busy with {MAX_IN_FLIGHT} queries")

    def _submit(self, form: Form, query: Any, request: dict[str, Any]) -> bool:
        with self._lock:
            if self._closed or self._in_flight >= MAX_IN_FLIGHT:
                return False
            self._in_flight += 1
        try:
            self._loop.call_soon_threadsafe(self._handle, form, query, request)
        except RuntimeError:  # the loop is closed
            self._release()
            return False
        return True

    def _handle(self, form: Form, query: Any, request: dict[str, Any]) -> None:
        """Answer a query; runs in the event loop."""
        try:
            reply = form.answer(_attachment(query), self._handlers[form.name](request))
            if form.name in COMMANDS:
                self._count("commands")
                self._command_log.accepted(form.key, query.payload)
        except Refused as error:
            reply, _ = self._refusal(form, query, "query_errors", str(error))
        except Exception:
            log.exception("zenoh: handler=%s failed", form.name)
            reply, _ = self._refusal(form, query, "query_errors", "internal error, see the log")
        self._outbox.put(lambda: _send(form, query, reply))
        self._outbox.put(self._release)

    def _work(self) -> None:
        while (work := self._outbox.get()) is not None:
            work()

    def _refuse(self, form: Form, query: Any, counter: str, text: str) -> None:
        reply, is_logged = self._refusal(form, query, counter, text)
        if is_logged:  # after that line, which names the neighbours: the asker may leave once answered
            self._outbox.put(lambda: _send(form, query, reply))
        else:
            _send(form, query, reply)

    def _refusal(self, form: Form, query: Any, counter: str, text: str) -> tuple[Reply, bool]:
        """Count and log a refusal; return the answer, and whether a line is written."""
        self._count(counter)
        is_logged = form.name in COMMANDS and self._command_log.refused(form.key, query.payload, text)
        return form.refusal(_attachment(query), text), is_logged

    def _release(self) -> None:
        with self._lock:
            self._in_flight -= 1

    def _count(self, counter: str) -> None:
        with self._lock:
            self.counters[counter] += 1


def _bytes(data: Any, what: str) -> bytes:
    """Copy a query's bytes after checking their size. Raises Refused."""
    if data is None:
        return b""
    if len(data) > MAX_REQUEST_BYTES:
        raise Refused(f"{what} of {len(data)} bytes; at most {MAX_REQUEST_BYTES} are read")
    copied: bytes = data.to_bytes()
    return copied


def _attachment(query: Any) -> bytes:
    """The query's attachment; one that is too long counts as none."""
    with contextlib.suppress(Refused):
        return _bytes(query.attachment, "attachment")
    return b""


def _send(form: Form, query: Any, reply: Reply) -> None:
    # If the session closes meanwhile the reply fails, but nobody waits for it any more. Leaving the query's context
    # finalises it, so that the getter ends at once.
    with contextlib.suppress(zenoh.ZError), query:
        if reply.failed:
            query.reply_err(reply.payload, encoding=reply.encoding)
        else:
            query.reply(form.key, reply.payload, encoding=reply.encoding, attachment=reply.attachment)
