"""Noise that is learned while driving: the gyro's at rest, the wheels' from the comparisons."""

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Final

from msgspec import Meta

from drd.estimation.filter import Filter
from drd.estimation.noise import NoiseProfile, skid_steer

# Means over this long include the gyro's slow noise: consecutive samples of MEMS gyros are correlated.
BLOCK_S: Final = 1.0
# Not used at either end of a standstill: the robot rocks after it stops, and moves before late wheels show it.
GUARD_S: Final = 0.5
# Differences of blocks until the noise counts as known: then within 40 %.
KNOWN_AFTER: Final = 3
# Differences of neighbouring means are not independent: n of them are worth two thirds (von Neumann 1941).
FREEDOM: Final = 2.0 / 3.0
# Initial variance of each cause, as on common ground, with a weight in comparisons; and its limit, where the wheels
# tell nothing. Memory is limited to a number of comparisons: a minute of motion.
TRAVEL: Final = (0.005**2, 0.02**2)  # m^2/m: off-road; a skid-steer robot on gravel
TURN: Final = (0.05**2, 0.15**2)  # rad^2/rad: skid-steer; any tread may be effective
JITTER: Final = (0.1**2, 0.2**2)  # s^2: speeds that a drive holds for 0.35 s, for 0.7 s (their length over sqrt(12))
OUTLIER: Final = 9.0  # limit of z^2/S: heavy tails must not dominate the noise
TURNED: Final = 100.0  # times the variance so far; at rest tails are heavier (a motor runs, people climb on)
WAITING: Final = 20  # comparisons until a large drift of the headings would have been found (drift.IN_A_ROW)
FIRST_COUNTS: Final = 10.0  # weight of the initial variance, in comparisons, (31)
RECALLED_COUNTS: Final = 60.0  # weight of what was learned before a restart: the ground may have changed
MEMORY_COUNTS: Final = 600.0  # a minute of motion at 10 Hz


Amount = Annotated[float, Meta(ge=0, le=1e10)]


class Drive(Enum):
    """Kind of steering."""

    UNKNOWN = "unknown"
    DIFFERENTIAL = "differential"
    SKID = "skid"


@dataclass(frozen=True)
class Learned:
    """Knowledge to keep over a restart: how the robot steers, and variances, 0 if not learned; the gyro's is the plain
    mean of squares, without the correction for their small number. (29)
    """

    drive: str = Drive.UNKNOWN.value
    gyro_differences: Amount = 0.0
    gyro_rad2_per_s: Amount = 0.0
    wheel_m2_per_m: Amount = 0.0
    turn_rad2_per_rad: Amount = 0.0
    jitter_s2: Amount = 0.0


class RestNoise:
    """The gyro's angle random walk N from means of its rate over blocks at rest: half the mean square difference of
    neighbouring blocks, as the Allan variance has it. (29)

    `variance_rad2_per_s` is N^2, never below the stated one.
    """

    def __init__(self, stated_rad2_per_s: float, is_learned: bool = True):
        self.is_learned = is_learned
        self.stated_rad2_per_s = self.variance_rad2_per_s = stated_rad2_per_s
        self.differences = 0
        self._sum = self._length_s = 0.0
        self.interrupt()

    @property
    def known(self) -> bool:
        """Whether the standstill was long enough."""
        return self.differences >= KNOWN_AFTER or not self.is_learned

    def recall(self, learned: Learned) -> None:
        """Go on with what was learned before."""
        self.differences = int(learned.gyro_differences)
        self._sum = self.differences * learned.gyro_rad2_per_s
        self._tell()

    @property
    def mean_rad2_per_s(self) -> float:
        """Mean of the squares, to be recalled; 0 before any difference."""
        return self._sum / self.differences if self.differences else 0.0

    @property
    def relative_sigma(self) -> float:
        """Standard deviation of the learned N relative to N; infinite before any difference."""
        return math.sqrt(0.5 / (FREEDOM * self.differences)) if self.differences else math.inf

    def interrupt(self) -> None:
        """Begin new blocks, without the last one: the robot moves, or the gyro is absent."""
        self._still_s = self._block_s = self._block_rad = 0.0
        self._last: float | None = None
        self._waiting: float | None = None

    def add(self, rate_rad_s: float, interval_s: float) -> None:
        """Add a reading at rest; readings are consecutive."""
        self._still_s += interval_s
        if self._still_s <= GUARD_S:
            return
        self._block_s += interval_s
        self._block_rad += rate_rad_s * interval_s
        if self._waiting is not None and self._block_s >= GUARD_S:
            if self._last is not None:
                self._take(self._waiting - self._last)
            self._last, self._waiting = self._waiting, None
        if self._block_s > BLOCK_S - 0.5 * interval_s:
            self._waiting, self._length_s = self._block_rad / self._block_s, self._block_s
            self._block_s = self._block_rad = 0.0

    def _take(self, difference_rad_s: float) -> None:
        square = 0.5 * difference_rad_s * difference_rad_s * self._length_s
        if self.differences and self.is_learned:  # a robot turned by hand is no noise
            square = min(square, TURNED * max(self.mean_rad2_per_s, self.stated_rad2_per_s))
        self._sum += square
        self.differences += 1
        self._tell()

    def _tell(self) -> None:
        if self.is_learned and self.differences:
            # Few differences allow more than their mean: the mean of N^2 given nu degrees of freedom.
            mean = FREEDOM * self._sum / max(FREEDOM * self.differences - 2.0, FREEDOM)
            self.variance_rad2_per_s = max(mean, self.stated_rad2_per_s)


