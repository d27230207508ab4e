"""Replay of the neutral recording folder: its rows as the samples that the daemon would have made of them."""

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from drd.config.keys import Config
from drd.config.schema import ConfigError
from drd.effects.compensation import Compensation
from drd.encoders.stream import UNCOUNTED_RESOLUTION_M
from drd.estimation.estimator import Estimator
from drd.estimation.track import MakeTrack, make_track
from drd.fog.stream import OVER_RANGE
from drd.ports.clock import TICK_S
from drd.samples import GyroSample, Pose, WheelSample
from drd.units import NS_PER_S, RAD_PER_DEG, S_PER_NS
from drd.wiring.judge import Geometry, judge
from drd.wiring.table import sentences
from drd_tools.recordings.folder import EncoderLog, FogLog, Recording, file_hash
from drd_tools.replay.memory import no_garbage
from drd_tools.replay.nominal import in_force, with_configured_model
from drd_tools.replay.result import Replayed

Times = npt.NDArray[np.int64]
Array = npt.NDArray[np.float64]
TICK_NS: Final = round(TICK_S * NS_PER_S)
# The first row's time on the estimator's clock, to which 0 means "never".
FIRST_NS: Final = 1000 * NS_PER_S
# A gyro row so many typical intervals after the one before is not the mean over all that time: rows are missing.
MISSING_ROWS: Final = 1.5
# What whole ns in 64 bits hold; and a pause in which every tick gives a pose.
LATEST_S: Final = 4e9
LONGEST_GAP_S: Final = 86_400.0
# A recording whose times begin so near to 0 counts them from a moment of its own, such as the gyro's power-on.
ZERO_WITHIN_S: Final = 60.0


def replay_folder(
    recording: Recording,
    config: Path | None = None,
    calibration: Path | None = None,
    new_track: MakeTrack = make_track,
) -> Replayed:
    """Estimate from a recording folder that was read. Raises ConfigError.

    In force is what robot.yaml stands for, see `nominal`, overruled by what the two files state. `new_track`: see
    Estimator.
    """
    in_use, gyro_calibration = in_force(recording, config, calibration)
    recording = with_configured_model(recording, in_use)
    zero_ns = FIRST_NS - min(int(stamps_ns(time_s[:1], 0)[0]) for time_s in _times(recording))
    wheels_late_ns, gyro_late_ns = _latencies_ns(recording, in_use)
    wheels, began_ns, wheel_counters = wheel_samples(recording.encoders, in_use, zero_ns - wheels_late_ns)
    gyro, gyro_counters = gyro_samples(recording.fog, in_use, zero_ns - gyro_late_ns)
    counted = recording.encoders.left_counts is not None
    resolution_m = max(map(abs, metres_per_count(in_use))) if counted else UNCOUNTED_RESOLUTION_M
    removal = compensation(recording, in_use, zero_ns)
    estimator = Estimator(in_use, gyro_calibration, resolution_m, removal, new_track=new_track)
    poses = run(estimator, gyro, wheels)
    geometry = Geometry(in_use.robot.tread_m, resolution_m, in_use.fog.protocol != "none")
    return Replayed(
        recording.folder,
        poses,
        in_use,
        gyro_calibration,
        zero_ns,
        began_ns,
        {"gyro": len(gyro), "wheels": len(wheels)},
        {"fog": gyro_counters, "encoders": wheel_counters, "estimator": dict(estimator.counters)},
        recording.sha256 | ({str(recording.model): file_hash(recording.model)} if recording.model else {}),
        [*recording.notes, *(sentences(judge(gyro, wheels, geometry)) if poses else [])],
    )


def _latencies_ns(recording: Recording, config: Config) -> tuple[int, int]:
    """How much earlier than its row a sample was taken, of the wheels and of the gyro.

    The samples that the daemon recorded are rid of the latencies that were in force then: what is left is the
    difference.
    """
    before = recording.config
    known_s = (0.0, 0.0) if before is None else (before.encoders.latency_s, before.fog.latency_s)
    late_s = (config.encoders.latency_s - known_s[0], config.fog.latency_s - known_s[1])
    return round(late_s[0] * NS_PER_S), round(late_s[1] * NS_PER_S)


def compensation(recording: Recording, config: Config, zero_ns: int) -> Compensation | None:
    """What takes off the recording's effects. Their time counts from the recording's 0, if it begins near it."""
    if not recording.terms:
        return None
    times_s = _times(recording)
    first_s, last_s = min(time_s[0] for time_s in times_s), max(time_s[-1] for time_s in times_s)
    is_near = abs(first_s) <= ZERO_WITHIN_S
    end_s = float(last_s if is_near else last_s - first_s)
    return Compensation(
        recording.terms, config.robot, config.fog.protocol != "none", zero_ns if is_near else FIRST_NS, end_s
    )


