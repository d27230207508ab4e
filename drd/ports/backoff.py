"""Waiting times between attempts to open a device."""

from typing import Final

FIRST_S: Final = 0.1
LONGEST_S: Final = 2.0


class Backoff:
    """0.1 s, then twice as long each time up to 2 s, until `reset()`."""

    def __init__(self) -> None:
        self._wait_s = FIRST_S

    def next_s(self) -> float:
        """Seconds to wait before the next attempt."""
        wait_s, self._wait_s = self._wait_s, min(2 * self._wait_s, LONGEST_S)
        return wait_s

    def reset(self) -> None:
        """Start again at the shortest wait: the device has delivered data."""
        self._wait_s = FIRST_S
