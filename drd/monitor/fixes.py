"""Poses from outside: the distance between two of them shows the common error of both wheels' radii. (101)"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.monitor.evidence import HAZARD_PER_S, START_S
from drd.monitor.findings import Finding, NotObservable, size
from drd.monitor.rows import Rows
from drd.units import NS_PER_S

EFFECT: Final = "wheel_radius_error"
LARGEST: Final = 0.05  # relative: no radius in use is off by more
MOVED_SIGMAS: Final = 4.0  # of radii and noise together: beyond, the pose was moved or the robot carried
FEWEST_M: Final = 5.0  # between two poses: a shorter chord does not show a radius
NAMED_NATS: Final = math.log(20.0)
MOST_WAITING: Final = 16  # for the rows of their time, some seconds
BIAS_RAD_S: Final = 1e-5  # error left in a bias that the monitor has estimated: 2 deg/h


@dataclass
class _Way:
    """Dead reckoning since a fix, in its own frame, with the moments through which heading errors act."""

    at: Array  # of the fix, m
    sigma_m: float
    heading_rad: float = 0.0
    here: Array = field(default_factory=lambda: np.zeros(2))
    distance_m: float = 0.0
    time_s: float = 0.0
    first: Array = field(default_factory=lambda: np.zeros(2))  # integral of position over time
    second: Array = field(default_factory=lambda: np.zeros((2, 2)))
    late: Array = field(default_factory=lambda: np.zeros(2))  # of steps, turned left, times their time

    def add(self, turn_rad: Array, distance_m: Array, interval_s: Array) -> None:
        """Add rows, (n,) each."""
        heading = self.heading_rad + np.cumsum(turn_rad) - 0.5 * turn_rad
        steps = np.column_stack([distance_m * np.cos(heading), distance_m * np.sin(heading)])
        places, times = self.here + np.cumsum(steps, 0), self.time_s + np.cumsum(interval_s)
        self.first = self.first + interval_s @ places
        self.second = self.second + (places * interval_s[:, None]).T @ places
        self.late = self.late + times @ np.column_stack([-steps[:, 1], steps[:, 0]])
        self.heading_rad += float(turn_rad.sum())
        self.here, self.time_s = places[-1], float(times[-1])
        self.distance_m += float(np.abs(distance_m).sum())

    def variance_m2(self, walk: float, wheel_noise: float) -> float:
        """Variance of the chord's length: the wheels' noise, and the gyro's, where the path leaves the chord."""
        along = self.here / float(np.hypot(*self.here))
        left = np.array([-along[1], along[0]])
        # Integral of the squared distance from the chord.
        aside = float(left @ self.second @ left)
        return 0.5 * wheel_noise**2 * self.distance_m + walk**2 * aside + (BIAS_RAD_S * float(along @ self.late)) ** 2


class Fixes:
    """Estimates the radii from rows and fixes. `wheel_scale`: prior deviation of each radius; noise as configured."""

    def __init__(self, wheel_scale: float, walk: float, wheel_noise: float):
        self._known, self._walk, self._wheel_noise = wheel_scale, walk, wheel_noise
        self._way: _Way | None = None
        self._waiting: deque[tuple[int, float, float, float]] = deque(maxlen=MOST_WAITING)
        self._information = self._sum = 0.0
        self._begin_ns = self._named_ns = 0
        self.intervals = 0

    def fix(self, t_ns: int, x_m: float, y_m: float, sigma_m: float) -> None:
        """See Monitor."""
        self._waiting.append((t_ns, x_m, y_m, sigma_m))

    def rows(self, rows: Rows, turn_rad: Array, zero_ns: int) -> None:
        """Add a block, with the likeliest turn of all its rows. A fix counts at the end of its row."""
        inner = rows.inner
        turn, interval_s = turn_rad[inner], rows.interval_s[inner]
        distance, at_ns = 0.5 * (rows.left_m + rows.right_m)[inner], zero_ns + rows.end_s[inner] * NS_PER_S
        if not rows.is_good[inner].all():
            self._way = None  # something moved unseen: the next distance is useless
        begin = 0
        while self._waiting and self._waiting[0][0] <= at_ns[-1]:
            fix = self._waiting.popleft()
            end = int(np.searchsorted(at_ns, fix[0])) + 1
            self._add(turn[begin:end], distance[begin:end], interval_s[begin:end])
            self._measure(*fix)
            begin = max(begin, end)
        self._add(turn[begin:], distance[begin:], interval_s[begin:])

    def _add(self, turn_rad: Array, distance_m: Array, interval_s: Array) -> None:
        if self._way is not None and len(distance_m):
            self._way.add(turn_rad, distance_m, interval_s)

    def _measure(self, t_ns: int, x_m: float, y_m: float, sigma_m: float) -> None:
        way, at = self._way, np.array([x_m, y_m])
        self._way = _Way(at, sigma_m) if math.isfinite(sigma_m) else None
        if self._way is None:
            return
        self._begin_ns = self._begin_ns or t_ns
        if way is None or (chord_m := float(np.hypot(*way.here))) <= FEWEST_M:
            return
        variance = way.variance_m2(self._walk, self._wheel_noise) + way.sigma_m**2 + sigma_m**2
        information, e = chord_m**2 / variance, float(np.hypot(*(at - way.at))) / chord_m - 1.0
        if abs(e) > MOVED_SIGMAS * math.sqrt(1.0 / information + self._known**2 + LARGEST**2):
            return
        self._information += information
        self._sum += information * e
        self.intervals += 1
        self._named_ns = self._named_ns or (t_ns if self._nats() > NAMED_NATS else 0)

    def _nats(self) -> float:
        """Log odds that the radii are off by more than their prior."""
        e, variance = self._sum / self._information, 1.0 / self._information + self._known**2
        wide = variance + LARGEST**2
        return (
            0.5 * e * e * (1.0 / variance - 1.0 / wide)
            - 0.5 * math.log(wide / variance)
            + math.log(HAZARD_PER_S * START_S)
        )

    def findings(self) -> list[Finding]:
        """The finding that both radii are off, if the distances show it."""
        if not self._named_ns or (nats := self._nats()) < 0.0:
            return []
        e, std = self._sum / self._information, self._information**-0.5
        return [
            Finding(
                effect=EFFECT,
                text=f"Both wheels roll {100.0 * e:+.2g} % further than configured, by {self.intervals} distances "
                "between poses that were set.",
                parameters={"left": size(e, std, 1.0, "1"), "right": size(e, std, 1.0, "1")},
                probability=1.0 / (1.0 + math.exp(-min(nats, 300.0))),
                also_fits=(),
                since_ns=self._begin_ns,
                since_std_s=(self._named_ns - self._begin_ns) / NS_PER_S,
                since_m=0.0,
                until_ns=None,
                named_ns=self._named_ns,
                ruled_out=(),
                settle="drive a long straight line between two poses that are known",
            )
        ]

    def not_observable(self) -> list[NotObservable]:
        """The common radius error, until two poses were set."""
        return [] if self.intervals else [NotObservable(EFFECT, "what both radii have in common needs two set_pose")]
