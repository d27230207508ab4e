"""Converts logs to the samples that the daemon would have made."""

import math
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.batch.logs import EncoderLog, FogLog
from drd.config.keys import Config
from drd.config.schema import ConfigError
from drd.encoders.counter import LONGEST_TOLD_S
from drd.encoders.stream import UNCOUNTED_RESOLUTION_M
from drd.fog.stream import OVER_RANGE
from drd.samples import GyroSample, WheelSample
from drd.units import NS_PER_S, RAD_PER_DEG, S_PER_NS

Times = npt.NDArray[np.int64]
# The first row's time on the estimator's clock, to which 0 means "never".
FIRST_NS: Final = 1000 * NS_PER_S
# A gyro row this many typical intervals after the one before is not the mean over that time: rows are missing.
MISSING_ROWS: Final = 1.5
# Whole ns up to here fit into 64 bits; and in a longer pause every tick would give a pose.
LATEST_S: Final = 4e9
LONGEST_GAP_S: Final = 86_400.0
# Between two rows: no robot is dead-reckoned with fewer; rows of less than 100 Hz, in milliseconds, are further apart.
USUAL_GAP_S: Final = 10.0


def check_times(fog: FogLog | None, encoders: EncoderLog, names: tuple[str, str] = ("gyro", "wheels")) -> None:
    """Check that times are in seconds and that the two logs overlap. Raises ConfigError with the log's name."""
    wheels_s = encoders.time_s
    gyro = [] if fog is None else [(names[0], fog.time_s)]
    for name, time_s in [(names[1], wheels_s), *gyro]:
        apart_s = np.diff(time_s)
        if max(abs(time_s[0]), abs(time_s[-1])) > LATEST_S:
            raise ConfigError(name, "time_s", f"seconds, at most {LATEST_S:g}", f"{time_s[0]:g} to {time_s[-1]:g}")
        if len(apart_s) and apart_s.max() > LONGEST_GAP_S:
            got = f"{apart_s.max():g} s after {time_s[apart_s.argmax()]:.12g}"
            raise ConfigError(name, "time_s", f"rows at most {LONGEST_GAP_S:g} s apart", got)
        if len(apart_s) and (usual_s := float(np.median(apart_s))) > USUAL_GAP_S:
            expected = f"seconds, and rows usually at most {USUAL_GAP_S:g} s apart"
            raise ConfigError(name, "time_s", expected, f"rows usually {usual_s:g} apart")
        if time_s[0] > wheels_s[-1] or time_s[-1] < wheels_s[0]:
            expected = f"times that overlap {Path(names[1]).name}'s, {wheels_s[0]:.12g} to {wheels_s[-1]:.12g} s"
            raise ConfigError(name, "time_s", expected, f"{time_s[0]:.12g} to {time_s[-1]:.12g} s")


def zero_of(fog: FogLog | None, encoders: EncoderLog) -> int:
    """The estimator's time, in ns, at which `time_s` is 0: the first row of both logs is at FIRST_NS."""
    firsts_s = [log.time_s[:1] for log in (fog, encoders) if log is not None]
    return FIRST_NS - min(int(stamps_ns(first_s, 0)[0]) for first_s in firsts_s)


def rate_hz(log: FogLog | EncoderLog) -> float:
    """Rows per second of the log."""
    return 1.0 / float(np.median(np.diff(log.time_s))) if len(log.time_s) > 1 else 10.0


def stamps_ns(time_s: Array, zero_ns: int) -> Times:
    """Times as whole ns on the estimator's clock, shape (n,)."""
    # Seconds and their fraction separately: a double cannot hold 1.7e9 s (an epoch) times 1e9 to the ns.
    whole = np.floor(time_s)
    return whole.astype(np.int64) * NS_PER_S + np.round((time_s - whole) * NS_PER_S).astype(np.int64) + zero_ns


def metres_per_count(config: Config) -> tuple[float, float]:
    """Travel of one count of the left and of the right wheel."""
    assert config.encoders.counts_per_revolution is not None
    unit_m = 2.0 * math.pi * config.robot.wheel_radius_m / config.encoders.counts_per_revolution
    return unit_m * config.robot.left_scale, unit_m * config.robot.right_scale


def resolution_m(log: EncoderLog, config: Config) -> float:
    """Wheel travel of one count, the larger of both sides; for a log of speeds, the daemon's value without counts."""
    return UNCOUNTED_RESOLUTION_M if log.left_counts is None else max(map(abs, metres_per_count(config)))


