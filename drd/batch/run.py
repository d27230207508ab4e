"""Runs samples in order of time through the estimator that the daemon runs."""

import gc
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final, TypeVar

import numpy as np

from drd.batch import left_out
from drd.batch.logs import EncoderLog, FogLog
from drd.batch.samples import FIRST_NS, gyro_samples, resolution_m, wheel_samples, zero_of
from drd.config.keys import Config
from drd.effects.compensation import Compensation
from drd.effects.model import Term
from drd.estimation.calibration import Calibration
from drd.estimation.estimator import Estimator
from drd.estimation.track import MakeTrack, make_track
from drd.ports.clock import TICK_S
from drd.samples import GyroSample, Pose, WheelSample
from drd.units import NS_PER_S
from drd.wiring.judge import Geometry, judge
from drd.wiring.table import sentences

T = TypeVar("T")
TICK_NS: Final = round(TICK_S * NS_PER_S)
# A recording whose times begin this near to 0 counts them from a moment of its own, such as the gyro's power-on.
ZERO_WITHIN_S: Final = 60.0


@dataclass(frozen=True)
class Filtered:
    """The poses of two logs, and how they were made.

    `zero_ns`: the poses' time at which the logs' `time_s` is 0. `began_ns`: where the dead reckoning began, the pose
    there being zero. `samples` and `counters` are by part and name. `notes`: sentences about rows that were left
    out, and about wheels and gyro that contradict each other.
    """

    poses: list[Pose]
    zero_ns: int
    began_ns: int
    samples: dict[str, int]
    counters: dict[str, dict[str, int]]
    notes: list[str]


def filter_logs(
    fog: FogLog | None,
    encoders: EncoderLog,
    config: Config,
    calibration: Calibration | None = None,
    terms: tuple[Term, ...] = (),
    late_ns: tuple[int, int] = (0, 0),
    new_track: MakeTrack = make_track,
    watch: Callable[[list[Any]], Iterable[Any]] = iter,
    zero_s: float | None = None,
) -> Filtered:
    """Estimate from logs whose times were checked, see `check_times`.

    `terms`: the effects to compensate. `late_ns`: how much earlier than its row a sample was taken, for gyro and
    wheels. `new_track`: see Estimator. `watch` passes the samples on, and may show progress. `zero_s`: see
    `compensation`.
    """
    zero_ns = zero_of(fog, encoders)
    wheels, began_ns, wheel_counters = wheel_samples(encoders, config, zero_ns - late_ns[1])
    gyro, gyro_counters = gyro_samples(fog, config, zero_ns - late_ns[0])
    count_m = resolution_m(encoders, config)
    removal = compensation(terms, fog, encoders, config, zero_s)
    publish_on = config.output.publish_on
    estimator = Estimator(config, calibration, count_m, removal, new_track=new_track, publish_on=publish_on)
    poses = run(estimator, gyro, wheels, watch)
    geometry = Geometry(config.robot.tread_m, count_m, config.fog.protocol != "none")
    counters = {"fog": gyro_counters, "encoders": wheel_counters, "estimator": dict(estimator.counters)}
    notes = sentences(judge(gyro, wheels, geometry)) if poses else []
    return Filtered(
        poses,
        zero_ns,
        began_ns,
        {"gyro": len(gyro), "wheels": len(wheels)},
        counters,
        [*left_out.sentences(encoders, config, counters), *notes],
    )


def compensation(
    terms: tuple[Term, ...], fog: FogLog | None, encoders: EncoderLog, config: Config, zero_s: float | None = None
) -> Compensation | None:
    """Make the compensation of the terms for the logs' samples. Their time counts from `zero_s` on the logs' clock,
    see `zero_for_terms`.
    """
    if not terms:
        return None
    logs = [log.time_s for log in (fog, encoders) if log is not None]
    first_s, last_s = min(time_s[0] for time_s in logs), max(time_s[-1] for time_s in logs)
    zero_s = zero_for_terms(float(first_s)) if zero_s is None else zero_s
    # Relative to the first row, so that seconds since 1970 keep their ns.
    begin_ns = FIRST_NS + round((zero_s - float(first_s)) * NS_PER_S)
    return Compensation(terms, config.robot, config.fog.protocol != "none", begin_ns, float(last_s) - zero_s)


def zero_for_terms(first_s: float) -> float:
    """Origin of the terms' time, s, in logs whose first row is at `first_s`: 0 if that is near, else `first_s`."""
    return 0.0 if abs(first_s) <= ZERO_WITHIN_S else first_s


@contextmanager
def no_garbage() -> Iterator[None]:
    """Suspend garbage collection: objects made inside are kept or in no cycle, and scanning them costs time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def run(
    estimator: Estimator,
    gyro: list[GyroSample],
    wheels: list[WheelSample],
    watch: Callable[[list[Any]], Iterable[Any]] = iter,
) -> list[Pose]:
    """Feed samples in order of time, with a tick every TICK_S as in the daemon; returns the poses.

    At the same stamp the gyro's sample comes first, so that the wheels' pose uses it, then the wheels', then the tick.
    """
    samples: list[Any] = sorted([*gyro, *wheels], key=_time)  # stable
    poses: list[Pose] = []
    keep, add_gyro, add_wheels, tick = poses.append, estimator.add_gyro, estimator.add_wheels, estimator.tick
    next_ns = samples[0].t_ns if samples else 0
    with no_garbage():
        for sample in watch(samples):
            while next_ns < sample[0]:
                if (pose := tick(next_ns)) is not None:
                    keep(pose)
                next_ns += TICK_NS
            pose = add_gyro(sample) if type(sample) is GyroSample else add_wheels(sample)
            if pose is not None:
                keep(pose)
    return poses


def latest(poses: list[T], t_ns_of: Callable[[T], int] = attrgetter("t_ns")) -> list[T]:
    """The last of several poses for one time: after a silence the wheels' first sample corrects the one before it."""
    t_ns = np.array([t_ns_of(p) for p in poses], np.int64)
    return [poses[k] for k in np.flatnonzero(np.diff(t_ns, append=np.iinfo(np.int64).max) > 0)]


def _time(sample: GyroSample | WheelSample) -> int:
    return sample.t_ns