def _times(recording: Recording) -> list[Array]:
    """The times of the logs that are replayed, checked: they are seconds, and they belong together."""
    times = {"encoders.csv": recording.encoders.time_s}
    if recording.fog is not None:
        times["fog.csv"] = recording.fog.time_s
    for name, time_s in times.items():
        where, apart_s = str(recording.folder / name), np.diff(time_s)
        if max(abs(time_s[0]), abs(time_s[-1])) > LATEST_S:
            raise ConfigError(where, "time_s", f"seconds, at most {LATEST_S:g}", f"{time_s[0]:g} to {time_s[-1]:g}")
        if len(apart_s) and apart_s.max() > LONGEST_GAP_S:
            got = f"{apart_s.max():g} s after {time_s[apart_s.argmax()]:.12g}"
            raise ConfigError(where, "time_s", f"rows at most {LONGEST_GAP_S:g} s apart", got)
        wheels = times["encoders.csv"]
        if time_s[0] > wheels[-1] or time_s[-1] < wheels[0]:
            expected = f"times that overlap encoders.csv's, {wheels[0]:.12g} to {wheels[-1]:.12g} s"
            raise ConfigError(where, "time_s", expected, f"{time_s[0]:.12g} to {time_s[-1]:.12g} s")
    return list(times.values())


def stamps_ns(time_s: Array, zero_ns: int) -> Times:
    """Times as whole ns on the estimator's clock, shape (n,)."""
    # Seconds and their fraction apart: the product of 1.7e9 s (an epoch) with 1e9 has no room for ns in a double.
    whole = np.floor(time_s)
    return whole.astype(np.int64) * NS_PER_S + np.round((time_s - whole) * NS_PER_S).astype(np.int64) + zero_ns


def metres_per_count(config: Config) -> tuple[float, float]:
    """Travel of one count of the left and of the right wheel."""
    assert config.encoders.counts_per_revolution is not None
    unit_m = 2.0 * math.pi * config.robot.wheel_radius_m / config.encoders.counts_per_revolution
    return unit_m * config.robot.left_scale, unit_m * config.robot.right_scale


def wheel_samples(log: EncoderLog, config: Config, zero_ns: int) -> tuple[list[WheelSample], int, dict[str, int]]:
    """Samples, the time where the first one begins, and counters.

    Counts: differences of whole numbers, so that no rounding adds up. Speeds hold over the interval that ends with
    their row, as in `Recording.wheel_angles_rad`: a drive shows a value that it measured before, and the daemon's
    trapezoid, half an interval later, would add to that lag. After more than gap_s, or a step faster than
    max_speed_m_s, the row is a new start as in the daemon; the time until then is the next sample's lost_s.
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
    # As the daemon's counters: rows that were written in bunches may carry a whole period's travel each.
    largest_m = robot.max_speed_m_s * np.maximum(step_s, 1.0 / config.encoders.rate_hz)
    jumps = ~gaps & (np.maximum(np.abs(left_m), np.abs(right_m)) > largest_m)
    known = np.flatnonzero(~(gaps | jumps))
    until = np.concatenate([[0.0], np.cumsum(np.where(gaps | jumps, step_s, 0.0))])
    lost_s = np.diff(until[known + 1], prepend=0.0)
    columns = (t_ns[1:][known], step_s[known], left_m[known], right_m[known], lost_s)
    samples = list(map(WheelSample, *(column.tolist() for column in columns)))
    began_ns = int(t_ns[known[0]]) if known.size else int(t_ns[0])
    return samples, began_ns, {"gaps": int(gaps.sum()), "jumps": int(jumps.sum())}


def gyro_samples(log: FogLog | None, config: Config, zero_ns: int) -> tuple[list[GyroSample], dict[str, int]]:
    """Samples and counters; none where there is no gyro in the recording or in the configuration.

    A row is the mean since the row before. After a hole it is the mean over one typical interval, as is the first.
    The range is looked at as in the daemon; its limit on acceleration is not, which is against broken packets.
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


def run(estimator: Estimator, gyro: list[GyroSample], wheels: list[WheelSample]) -> list[Pose]:
    """Feed samples in order of time, and a tick every TICK_S as the daemon does; the poses.

    At the same stamp the gyro's sample comes first, so that the wheels' pose has it, then the wheels', then the tick.
    """
    samples: list[Any] = sorted([*gyro, *wheels], key=_time)  # stable
    poses: list[Pose] = []
    keep, add_gyro, add_wheels, tick = poses.append, estimator.add_gyro, estimator.add_wheels, estimator.tick
    next_ns = samples[0].t_ns if samples else 0
    with no_garbage():
        for sample in tqdm(samples, "replay", unit=" samples", disable=None, leave=False, delay=1.0):
            while next_ns < sample[0]:
                if (pose := tick(next_ns)) is not None:
                    keep(pose)
                next_ns += TICK_NS
            pose = add_gyro(sample) if type(sample) is GyroSample else add_wheels(sample)
            if pose is not None:
                keep(pose)
    return poses


def _time(sample: GyroSample | WheelSample) -> int:
    return sample.t_ns
