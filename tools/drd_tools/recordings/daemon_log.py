"""The daemon's recording as a `Recording`: the samples as its estimator had them, the robot from its configuration.

The nominal robot includes the gyro's calibration, which is applied to the rates here, and the wheels' scales, which
their travel already includes; in a run with a reload both are those of its start. A model in force is not included:
the effects that it corrects are still in the samples.
"""

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Final

import numpy as np

from drd.batch.logs import EncoderLog, FogLog
from drd.config.keys import CalibrationFile, Config, ModelFile
from drd.config.robot import Robot
from drd.config.schema import ConfigError
from drd.encoders import make_layout
from drd.encoders.stream import EncoderStream
from drd.estimation.calibration import Calibration, load_calibration
from drd.recording.in_force import IN_FORCE
from drd.recording.topics import RAW_EVENTS
from drd.samples import GyroSample, Side, WheelSample
from drd.units import NS_PER_S, S_PER_NS
from drd_tools.recordings.configuration import attached_configuration, config_in_force
from drd_tools.recordings.folder import Recording, ReferenceLog, file_hash, read_recording, read_reference_log
from drd_tools.recordings.mcap_file import McapFile, nanoseconds, open_run

GYRO, WHEELS = "/fog", "/wheels"
RELOAD: Final = b'{"event":"reload",'  # as the daemon writes it
# A reference's times beyond this are seconds since 1970, not since the daemon's start.
SINCE_START_S: Final = 1e8
# Counts are whole numbers, except for rounding of travel in metres and interpolated readings.
COUNT_DIGITS: Final = 6


def read(path: Path) -> Recording:
    """Read a recording folder, or a file that the daemon recorded. Raises ConfigError only."""
    return read_daemon_log(path) if path.suffix == ".mcap" and not path.is_dir() else read_recording(path)


def reference_file(file: Path) -> Path:
    """Path of the reference of FILE.mcap: FILE.reference.csv."""
    return file.with_suffix(".reference.csv")


def read_daemon_log(file: Path) -> Recording:
    """Read a recording of `drd run`, with the earlier parts of its run in the same folder. Raises ConfigError.

    Times count from the daemon's start. A reference may be in the same folder (see `reference_file`), with times from
    the daemon's start too, as in the poses of `drd replay`, or in seconds since 1970.
    """
    run = open_run(file)
    with tempfile.TemporaryDirectory() as folder:
        config, base = config_in_force(run.parts[-1], Path(folder))
        calibration = load_calibration(base / config.calibration.file) if config.calibration.file else None
        per_revolution = _counts_per_revolution(config, base)
        gyro, wheels, reloads_ns = _samples(run.parts, _Travel(config, base))
    nominal = _nominal(config, per_revolution)
    beside = reference_file(file)
    reference = _shifted(read_reference_log(beside), run.wall_ns) if beside.exists() else None
    notes = run.notes()
    if reloads_ns:
        times = ", ".join(f"{(t_ns - run.started_ns) * S_PER_NS:.1f}" for t_ns in reloads_ns)
        notes.append(f"a new configuration was put in force at {times} s: robot and travel are those of the first one")
    if config.model.file is not None:
        notes.append("what the model in force took off is found again: the samples are as they were before it")
    return Recording(
        file,
        nominal,
        _wheel_log(wheels, run.started_ns, nominal),
        _gyro_log(gyro, run.started_ns, calibration),
        reference,
        {found.name: file_hash(found) for found in (*(p.path for p in run.parts), *([beside] if reference else []))},
        notes=tuple(notes),
        config=_without_files(config, per_revolution),
    )


class _Travel:
    """Travel of both wheels by the configuration at the run's start, whichever was in force."""

    def __init__(self, config: Config, base: Path):
        self._form, self._metres = self._of(config, base)
        self._factors = (1.0, 1.0)

    @staticmethod
    def _of(config: Config, base: Path) -> tuple[tuple[str, str | None], tuple[float, float]]:
        """Kind of the counters, and the travel of one unit of each."""
        stream = EncoderStream(config.encoders, config.robot, base)
        return (config.encoders.layout, stream.from_file), (stream.metres[Side.LEFT], stream.metres[Side.RIGHT])

    def reload(self, files: Mapping[str, str]) -> None:
        """Put another configuration in force from now on. Raises ConfigError, KeyError."""
        with tempfile.TemporaryDirectory() as folder:
            attached = {name: str(text).encode() for name, text in files.items()}
            config = attached_configuration(attached, Path(folder), f"reload, {IN_FORCE}")
            form, (left_m, right_m) = self._of(config, Path(folder))
        same = form == self._form  # otherwise units differ, and only travel is comparable
        self._factors = (self._metres[0] / left_m, self._metres[1] / right_m) if same else (1.0, 1.0)

    def at_start(self, sample: WheelSample) -> WheelSample:
        """Convert a sample to the configuration at the start."""
        left, right = self._factors
        return sample._replace(left_m=sample.left_m * left, right_m=sample.right_m * right)


