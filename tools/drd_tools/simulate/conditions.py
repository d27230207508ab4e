"""Conditions of a run apart from the robot: ground, noise relative to the datasheets, and the reference."""

import math
import zlib
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np

from drd.arrays import Array
from drd.config.schema import ConfigError

Random = np.random.Generator


def stream(seed: int, source: str) -> Random:
    """Random numbers of one source, independent of whether and how others are used."""
    return np.random.default_rng([seed, zlib.crc32(source.encode())])


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Effect of the ground on a skid-steer robot; the slip noise of robot.yaml is not part of it.

    `skid`: standard deviation of each side's instantaneous centre of rotation (1: its distance from the middle), with
    a correlation length of `skid_length_m` of wheel travel; effective tread and forward gain vary with it. `centre_m`:
    standard deviation of the centre lengthwise, which makes the body slide sideways as it turns. Bumps add travel to
    each wheel: `bump_per_m` of exponentially distributed size with the mean `bump_m`.
    """

    skid: float = 0.0
    skid_length_m: float = 0.5
    centre_m: float = 0.0
    bump_per_m: float = 0.0
    bump_m: float = 0.0


GROUNDS: Final = {
    "even": Ground(),
    "asphalt": Ground(skid=0.02, centre_m=0.01, bump_per_m=0.5, bump_m=0.0005),
    "grass": Ground(skid=0.08, skid_length_m=1.0, centre_m=0.03, bump_per_m=1.0, bump_m=0.002),
}


@dataclass(frozen=True, kw_only=True)
class Reference:
    """The reference: poses every `period_s`, or None: at the two ends only. `is_there` False: none.

    Its poses are `latency_s` old, of a point at `lever_m` (forward, left) from the robot's centre.
    """

    is_there: bool = True
    period_s: float | None = 0.1
    latency_s: float = 0.0
    lever_m: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read full, sparse:SECONDS, ends or none. Raises ConfigError."""
        name, _, number = text.partition(":")
        try:
            period_s = float(number) if name == "sparse" else 0.1
        except ValueError:
            period_s = math.nan
        if name in ("full", "sparse", "ends", "none") and (name == "sparse" or not number) and 0.01 <= period_s <= 1e6:
            return cls(is_there=name != "none", period_s=None if name == "ends" else period_s)
        raise ConfigError("--reference", "", "full, sparse:SECONDS (0.01 to 1e6), ends or none", repr(text))


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Conditions: `*_noise` are factors on robot.yaml's datasheets, including the gyro's bias. `tails`: degrees of
    freedom of Student's t, scaled to the datasheet; inf: Gaussian, otherwise more than 2. `jitter_s`: scatter of the
    stamps. `quantise`: round the gyro's rate and temperature to their resolution (counts are always whole).
    """

    gyro_noise: float = 1.0
    wheel_noise: float = 1.0
    reference_noise: float = 1.0
    tails: float = math.inf
    jitter_s: float = 0.0
    quantise: bool = True
    reference: Reference = field(default_factory=Reference)
    ground: Ground = field(default_factory=Ground)

    def stressed(self, seed: int) -> "Conditions":
        """Worsen the conditions without adding an effect: noise up to 30 % off the datasheets, heavy tails, a
        reference up to 10 ms late and up to 5 cm off the centre.
        """
        random = stream(seed, "stress")
        gyro, wheels, reference = random.uniform(0.7, 1.3, 3).tolist()
        lever_m = tuple(random.uniform(-0.05, 0.05, 2).tolist())
        late = replace(self.reference, latency_s=float(random.uniform(0.0, 0.01)), lever_m=lever_m)
        return replace(self, gyro_noise=gyro, wheel_noise=wheels, reference_noise=reference, tails=4.0, reference=late)


PERFECT: Final = Conditions(gyro_noise=0.0, wheel_noise=0.0, reference_noise=0.0, quantise=False)


def scatter(n: int, random: Random, tails: float) -> Array:
    """Draw independent numbers of unit variance, shape (n,)."""
    if math.isinf(tails):
        return random.standard_normal(n)
    return random.standard_t(tails, n) * math.sqrt((tails - 2.0) / tails)


def wandering(distance_m: Array, length_m: float, random: Random) -> Array:
    """Draw a stationary Gauss-Markov sequence of unit variance along a non-decreasing travel, shape (n,)."""
    from scipy.signal import lfilter  # noqa: PLC0415  # takes half a second, and most ground is even

    spacing = 0.05  # in correlation lengths; linear interpolation in between
    points = math.ceil(float(distance_m[-1]) / (spacing * length_m)) + 2
    keep = math.exp(-spacing)
    drive = random.standard_normal(points) * math.sqrt(1.0 - keep * keep)
    drive[0] /= math.sqrt(1.0 - keep * keep)
    values = lfilter([1.0], [1.0, -keep], drive)
    return np.asarray(np.interp(distance_m, spacing * length_m * np.arange(points), values))