class VarianceFactor:
    """Ratio of the variance of one cause to the stated one, by maximum likelihood from innovations. (31)

    The other causes' share in S is taken as given; memory fades. `factor` is at least 1, and the variance at most
    `largest`; `first`: the initial variance, if larger than the stated one.
    """

    def __init__(self, stated: float, first: float, largest: float):
        self._stated, self._largest = stated, largest
        self.factor = max(1.0, first / stated) if stated else 1.0
        self._weight, self._sum = FIRST_COUNTS, FIRST_COUNTS * self.factor

    @property
    def is_known(self) -> bool:
        """Whether innovations outweigh the initial assumption."""
        return self._weight > 2.0 * FIRST_COUNTS

    def take(self, share: float, z: float, S: float) -> None:
        """Add an innovation with its variance, of which this cause contributes `share` with the present factor."""
        weight = (share / S) ** 2
        self._sum += weight * (min(z * z, OUTLIER * S) - S + share) * self.factor / share
        self._weight += weight
        if self._weight > MEMORY_COUNTS:
            self._sum *= MEMORY_COUNTS / self._weight
            self._weight = MEMORY_COUNTS
        self._limit()

    def state_anew(self, stated: float) -> None:
        """Change the stated variance; the learned one stays if it is not below."""
        if stated:
            self._sum *= self._stated / stated
            self._stated = stated
            self._limit()

    def recall(self, variance: float) -> None:
        """Go on with the variance that was learned before."""
        if self._stated and variance:
            self._weight = RECALLED_COUNTS
            self._sum = RECALLED_COUNTS * variance / self._stated
            self._limit()

    def _limit(self) -> None:
        largest = max(1.0, self._largest / self._stated)
        self.factor = min(max(self._sum / self._weight, 1.0), largest)


class WheelNoise:
    """Noise of the wheels' travel, turning and time, learned from the comparisons, for the filter."""

    def __init__(self, noise: NoiseProfile, is_learned: bool = True, is_known: bool = False):
        """`is_known`: the steering is known, so that the stated noise holds from the start."""
        self.is_learned, self.stated, self._made_of = is_learned, noise, (noise, is_learned, is_known)
        self._waiting: deque[tuple[float, ...]] = deque()
        stated = (noise.wheel_m2_per_m, noise.turn_rad2_per_rad, noise.jitter_s2)
        self.travel, self.turn, self.jitter = (
            VarianceFactor(variance, 0.0 if is_known else first, largest)
            for variance, (first, largest) in zip(stated, (TRAVEL, TURN, JITTER), strict=True)
        )

    def anew(self) -> "WheelNoise":
        """A new instance, before anything was learned."""
        return WheelNoise(*self._made_of)

    @property
    def is_known(self) -> bool:
        """Whether the comparisons outweigh the initial assumption."""
        return self.is_learned and self.turn.is_known

    def put_into(self, noise: NoiseProfile) -> None:
        """Set the learned variances."""
        if not self.is_learned:
            return
        k = self.stated
        noise.wheel_m2_per_m = k.wheel_m2_per_m * self.travel.factor
        noise.turn_rad2_per_rad = k.turn_rad2_per_rad * self.turn.factor
        noise.tread_m2_per_rad = k.tread_m2_per_rad * self.turn.factor
        noise.jitter_s2 = k.jitter_s2 * self.jitter.factor
        noise.lateral_m2_per_m, noise.position_m2_per_rad = k.lateral_m2_per_m, k.position_m2_per_rad

    def recall(self, learned: Learned) -> None:
        """Go on with what was learned before."""
        self.travel.recall(learned.wheel_m2_per_m)
        self.turn.recall(learned.turn_rad2_per_rad)
        self.jitter.recall(learned.jitter_s2)

    def take(self, kf: Filter, is_usual: bool) -> None:
        """Learn from an accepted comparison. One that is not `is_usual` also discards those just before it."""
        if not self.is_learned:
            return
        added = kf.process_noise
        if is_usual:
            self._waiting.append((added.distance_rad2, added.turn_rad2, added.jitter_rad2, kf.z, kf.S))
        else:
            self._waiting.clear()
        added.distance_rad2 = added.turn_rad2 = added.jitter_rad2 = 0.0
        if len(self._waiting) < WAITING:
            return
        *shares, z, S = self._waiting.popleft()
        for cause, share in zip((self.travel, self.turn, self.jitter), shares, strict=True):
            if share:
                cause.take(share, z, S)
        self.put_into(kf.noise)

    def skids(self, tread_m: float) -> None:
        """Raise the stated noise to that of wheels that slip sideways in each turn."""
        self.stated = skid_steer(self.stated, tread_m)
        self.travel.state_anew(self.stated.wheel_m2_per_m)
        self.turn.state_anew(self.stated.turn_rad2_per_rad)
