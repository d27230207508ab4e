"""Gyro and wheel samples of a drive, with every wiring fault selectable."""

import math
from dataclasses import dataclass, field

import numpy as np

from drd.samples import GyroSample, WheelSample
from drd.units import NS_PER_S
from drd.wiring.judge import Geometry

# Forward speed in m/s, yaw rate in rad/s, seconds.
Legs = tuple[tuple[float, float, float], ...]

STAND: Legs = ((0.0, 0.0, 4.0),)
STRAIGHT: Legs = (*STAND, (0.5, 0.0, 6.0), *STAND)
SPOT: Legs = (*STAND, (0.0, 0.5, 6.0), (0.0, 0.0, 2.0), (0.0, 0.5, 6.0), *STAND)
CIRCLE: Legs = (*STAND, (0.5, 0.4, 20.0), *STAND)
CURVES: Legs = ((0.6, 0.5, 6.0), (0.6, -0.4, 5.0), (0.4, 0.6, 5.0), (0.6, 0.0, 4.0))
TOUR: Legs = (*STRAIGHT, *SPOT, *CURVES)

TREAD_M = 0.6
COUNT_M = 0.0001
STEP_S = 0.01
GEOMETRY = Geometry(TREAD_M, COUNT_M)


@dataclass(frozen=True, kw_only=True)
class Robot:
    """Faults first: factors on each sensor's reading (-1: sign, 0: dead), swapped sides, ratio of effective tread.

    Noise as in a datasheet: bias, deg/s; angle random walk, deg/sqrt(h); each wheel's travel, m/sqrt(m).
    """

    gyro: float = 1.0
    left: float = 1.0
    right: float = 1.0
    swapped: bool = False
    scrub: float = 1.0
    gyro_late_s: float = 0.0
    held: int = 1
    gyro_stuck: bool = False
    bias_deg_s: float = 0.02
    walk_deg_per_sqrt_h: float = 0.083
    slip_m_per_sqrt_m: float = 0.002
    seed: int = 0
    legs: Legs = field(default=TOUR)

    def samples(self) -> tuple[list[GyroSample], list[WheelSample]]:
        """Gyro at 10 Hz, wheels at 20 Hz."""
        random = np.random.default_rng(self.seed)
        speed, rate = (
            np.convolve(np.concatenate([np.full(round(leg[2] / STEP_S), leg[k]) for leg in self.legs]), _box(), "same")
            for k in (0, 1)
        )
        return self._gyro(rate, random), self._wheels(speed, rate, random)

    def _gyro(self, rate: np.ndarray, random: np.random.Generator) -> list[GyroSample]:
        mean = rate[: len(rate) // 10 * 10].reshape(-1, 10).mean(axis=1)
        noise = math.radians(self.walk_deg_per_sqrt_h / 60.0) / math.sqrt(0.1) * random.standard_normal(len(mean))
        said = self.gyro * mean + math.radians(self.bias_deg_s) + noise
        if self.gyro_stuck:
            said[:] = 0.001
        late_ns = round(self.gyro_late_s * NS_PER_S)
        return [GyroSample((k + 1) * 100_000_000 + late_ns, 0.1, float(w), math.nan) for k, w in enumerate(said)]

    def _wheels(self, speed: np.ndarray, rate: np.ndarray, random: np.random.Generator) -> list[WheelSample]:
        ways = []
        for sign, factor in (
            (-1.0, self.right if self.swapped else self.left),
            (1.0, self.left if self.swapped else self.right),
        ):
            step = ((speed + sign * rate * self.scrub * TREAD_M / 2.0) * STEP_S).reshape(-1, 5).sum(axis=1)
            step += self.slip_m_per_sqrt_m * np.sqrt(np.abs(step)) * random.standard_normal(len(step))
            counts = np.round(np.cumsum(factor * step) / COUNT_M)
            counts = counts[np.arange(len(counts)) // self.held * self.held]
            ways.append(np.diff(counts, prepend=0.0) * COUNT_M)
        left, right = reversed(ways) if self.swapped else ways
        return [
            WheelSample((k + 1) * 50_000_000, 0.05, float(left_m), float(right_m), 0.0)
            for k, (left_m, right_m) in enumerate(zip(left, right, strict=True))
        ]


def _box() -> np.ndarray:
    return np.full(60, 1.0 / 60.0)
