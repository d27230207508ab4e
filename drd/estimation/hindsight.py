"""Earlier values of the constants, to restore where slip, or a stuck gyro, has since taught wrong ones. (18)"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.estimation.filter import Filter
from drd.estimation.state import GYRO_HEADING, GYRO_SCALE, HEADING, SCALE_L, SCALE_R, TREAD, TT, WHEEL_LAG, Matrix, X, Y
from drd.units import NS_PER_S

# Slip is detected some time after it begins: this is as long as agreement takes to end the report of it.
SPAN_NS: Final = 2 * NS_PER_S
TAUGHT: Final = (SCALE_R, SCALE_L, TREAD, GYRO_SCALE, WHEEL_LAG)
TREAD_OF_TAUGHT, LAG_OF_TAUGHT = TAUGHT.index(TREAD), TAUGHT.index(WHEEL_LAG)
POSE: Final = (X, Y, HEADING, GYRO_HEADING)
BLOCK: Final = np.ix_(TAUGHT, TAUGHT)


@dataclass(slots=True)
class Memory:
    """Snapshot of the constants, their part of P, and distances and turn until then."""

    scale_right: float
    scale_left: float
    tread_m: float
    gyro_scale: float
    lag_s: float
    P: Matrix
    left_m: float
    right_m: float
    turn_rad: float
    corrected_x_m: float
    corrected_y_m: float
    corrected_rad: float
    returned_m2: float
    returned_rad2: float

    def corrected(self, kf: Filter) -> tuple[float, float]:
        """Squares of the comparisons' corrections since then, of position, m^2, and heading, rad^2, less the variance
        returned to P since then.
        """
        x_m, y_m = kf.corrected_x_m - self.corrected_x_m, kf.corrected_y_m - self.corrected_y_m
        position_m2 = x_m * x_m + y_m * y_m - (kf.returned_m2 - self.returned_m2)
        heading_rad2 = (kf.corrected_rad - self.corrected_rad) ** 2 - (kf.returned_rad2 - self.returned_rad2)
        return max(position_m2, 0.0), max(heading_rad2, 0.0)

    @property
    def lag_s2(self) -> float:
        """The lag's variance."""
        return float(self.P[LAG_OF_TAUGHT, LAG_OF_TAUGHT])

    @property
    def tread_m2(self) -> float:
        """The tread's variance."""
        return float(self.P[TREAD_OF_TAUGHT, TREAD_OF_TAUGHT])


class Hindsight:
    """Remembers scales, tread and lag as known two to four seconds ago, and sums the distances of moving wheels and
    the gyro's turn since: slip of one wheel is not in the turn. (18)
    """

    def __init__(self) -> None:
        self._then: Memory | None = None
        self._since: Memory | None = None
        self._since_ns = self._given = 0
        self._left_m = self._right_m = self._turn_rad = 0.0

    def moved(self, left_m: float, right_m: float, turn_rad: float) -> None:
        """Add a step that both sensors have seen."""
        self._left_m, self._right_m = self._left_m + left_m, self._right_m + right_m
        self._turn_rad += turn_rad

    def watch(self, kf: Filter, t_ns: int) -> None:
        """Update the memory before a comparison. Constants that were set, not learned, restart it."""
        if kf.given != self._given:
            self.begin(kf, t_ns)
        elif t_ns - self._since_ns > SPAN_NS:
            self._then, self._since, self._since_ns = self._since, self.now(kf), t_ns

    def begin(self, kf: Filter, t_ns: int) -> None:
        """Restart the memory: the past is accounted for."""
        self._then, self._since, self._since_ns, self._given = None, self.now(kf), t_ns, kf.given

    def now(self, kf: Filter) -> Memory:
        """The constants as known now, before anything may teach wrong ones."""
        n = kf.nominal
        constants = n.scale_right, n.scale_left, n.tread_m, n.gyro_scale, n.wheel_lag_s
        corrected = kf.corrected_x_m, kf.corrected_y_m, kf.corrected_rad, kf.returned_m2, kf.returned_rad2
        return Memory(*constants, kf.P[BLOCK], self._left_m, self._right_m, self._turn_rad, *corrected)

    def from_now(self, kf: Filter, then: Memory) -> Memory:
        """The constants as known then, for a pose that is set now: earlier corrections are not in it."""
        return replace(
            self.now(kf),
            scale_right=then.scale_right,
            scale_left=then.scale_left,
            tread_m=then.tread_m,
            gyro_scale=then.gyro_scale,
            lag_s=then.lag_s,
            P=then.P,
        )

    @property
    def before(self) -> Memory | None:
        """The constants as known some seconds ago."""
        return self._then or self._since

    def lag_doubt_s2(self, kf: Filter) -> float:
        """Square of the lag's change since then plus its loss of variance: the comparisons behind both may be wrong."""
        if (then := self.before) is None:
            return 0.0
        change_s, lost_s2 = kf.nominal.wheel_lag_s - then.lag_s, then.lag_s2 - kf.flat_P[TT]
        return change_s * change_s + max(lost_s2, 0.0)

    def corrected(self, kf: Filter) -> tuple[float, float]:
        """The same as `Memory.corrected`, of the constants known some seconds ago."""
        return then.corrected(kf) if (then := self.before) is not None else (0.0, 0.0)

    @property
    def slipped_m(self) -> float:
        """Error of the middle's travel, m, if one wheel is the cause of the difference from the turn since then."""
        return 0.5 * self.apart_m(then) if (then := self.before) is not None else 0.0

    def apart_m(self, then: Memory) -> float:
        """Travel of the right wheel since then, less the left one's and the turn's, m."""
        left_m = (1.0 - then.scale_left) * (self._left_m - then.left_m)
        right_m = (1.0 - then.scale_right) * (self._right_m - then.right_m)
        return right_m - left_m - then.tread_m * (self._turn_rad - then.turn_rad)

    def apart_rad(self, then: Memory) -> float:
        """Angle by which wheels and gyro have turned apart since then, rad."""
        return self.apart_m(then) / then.tread_m

    def take_back(self, kf: Filter, then: Memory | None, t_ns: int) -> None:
        """Restore the constants and their uncertainty as of then: what was learned since is wrong."""
        if then is None:
            return
        n, lag_s, rate = kf.nominal, kf.nominal.wheel_lag_s, kf.rate_rad_s
        n.scale_right, n.scale_left, n.gyro_scale = then.scale_right, then.scale_left, then.gyro_scale
        n.wheel_lag_s = then.lag_s
        n.gyro_heading_rad += rate * (lag_s - then.lag_s)  # as an update does, (30)
        kf.set_tread(then.tread_m)
        # The pose's error due to the gyro's scale stays correlated with it: it is the same in all turns.
        variance = kf.P[GYRO_SCALE, GYRO_SCALE]
        of_scale = {i: kf.P[i, GYRO_SCALE] / variance if variance > 0.0 else 0.0 for i in POSE}
        kf.spread_error(GYRO_SCALE, {i: -share for i, share in of_scale.items()})
        # In the headings, the lag's error as of then replaces the present one.
        if (variance := kf.P[WHEEL_LAG, WHEEL_LAG]) > 0.0:
            kf.spread_error(WHEEL_LAG, {i: -kf.P[i, WHEEL_LAG] / variance for i in (HEADING, GYRO_HEADING)})
        kf.set_covariance(TAUGHT, then.P)
        kf.spread_error(GYRO_SCALE, of_scale)
        kf.spread_error(WHEEL_LAG, dict.fromkeys((HEADING, GYRO_HEADING), -rate))
        self.begin(kf, t_ns)
