"""Losses and refusals by overload: counted in the health, and logged once."""

import logging
from collections.abc import Mapping
from typing import Any, Final

log = logging.getLogger(__name__)

# Health counters by part and name, and what an increase means.
TOLD: Final = {
    ("encoders.port", "queue_dropped"): "the bus delivers more frames than drd processes; the oldest are dropped",
    ("encoders.port", "kernel_dropped"): "the bus delivers more frames than drd reads; the kernel drops them",
    ("zenoh", "full_queues"): "a neighbour does not keep up; messages to it are dropped",
    ("zenoh", "queries_refused"): "queries are refused",
    ("recording", "lost"): "the disk does not keep up or has failed; the recording has gaps",
}


class Losses:
    """Logs the first increase of each health counter that means a loss."""

    def __init__(self) -> None:
        self._told: set[tuple[str, str]] = set()

    def look(self, health: Mapping[str, Any]) -> None:
        """Log each of TOLD at its first increase, and never again."""
        parts = {**health["counters"], "recording": health["recording"] or {}}
        for (part, name), text in TOLD.items():
            if (count := parts.get(part, {}).get(name, 0)) and (part, name) not in self._told:
                self._told.add((part, name))
                log.warning("%s.%s=%d: %s; from now on counted only in the health", part, name, count, text)
