"""History of the last hour, in memory of a fixed size: poses, and changes of validity with their reasons."""

import math
from collections import deque
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from drd_tools.web.messages import VALIDITIES, Pose

SPAN_S: Final = 3600.0
# 0.4 m apart at 2 m/s: as fine as a map of the run can show.
PERIOD_S: Final = 0.2
COLUMNS: Final = (
    "time_s",
    "x_m",
    "y_m",
    "heading_rad",
    "speed_m_s",
    "rate_rad_s",
    "variance_x_m2",
    "covariance_xy_m2",
    "variance_y_m2",
    "variance_heading_rad2",
    "bound_m",
    "validity",
)
_ROWS: Final = round(SPAN_S / PERIOD_S)
_EVENTS: Final = 500
# Timers are sometimes late; a row due within this time is taken.
_SLACK_S: Final = 0.02


class History:
    """`rows`: COLUMNS every PERIOD_S; `events`: each change of validity or of the reasons' sources."""

    def __init__(self) -> None:
        self._ring = np.empty((_ROWS, len(COLUMNS)), "<f8")
        self._count = 0
        self._next_s = -math.inf
        self._events: deque[dict[str, Any]] = deque(maxlen=_EVENTS)
        self._told: Any = None

    def add(self, time_s: float, pose: Pose) -> dict[str, Any] | None:
        """Add a pose, at a non-decreasing time. Return its event, if it is one; each event has a row."""
        event = self._event(time_s, pose)
        is_due = time_s >= self._next_s - _SLACK_S
        if is_due or event is not None:
            (xx, xy, _), (_, yy, _), (_, _, hh) = pose.covariance_m_rad
            self._ring[self._count % _ROWS] = (
                time_s,
                *(pose.x_m, pose.y_m, pose.heading_rad, pose.speed_m_s, pose.rate_rad_s),
                *(xx, xy, yy, hh, pose.position_bound_99_m),
                VALIDITIES.index(pose.validity),
            )
            self._count += 1
        if is_due:
            self._next_s = max(self._next_s, time_s - _SLACK_S) + PERIOD_S
        return event

    def _event(self, time_s: float, pose: Pose) -> dict[str, Any] | None:
        told = (pose.validity, tuple(reason.source for reason in pose.reasons))
        if told == self._told:
            return None
        self._told = told
        reasons = [{"source": reason.source, "text": reason.text} for reason in pose.reasons]
        event = {"time_s": time_s, "validity": pose.validity, "reasons": reasons}
        self._events.append(event)
        return event

    def rows(self) -> npt.NDArray[np.float64]:
        """Rows of COLUMNS, shape (n, len(COLUMNS)), oldest first, of the SPAN_S before the newest."""
        start = self._count % _ROWS
        kept = self._ring[: self._count] if self._count <= _ROWS else np.roll(self._ring, -start, axis=0)
        return kept[kept[:, 0] > kept[-1, 0] - SPAN_S] if len(kept) else kept

    def events(self) -> list[dict[str, Any]]:
        """Events of the last SPAN_S, oldest first, and the one before, which still held then."""
        events = list(self._events)
        begin_s = events[-1]["time_s"] - SPAN_S if events else 0.0
        if self._count:
            begin_s = self._ring[(self._count - 1) % _ROWS, 0] - SPAN_S
        first = sum(event["time_s"] <= begin_s for event in events)
        return events[max(0, first - 1) :]
