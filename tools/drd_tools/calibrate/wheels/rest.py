"""The gyro's noise and bias, from standstills in recordings. (57)"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.batch.logs import FogLog
from drd.units import DEG_PER_RAD, RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H
from drd_tools.calibrate.wheels.covariance import MANY_RECORDINGS
from drd_tools.calibrate.wheels.spread import spread
from drd_tools.recordings.folder import Recording

# A robot stands still if both wheels are slower than this on average over 1 s; a flickering count stays below it.
STILL_M_S: Final = 0.002
# The chassis rocks after a stop, and the wheels may report motion some tenths of a second late.
GUARD_S: Final = 1.0
# Neighbouring samples are correlated over some 0.1 s by the gyro's filter; the bias wanders over minutes.
BLOCK_S: Final = 1.0
# Differences of neighbouring blocks: 30 determine the noise to 16 %.
FEWEST: Final = 30
# Shorter standstills do not determine the bias: with a MEMS gyro of 5 deg/sqrt(h), 5 s leave 0.04 deg/s.
BIAS_S: Final = 5.0
# A spread of biases that is not so many times their noise may be due to noise.
CLEARLY: Final = 2.0


@dataclass(frozen=True)
class Rest:
    """The gyro at rest: total `standstill_s`, and number of `differences` between neighbouring blocks.

    `noise_deg_per_sqrt_h`: angle random walk with its sigma; None if there is too little standstill.
    `bias_deg_s`: rms bias of the recordings, the initial uncertainty of a run without a measured bias; None for
    fewer than four. `repeatability_deg_s`: spread of the bias between recordings; None if noise explains it.
    """

    standstill_s: float
    differences: int
    noise_deg_per_sqrt_h: float | None
    noise_sigma: float
    bias_deg_s: float | None = None
    bias_noise_deg_s: float = math.nan
    repeatability_deg_s: float | None = None


def at_rest(recordings: Sequence[Recording]) -> Rest | None:
    """Estimate noise and bias from the standstills; None if no recording has a gyro."""
    if all(recording.fog is None for recording in recordings):
        return None
    blocks = [_blocks(recording, recording.fog) for recording in recordings if recording.fog is not None]
    steps = np.concatenate([np.diff(still) for each in blocks for still in each] or [np.zeros(0)])
    standstill_s = BLOCK_S * sum(len(still) for each in blocks for still in each)
    if len(steps) < FEWEST:
        return Rest(standstill_s, len(steps), None, math.nan)
    noise = math.sqrt(0.5 * BLOCK_S * float(np.mean(steps**2)))  # rad/sqrt(s)
    # Neighbouring differences share a block: the mean square of n has a relative variance of 3/n.
    noise_deg = noise / RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H
    sigma = 0.5 * math.sqrt(3.0 / len(steps)) * noise_deg
    means = [np.concatenate(each) for each in blocks if each and sum(map(len, each)) * BLOCK_S >= BIAS_S]
    if len(means) < MANY_RECORDINGS:
        return Rest(standstill_s, len(steps), noise_deg, sigma)
    biases = DEG_PER_RAD * np.array([mean.mean() for mean in means])
    own = DEG_PER_RAD * noise / np.sqrt([BLOCK_S * len(mean) for mean in means])
    between = spread(biases, own**2)
    typical = float(np.median(own))
    root_mean_square = math.sqrt(float(np.mean(biases**2)))
    repeats = between if between > CLEARLY * typical else None
    return Rest(standstill_s, len(steps), noise_deg, sigma, root_mean_square, typical, repeats)


def _blocks(recording: Recording, fog: FogLog) -> list[Array]:
    """Block means of the rate, for each standstill of two or more blocks, rad/s."""
    time_s, radius_m = recording.encoders.time_s, recording.nominal.wheel_radius_m
    still = np.ones(len(time_s), bool)
    for angle in recording.wheel_angles_rad():
        before, after = (np.interp(time_s + shift_s, time_s, angle) for shift_s in (-0.5, 0.5))
        still &= radius_m * np.abs(after - before) < STILL_M_S
    edges = np.flatnonzero(np.diff(still, prepend=False, append=False))
    interval_s = float(np.median(np.diff(fog.time_s))) if len(fog.time_s) > 1 else BLOCK_S
    size = max(1, round(BLOCK_S / interval_s))
    found = []
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        inside = (fog.time_s > time_s[first] + GUARD_S) & (fog.time_s <= time_s[end - 1] - GUARD_S)
        count = int(inside.sum()) // size
        if count > 1:
            found.append(fog.rate_rad_s[inside][: count * size].reshape(count, size).mean(axis=1))
    return found