def wheel_samples(log: EncoderLog, config: Config, zero_ns: int) -> tuple[list[WheelSample], int, dict[str, int]]:
    """Samples, the time where the first one begins, and counters.

    Counts: differences of whole numbers, so that no rounding adds up. Speeds hold over the interval that ends with
    their row, as in `Recording.wheel_angles_rad`: a drive reports a value that it measured before, and the daemon's
    trapezoid, half an interval later, would add to that lag. After more than gap_s, or a step faster than
    max_speed_m_s, the row is a new start as in the daemon; the time until then is the next sample's lost_s, and the
    counters' travel in it lost_m.
    """
    t_ns = stamps_ns(log.time_s, zero_ns)
    robot, gap_ns = config.robot, round(config.encoders.gap_s * NS_PER_S)
    step_ns = np.diff(t_ns)
    step_s = step_ns * S_PER_NS
    if log.left_counts is not None and log.right_counts is not None:
        unit = metres_per_count(config)
        left_m, right_m = np.diff(log.left_counts) * unit[0], np.diff(log.right_counts) * unit[1]
    else:
        assert log.left_rad_s is not None
        assert log.right_rad_s is not None
        left_m = log.left_rad_s[1:] * robot.wheel_radius_m * robot.left_scale * step_s
        right_m = log.right_rad_s[1:] * robot.wheel_radius_m * robot.right_scale * step_s
    gaps = step_ns > gap_ns if log.is_lost is None else (step_ns > gap_ns) | log.is_lost[1:]
    # Like the daemon's counters: rows written in bursts may each carry a whole period's travel.
    largest_m = robot.max_speed_m_s * np.maximum(step_s, 1.0 / config.encoders.rate_hz)
    jumps = ~gaps & (np.maximum(np.abs(left_m), np.abs(right_m)) > largest_m)
    told = gaps & (step_s <= LONGEST_TOLD_S) & (np.maximum(np.abs(left_m), np.abs(right_m)) <= largest_m)
    if log.left_counts is None:
        told[:] = False
    if log.is_lost is not None:
        told &= ~log.is_lost[1:]
    known = np.flatnonzero(~(gaps | jumps))
    lost = np.column_stack([step_s, np.where(told, 0.5 * (left_m + right_m), 0.0), ~told]) * (gaps | jumps)[:, None]
    until = np.concatenate([np.zeros((1, 3)), np.cumsum(lost, axis=0)])
    lost_s, lost_m, untold = np.diff(until[known + 1], axis=0, prepend=0.0).T
    columns = (t_ns[1:][known], step_s[known], left_m[known], right_m[known], lost_s, np.where(untold, 0.0, lost_m))
    samples = list(map(WheelSample, *(column.tolist() for column in columns)))
    began_ns = int(t_ns[known[0]]) if known.size else int(t_ns[0])
    return samples, began_ns, {"gaps": int(gaps.sum()), "jumps": int(jumps.sum())}


def gyro_samples(log: FogLog | None, config: Config, zero_ns: int) -> tuple[list[GyroSample], dict[str, int]]:
    """Samples and counters; none without a gyro in the recording or in the configuration.

    A row is the mean since the row before. After a hole it is the mean over one typical interval, as is the first.
    The range is checked as in the daemon; its limit on acceleration, against broken packets, is not applied.
    """
    if log is None or config.fog.protocol == "none":
        return [], {}
    t_ns = stamps_ns(log.time_s, zero_ns)
    step_s = np.diff(t_ns) * S_PER_NS
    typical_s = float(np.median(step_s)) if len(step_s) else 1.0 / config.fog.rate_hz
    step_s = np.concatenate([[typical_s], step_s])
    holes = step_s > MISSING_ROWS * typical_s
    step_s[holes] = typical_s
    good = np.abs(log.rate_rad_s) <= OVER_RANGE * config.fog.full_scale_deg_s * RAD_PER_DEG
    temperature_c = np.full(len(t_ns), math.nan) if log.temperature_c is None else log.temperature_c
    columns = (t_ns[good], step_s[good], log.rate_rad_s[good], temperature_c[good])
    samples = list(map(GyroSample, *(column.tolist() for column in columns)))
    return samples, {"holes": int(holes.sum()), "over_range": int((~good).sum())}
