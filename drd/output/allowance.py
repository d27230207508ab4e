"""Rate limiter: a token bucket."""

import threading
import time
from collections.abc import Callable


class Allowance:
    """A bucket of at most `at_once` tokens, refilled at `per_s` (1/s). May be used from any thread."""

    def __init__(self, per_s: float, at_once: float, clock_s: Callable[[], float] = time.monotonic):
        self._per_s, self._at_once, self._clock_s = per_s, at_once, clock_s
        self._lock = threading.Lock()
        self._left, self._filled_s = at_once, clock_s()

    def take(self) -> bool:
        """Take a token; False where none is left."""
        with self._lock:
            now_s = self._clock_s()
            self._left = min(self._at_once, self._left + (now_s - self._filled_s) * self._per_s)
            self._filled_s = now_s
            if self._left < 1.0:
                return False
            self._left -= 1.0
            return True
