"""The stretch of a recording that is explained: where it begins and ends, and what is kept on the way."""

import math
from array import array
from typing import Final, NamedTuple

import numpy as np

from drd.filter import Matrix, Nominal
from drd.track import Track
from drd.units import NS_PER_S, S_PER_NS
from drd_tools.explain.budget import POSE, Budget
from drd_tools.explain.causes import COUNTS
from drd_tools.explain.parts import Parts

SNAPSHOTS: Final = 1200  # twice as many as are drawn at least
FIRST_INTERVAL_S: Final = 0.1
DELAY_S: Final = 0.01
XY: Final = (0, 1)


class Snapshot(NamedTuple):
    """Time and way since the stretch's beginning, heading, the pose's covariance by cause (causes, 3, 3), the delay's share (3,)."""  # fmt: skip  # noqa: E501

    time_s: float
    way_m: float
    heading_rad: float
    covariance: Matrix
    delay: Matrix


class Stretch:
    """Is told each step of the filter.

    Times are in seconds of the recording, of which 0 is `zero_ns` on the filter's clock. `from_s`: errors count from
    the pose there (None: from the filter's own beginning, with the start's uncertainty). `to_s`: None is the end.
    `keep_s`: rising times whose poses are kept in `budget.parts`.
    """

    def __init__(self, zero_ns: int, from_s: float | None, to_s: float | None, keep_s: tuple[float, ...] = ()):
        self.budget = Budget(Parts() if keep_s else None)
        self.clock: Track | None = None
        self.delay_s = DELAY_S
        self.reading_m2 = 0.0  # of the wheels between two counts
        self.snapshots: list[Snapshot] = []
        self.poses = array("d")  # time_s, x_m, y_m, heading_rad of each step
        self.set_at_s: list[float] = []  # times in the stretch at which a pose was set from outside
        self.done = self.begun = False
        self._zero_ns = zero_ns
        self._from_ns = None if from_s is None else self._ns(from_s)
        self._to_ns = None if to_s is None else self._ns(to_s)
        self._keep_ns = [self._ns(t_s) for t_s in keep_s]
        self._kept = 0
        self._interval_ns, self._next_ns = round(FIRST_INTERVAL_S * NS_PER_S), 0
        self._way_m = 0.0

    def _ns(self, time_s: float) -> int:
        return round(time_s * NS_PER_S) + self._zero_ns

    def table(self) -> Matrix:
        """The filter's poses, shape (n, 4): time_s, x_m, y_m, heading_rad."""
        return np.array(self.poses).reshape(-1, 4)

    def before_step(self, nominal: Nominal) -> None:
        """The step that ended is complete, with its comparison: look at it before the next one begins."""
        assert self.clock is not None
        t_ns = self.clock.t_ns
        time_s = (t_ns - self._zero_ns) * S_PER_NS
        self.poses.extend((time_s, nominal.x_m, nominal.y_m, nominal.heading_rad))
        if self.done:
            return
        if not self.begun and (self._from_ns is None or t_ns >= self._from_ns):
            self.begun, self._way_m = True, 0.0
            if self._from_ns is not None:
                self.budget.rebase()
        if not self.begun:
            return
        while self._kept < len(self._keep_ns) and t_ns >= self._keep_ns[self._kept]:
            self._keep()
        at_end = self._to_ns is not None and t_ns >= self._to_ns
        if t_ns >= self._next_ns or at_end:
            self._next_ns = t_ns + self._interval_ns
            self._snapshot(time_s, nominal)
        self.done = at_end

    def finish(self, nominal: Nominal) -> None:
        """The recording has ended."""
        if self.clock is not None and self.clock.t_ns and not self.done:
            self._next_ns = 0
            self.before_step(nominal)
            if self.begun and self._kept < len(self._keep_ns):  # the last pose comes a little later than the last step
                self._keep()

    def moved(self, dx_m: float, dy_m: float) -> None:
        """The way of one step, without the filter's corrections."""
        self._way_m += math.hypot(dx_m, dy_m)

    def pose_was_set(self) -> None:
        """A pose came from outside."""
        if self.clock is not None and self.begun:
            self.set_at_s.append((self.clock.t_ns - self._zero_ns) * S_PER_NS)

    def _keep(self) -> None:
        assert self.budget.parts is not None
        self.budget.parts.keep()
        self._kept += 1

    def _snapshot(self, time_s: float, nominal: Nominal) -> None:
        covariance = self.budget.P[:, POSE, POSE].copy()
        covariance[COUNTS, XY, XY] += self.reading_m2 * (1.0 if self._from_ns is None else 2.0)  # (26)
        delay = self.budget.delay[POSE].copy()
        self.snapshots.append(Snapshot(time_s, self._way_m, nominal.heading_rad, covariance, delay))
        if len(self.snapshots) > SNAPSHOTS:
            del self.snapshots[1::2]
            self._interval_ns *= 2
