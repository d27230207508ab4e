"""Sentences on rows of a log that the filter leaves out, and on counters that start again."""

from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.batch.logs import COUNTS, EncoderLog
from drd.config.keys import Config

# A counter that restarts steps by nearly all of its range; this many times its usual step is no motion.
RANGE_PART, USUAL_STEPS = 0.5, 10.0
MANY_ROWS: Final = 10  # fewer do not show the usual step


def sentences(log: EncoderLog, config: Config, counters: dict[str, dict[str, int]]) -> Iterator[str]:
    """Say which rows were left out, by the `counters` of `gyro_samples` and `wheel_samples` by part."""
    fog, encoders = counters["fog"], counters["encoders"]
    known = np.diff(log.time_s) <= config.encoders.gap_s
    if log.is_lost is not None:
        known &= ~log.is_lost[1:]
    for name, counts in zip(COUNTS[1:], (log.left_counts, log.right_counts), strict=True):
        if counts is not None and (again := restarts(np.diff(counts), known)):
            yield (
                f"wheels: {name} steps by more than half of its range (rows: {again}): a counter that starts again has "
                "to be unwrapped before."
            )
    if jumps := encoders["jumps"]:
        yield (
            f"wheels: rows in which one is faster than {config.robot.max_speed_m_s:g} m/s were left out, with their "
            f"travel ({jumps}): wrong counts or units, or a top speed (max_speed_m_s) that is too small."
        )
    if gaps := encoders["gaps"]:
        yield f"wheels: the travel in gaps of more than {config.encoders.gap_s:g} s was left out ({gaps})."
    if beyond := fog.get("over_range", 0):
        yield f"gyro: rows beyond its range of {config.fog.full_scale_deg_s:g} deg/s were left out ({beyond})."


def restarts(steps: Array, known: npt.NDArray[np.bool_]) -> int:
    """Count the `known` (n,) among the `steps` (n,) by which a counter restarts, or jumps as far."""
    size, reading = np.abs(steps), np.cumsum(np.where(known, steps, 0.0))
    moving = size[known & (size > 0.0)]
    if len(moving) < MANY_ROWS:
        return 0
    limit = max(RANGE_PART * float(np.ptp(reading)), USUAL_STEPS * float(np.median(moving)))
    return int((known & (size > limit)).sum())
