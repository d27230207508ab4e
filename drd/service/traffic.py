"""Rates of inputs and outputs, and latency."""

import time

from drd.units import NS_PER_MS, S_PER_NS


class Traffic:
    """Rates of wheel samples and poses, and time from an input's arrival to its pose, over the last full period."""

    def __init__(self) -> None:
        names = ("wheel_rate_hz", "pose_rate_hz", "latency_mean_ms", "latency_max_ms")
        self.last: dict[str, float | None] = dict.fromkeys(names)
        self._began_ns = time.monotonic_ns()
        self._count = self._sum_ns = self._max_ns = self._wheel_samples = 0

    def add(self, latency_ns: int) -> None:
        """Count a pose that was published."""
        self._count += 1
        self._sum_ns += latency_ns
        self._max_ns = max(self._max_ns, latency_ns)

    def close_period(self, now_ns: int, wheel_samples: int) -> None:
        """Set `last` from what was added since the last call.

        `wheel_samples` counts them from the start, or from a reload.
        """
        if wheel_samples < self._wheel_samples:
            self._wheel_samples = 0
        n, period_s = self._count, max((now_ns - self._began_ns) * S_PER_NS, S_PER_NS)
        self.last = {
            "wheel_rate_hz": (wheel_samples - self._wheel_samples) / period_s,
            "pose_rate_hz": n / period_s,
            "latency_mean_ms": self._sum_ns / n / NS_PER_MS if n else None,
            "latency_max_ms": self._max_ns / NS_PER_MS if n else None,
        }
        self._began_ns, self._count, self._sum_ns, self._max_ns = now_ns, 0, 0, 0
        self._wheel_samples = wheel_samples
