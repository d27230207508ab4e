"""Whatever is refused or lost because there is too much of it: counted in the health, and told once in the log."""

import logging
from collections.abc import Mapping
from typing import Any, Final

log = logging.getLogger(__name__)

# Counters of the health by part and name, and what it means that they rise.
TOLD: Final = {
    ("encoders.port", "queue_dropped"): "the bus brings more frames than drd takes, the oldest are dropped",
    ("encoders.port", "kernel_dropped"): "the bus brings more frames than drd reads, the kernel drops them",
    ("zenoh", "full_queues"): "a neighbour does not keep up, messages to it are dropped",
    ("zenoh", "queries_refused"): "queries are refused",
    ("recording", "lost"): "the disk does not keep up or failed, the recording has gaps",
}


class Losses:
    """Tells in the log of counters of the health that have begun to rise."""

    def __init__(self) -> None:
        self._told: set[tuple[str, str]] = set()

    def look(self, health: Mapping[str, Any]) -> None:
        """Log each of TOLD when it is first seen to have risen; never again, however far it rises."""
        parts = {**health["counters"], "recording": health["recording"] or {}}
        for (part, name), text in TOLD.items():
            if (count := parts.get(part, {}).get(name, 0)) and (part, name) not in self._told:
                self._told.add((part, name))
                log.warning("%s.%s=%d: %s; from now on only the health counts them", part, name, count, text)