def _samples(parts: Sequence[McapFile], travel: _Travel) -> tuple[list[GyroSample], list[WheelSample], list[int]]:
    """Read all samples, and the times of reloads, ns. Raises ConfigError if drd did not write them."""
    gyro: list[GyroSample] = []
    wheels: list[WheelSample] = []
    reloads_ns: list[int] = []
    for part in parts:
        for message in part.messages(GYRO, WHEELS, RAW_EVENTS):
            if message.topic == RAW_EVENTS and not message.data.startswith(RELOAD):
                continue
            try:
                value = message.value()
                t_ns = nanoseconds(value.pop("monotonic_ns"))
                is_good = True
                if message.topic == RAW_EVENTS:
                    travel.reload(dict(value["files"]))
                    reloads_ns.append(t_ns)
                elif message.topic == WHEELS:
                    wheels.append(travel.at_start(WheelSample(t_ns, **value)))
                    is_good = all(map(math.isfinite, wheels[-1]))
                else:
                    celsius = value.pop("temperature_c")  # null: unknown
                    gyro.append(GyroSample(t_ns, **value, temperature_c=math.nan if celsius is None else celsius))
                    is_good = all(map(math.isfinite, gyro[-1][:3]))
            except (KeyError, OverflowError, TypeError, ValueError):
                is_good = False
            if not is_good:
                where = f"{part.path}, {message.topic}, number {message.number}"
                raise ConfigError(where, "", "what drd writes there", repr(message.data[:60]))
    return gyro, wheels, reloads_ns


def _gyro_log(samples: Sequence[GyroSample], zero_ns: int, calibration: Calibration | None) -> FogLog | None:
    """Make rows of rates. A sample over several intervals, an integrated angle after lost lines, gets a row for each,
    since readers assume that a row after a gap covers one interval.
    """
    if not samples:
        return None
    rows: list[tuple[float, float, float]] = []
    usual_s = median(sample.interval_s for sample in samples)
    for sample in samples:
        rate = sample.rate_rad_s if calibration is None else calibration.correct(sample).rate_rad_s
        end_s, intervals = (sample.t_ns - zero_ns) * S_PER_NS, max(1, round(sample.interval_s / usual_s))
        for k in reversed(range(intervals)):
            time_s = end_s - k * sample.interval_s / intervals
            if not rows or time_s > rows[-1][0]:
                rows.append((time_s, rate, sample.temperature_c))
    time_s, rate, temperature_c = np.array(rows).T
    return FogLog(time_s, rate, temperature_c if np.isfinite(temperature_c).any() else None)


def _wheel_log(samples: Sequence[WheelSample], zero_ns: int, robot: Robot) -> EncoderLog | None:
    """Make rows of cumulative counts, or of speeds if there are none; rows after lost travel are marked."""
    rows: list[tuple[float, float, float]] = []
    lost: list[bool] = []
    for s in samples:
        end_s = (s.t_ns - zero_ns) * S_PER_NS
        begin_s = end_s - s.interval_s
        if rows and end_s <= rows[-1][0]:
            continue
        if not rows or (s.lost_s > 0.0 and begin_s > rows[-1][0]):
            lost.append(bool(rows))
            rows.append((begin_s, 0.0, 0.0))
        rows.append((end_s, s.left_m, s.right_m))
        lost.append(False)
    if not rows:
        return None
    time_s, left_m, right_m = np.array(rows).T
    radius_m, per_revolution, is_lost = robot.wheel_radius_m, robot.counts_per_revolution, np.array(lost)
    if per_revolution is None:
        step_s = np.diff(time_s, prepend=time_s[0] - 1.0)
        return EncoderLog(time_s, None, None, left_m / radius_m / step_s, right_m / radius_m / step_s, is_lost)
    count_m = 2.0 * math.pi * radius_m / per_revolution
    left, right = (np.round(np.cumsum(travel) / count_m, COUNT_DIGITS) for travel in (left_m, right_m))
    return EncoderLog(time_s, left, right, None, None, is_lost)


def _shifted(log: ReferenceLog, wall_ns: int) -> ReferenceLog:
    if log.time_s[0] < SINCE_START_S:
        return log
    whole_s, rest_ns = divmod(wall_ns, NS_PER_S)
    return replace(log, time_s=log.time_s - whole_s - rest_ns * S_PER_NS)


def _counts_per_revolution(config: Config, base: Path) -> float | None:
    """Counts per revolution of the layout, which may define its own; None if readings are not counts."""
    layout = make_layout(config.encoders, base)
    if layout.modulus_counts is None or layout.reports_speed:
        return None
    radius_m = config.robot.wheel_radius_m
    return 2.0 * math.pi * radius_m / abs(layout.metres_per_count(radius_m))


def _nominal(config: Config, per_revolution: float | None) -> Robot:
    """Make robot.yaml's content from the configuration: the inverse of `nominal_config`."""
    e, noise = config.estimation, config.estimation.noise
    robot = Robot(
        name=config.robot.name,
        wheel_radius_m=config.robot.wheel_radius_m,
        counts_per_revolution=per_revolution,
        tread_m=config.robot.tread_m,
        gyro_rate_hz=config.fog.rate_hz,
        gyro_range_deg_s=config.fog.full_scale_deg_s,
        gyro_angle_random_walk_deg_per_sqrt_h=noise.gyro_deg_per_sqrt_h,
        gyro_bias_repeatability_deg_s=e.initial.gyro_bias_deg_s,
        gyro_bias_random_walk_deg_per_h_per_sqrt_h=noise.gyro_bias_deg_h_per_sqrt_h,
        encoders_rate_hz=config.encoders.rate_hz,
        slip_noise_m_per_sqrt_m=noise.wheel_m_per_sqrt_m,
        standstill_at_start_s=e.static_bias.duration_s,
    )
    return robot if config.fog.protocol != "none" else robot.without_gyro()


def _without_files(config: Config, per_revolution: float | None) -> Config:
    """The configuration for samples that already include calibration and scales."""
    return replace(
        config,
        robot=replace(config.robot, left_scale=1.0, right_scale=1.0),
        encoders=replace(config.encoders, counts_per_revolution=per_revolution),
        calibration=CalibrationFile(),
        model=ModelFile(),
    )
