"""Current state of one robot: newest pose and health, their arrivals, and the last hour."""

import time
from collections import deque
from collections.abc import Iterable
from typing import Any, Final

import msgspec

from drd.units import S_PER_NS
from drd_tools.web.daemon import Heard
from drd_tools.web.history import History
from drd_tools.web.messages import Pose, read_health, read_pose

# Number of delays kept: of the last minute, or at 200 poses/s of the last six seconds.
_DELAYS: Final = 1200
_RATE_S: Final = 3.0
# Arrivals that are counted for it: the fastest encoders (encoders.rate_hz) bring 1000 poses/s, now and then more.
_ARRIVALS: Final = 4000
# Silence after which a pose counts as missing, and the last one is no longer current.
SILENT_S: Final = 3.0
QUANTILES: Final = (0.5, 0.9, 0.99)


class State:
    """Messages in, by `take`; the pages and the metrics read its attributes."""

    def __init__(self) -> None:
        self.pose: Pose | None = None
        self.health: dict[str, Any] = {}
        self.health_message: dict[str, Any] = {"type": "health", "health": None}
        self.history = History()
        self.counters = dict.fromkeys(("poses_received", "poses_lost", "messages_unreadable"), 0)
        self.delay_sum_s = 0.0
        self.commands_allowed = False
        self._pose_s: float | None = None
        self._health_s: float | None = None
        self._times_s: deque[float] = deque(maxlen=_ARRIVALS)
        self._delays_s: deque[float] = deque(maxlen=_DELAYS)
        # The pages' time: the wall clock of the start, which no step of the clock disturbs later.
        self._wall_offset_s = time.time() - time.monotonic()

    def wall_s(self, monotonic_s: float) -> float:
        """The pages' time, seconds since 1970; it never decreases."""
        return monotonic_s + self._wall_offset_s

    def take_poses(self, heard: Iterable[Heard]) -> list[dict[str, Any]]:
        """Take poses in order of arrival. Return those that are events (see history)."""
        events = []
        for payload, monotonic_s, wall_ns in heard:
            pose = read_pose(payload)
            if pose is None:
                self.counters["messages_unreadable"] += 1
                continue
            self._count(pose, monotonic_s, wall_ns)
            if (event := self.history.add(self.wall_s(monotonic_s), pose)) is not None:
                events.append(event)
            self.pose, self._pose_s = pose, monotonic_s
        return events

    def _count(self, pose: Pose, monotonic_s: float, wall_ns: int) -> None:
        self.counters["poses_received"] += 1
        if self.pose is not None:  # a lower number is that of another start of the daemon
            self.counters["poses_lost"] += max(0, pose.sequence - self.pose.sequence - 1)
        delay_s = (wall_ns - pose.wall_ns) * S_PER_NS
        self.delay_sum_s += delay_s
        self._delays_s.append(delay_s)
        self._times_s.append(monotonic_s)

    def take_health(self, heard: Heard) -> bool:
        """Take a health message; return whether it was readable."""
        health = read_health(heard.payload)
        if health is None:
            self.counters["messages_unreadable"] += 1
            return False
        self.health, self._health_s = health, heard.monotonic_s
        self.health_message = {"type": "health", "health": msgspec.Raw(heard.payload)}
        return True

    def pose_age_s(self, now_s: float) -> float | None:
        """Time since the newest pose arrived; None: none yet."""
        return None if self._pose_s is None else now_s - self._pose_s

    def health_age_s(self, now_s: float) -> float | None:
        """Time since the newest health arrived; None: none yet."""
        return None if self._health_s is None else now_s - self._health_s

    def rate_hz(self, now_s: float) -> float:
        """Rate of arrival of poses over the last seconds."""
        return sum(now_s - t < _RATE_S for t in self._times_s) / _RATE_S

    def delays_s(self) -> dict[float, float]:
        """Quantiles of the delay from a pose's time to its arrival, by two wall clocks; {} without poses."""
        ordered = sorted(self._delays_s)
        return {q: ordered[min(len(ordered) - 1, int(q * len(ordered)))] for q in QUANTILES} if ordered else {}

    def pose_message(self, number: int) -> dict[str, Any] | None:
        """The newest pose for the pages; `number` counts these messages, so that a page sees a gap."""
        if self.pose is None or self._pose_s is None:
            return None
        p = self.pose
        (xx, xy, _), (_, yy, _), (_, _, hh) = p.covariance_m_rad
        return {
            "type": "pose",
            "number": number,
            "time_s": round(self.wall_s(self._pose_s), 3),
            "x_m": p.x_m,
            "y_m": p.y_m,
            "heading_rad": p.heading_rad,
            "speed_m_s": p.speed_m_s,
            "rate_rad_s": p.rate_rad_s,
            "covariance": (xx, xy, yy, hh),
            "bound_m": p.position_bound_99_m,
            "validity": p.validity,
            "reasons": p.reasons,
        }

    def status_message(self, now_s: float, alive: bool, browsers: int) -> dict[str, Any]:
        """Status for the pages: arrival of messages."""
        delays_s = self.delays_s()
        return {
            "type": "status",
            "time_s": round(self.wall_s(now_s), 3),
            "alive": alive,
            "pose_age_s": self.pose_age_s(now_s),
            "health_age_s": self.health_age_s(now_s),
            "rate_hz": self.rate_hz(now_s),
            "delay_s": [delays_s[q] for q in (0.5, 0.99)] if delays_s else None,
            "commands": self.commands_allowed and alive,
            "counters": self.counters | {"browsers": browsers},
        }
