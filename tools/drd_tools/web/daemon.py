"""Zenoh client of the daemon: its messages wait in bounded boxes, commands are sent to it as queries."""

import asyncio
import contextlib
import json
import logging
import time
from collections import deque
from typing import Any, Final, NamedTuple

import zenoh

from drd.output.ask import ask
from drd.output.messages import Refused
from drd.output.session import tidy

log = logging.getLogger(__name__)

# Capacity of a box, emptied every 0.1 s; if it is exceeded, the newest messages are kept.
_BOX: Final = 512
_RETRY_S: Final = 1.0
# How soon Zenoh tries again after a lost connection. Its own back-off, 1 to 4 s doubling, takes about 7 s.
_ZENOH_RETRY: Final = {"period_init_ms": 500, "period_max_ms": 1000, "period_increase_factor": 1.5}


class Heard(NamedTuple):
    """A message and its time of arrival."""

    payload: bytes
    monotonic_s: float
    wall_ns: int


class DaemonLink:
    """One daemon, by its Zenoh configuration and prefix. Use: `await open()`, then `poses` and `health`; `close()`.

    The boxes are filled from Zenoh's threads and may be emptied from any one thread.
    """

    def __init__(self, config: zenoh.Config, prefix: str):
        config.insert_json5("connect/retry", json.dumps(_ZENOH_RETRY))
        self._config, self._prefix = config, prefix
        self._session: Any = None
        self._declared: list[Any] = []
        self.poses: deque[Heard] = deque(maxlen=_BOX)
        self.health: deque[Heard] = deque(maxlen=_BOX)
        self.alive = False  # the daemon's liveliness token is there
        self.starts = 0  # how often it appeared

    async def open(self) -> None:
        """Connect, however long that takes; later, Zenoh itself reconnects."""
        told = None
        while self._session is None:
            try:
                self._session = await asyncio.to_thread(zenoh.open, self._config)
            except zenoh.ZError as error:
                if (text := tidy(error)) != told:
                    log.warning("zenoh: %s; trying on", text)
                    told = text
                await asyncio.sleep(_RETRY_S)
        session, prefix = self._session, self._prefix
        # Callbacks in Zenoh's receiving threads: threads of Python's own would keep the interpreter from exiting.
        self._declared = [
            session.declare_subscriber(f"{prefix}/pose", _callback(lambda sample: self._keep(self.poses, sample))),
            session.declare_subscriber(f"{prefix}/health", _callback(lambda sample: self._keep(self.health, sample))),
            session.liveliness().declare_subscriber(f"{prefix}/alive", _callback(self._on_alive), history=True),
        ]

    def close(self) -> None:
        """End the session; may wait for the network."""
        if self._session is not None:
            with contextlib.suppress(zenoh.ZError):
                self._session.close()

    @staticmethod
    def _keep(box: deque[Heard], sample: Any) -> None:
        box.append(Heard(sample.payload.to_bytes(), time.monotonic(), time.time_ns()))

    def _on_alive(self, sample: Any) -> None:
        self.alive = sample.kind == zenoh.SampleKind.PUT
        self.starts += self.alive

    def allows_commands(self) -> bool:
        """Ask whether the configuration in force allows commands; return False also without an answer."""
        try:
            return self.ask("config")["config"]["output"]["commands"] is True
        except (Refused, KeyError, TypeError):
            return False

    def ask(self, name: str, payload: bytes | None = None) -> dict[str, Any]:
        """Query the daemon, waiting some seconds for the answer. Raises Refused with the reason."""
        if self._session is None:
            raise Refused("the daemon cannot be reached")
        return ask(self._session, f"{self._prefix}/{name}", payload)


def _callback(function: Any) -> Any:
    return zenoh.handlers.Callback(function, indirect=False)
