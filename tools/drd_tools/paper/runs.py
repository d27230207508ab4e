"""Ten runs of one robot with one gyro, each estimated in the four configurations of Table II."""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.config.keys import Config
from drd.estimation.calibration import Calibration
from drd.estimation.estimator import Estimator
from drd.samples import GyroSample, Pose, WheelSample
from drd.units import DEG_PER_RAD, NS_PER_S, RAD_PER_DEG
from drd_tools.calibrate.gyro.error_function import data_sets_of_samples, fit_error_function
from drd_tools.emulate.drive import Drive, square_drive
from drd_tools.paper.gyro import SimulatedGyro, correlated_along
from drd_tools.paper.physics import Physics, Robot, Weather

Array = npt.NDArray[np.float64]
Random = np.random.Generator

RUNS_EACH_WAY: Final = 5
WHEEL_STEP_S: Final = 0.05
WHEEL_STEPS_PER_GYRO_STEP: Final = 2
GYRO_STEP_S: Final = WHEEL_STEP_S * WHEEL_STEPS_PER_GYRO_STEP
TRACE_STEP_S: Final = 1.0
CORNER_M: Final = 6.0  # way of a quarter turn
START_NS: Final = 1000 * NS_PER_S


class Cell(NamedTuple):
    """A column of Table II."""

    name: str
    calibrated: bool
    filtered: bool


CELLS: Final = (
    Cell("neither", False, False),
    Cell("filter", False, True),
    Cell("calibration", True, False),
    Cell("both", True, True),
)


class Way(NamedTuple):
    """The true drive, sampled where the encoders are: arrays of shape (n + 1,) from the start on."""

    time_s: Array
    x_m: Array
    y_m: Array
    heading_rad: Array
    travel_m: Array

    @staticmethod
    def of(drive: Drive) -> "Way":
        """The whole drive."""
        index = np.arange(0, len(drive.table), round(WHEEL_STEP_S * 1000))
        x, y, heading, _, _, travel = drive.table[index].T
        return Way(np.asarray(WHEEL_STEP_S * np.arange(len(index))), x, y, heading, travel)

    def seconds(self) -> Array:
        """Every second of the drive."""
        return np.arange(0.0, self.time_s[-1], TRACE_STEP_S)


class Outcome(NamedTuple):
    """What one gyro's runs gave. Runs are cw first, then ccw; cells in the order of CELLS."""

    return_m: Array  # (runs, cells): distance from the start after the return
    largest_m: Array  # (runs, cells): largest position error on the way
    heading_deg: Array  # (runs, cells): heading error at the return
    path_m: Array  # (runs, cells, seconds, 2): estimated x, y at every second
    trace_m: Array  # (runs, cells, seconds): position error then
    bound_m: Array  # (runs, cells): the claimed 99 % bound at the return
    table_before_deg_s: float  # rms of the gyro's error on new data sets, before and after calibration
    table_after_deg_s: float


@dataclasses.dataclass(frozen=True)
class Laboratory:
    """What does not change from gyro to gyro."""

    config: Config
    physics: Physics
    ways: tuple[Way, Way]  # cw, ccw

    @staticmethod
    def make(config: Config, physics: Physics) -> "Laboratory":
        """With the paper's path."""
        stand_s = config.estimation.static_bias.duration_s + 1.0
        cw, ccw = (Way.of(square_drive(corner_m=CORNER_M, clockwise=cw, stand_s=stand_s)) for cw in (True, False))
        return Laboratory(config, physics, (cw, ccw))


def run_gyro(
    laboratory: Laboratory, seed: int, runs_each_way: int = RUNS_EACH_WAY, cells: Sequence[Cell] = CELLS
) -> Outcome:
    """Draw a gyro and a robot, calibrate the gyro on the rate table, drive all runs."""
    random = np.random.default_rng([seed, 2001])
    physics = laboratory.physics
    gyro = SimulatedGyro(physics.gyro, random)
    calibration, before, after = calibrate(gyro, physics)
    wheels = SkidSteer(laboratory.config, physics.robot, random)
    weather = Climate(physics.weather, random)
    configs = [configured(laboratory.config, cell) for cell in cells]
    rows: list[list[Run]] = []
    for run in range(2 * runs_each_way):
        way = laboratory.ways[run >= runs_each_way]
        start_s = run * physics.weather.run_period_s
        samples = list(sensor_samples(way, gyro, wheels, weather, start_s, physics.gyro.delay_s))
        rows.append(
            [
                drive(way, samples, config, calibration if cell.calibrated else None)
                for cell, config in zip(cells, configs, strict=True)
            ]
        )
    columns: Any = {name: np.array([[getattr(run, name) for run in row] for row in rows]) for name in Run._fields}
    return Outcome(**columns, table_before_deg_s=before, table_after_deg_s=after)


def calibrate(gyro: SimulatedGyro, physics: Physics) -> tuple[Calibration, float, float]:
    """The rate-table calibration, and the rms error of new data sets before and after it, deg/s. (2) to (6)"""
    data, new = (data_sets_of_samples(*gyro.on_rate_table(physics.table)) for _ in range(2))
    fitted = fit_error_function(data)
    before, after = (float(np.sqrt(np.mean(e**2))) for e in (new.error_deg_s, fitted.residual_deg_s(new)))
    return fitted.calibration(after, {"source": "simulated rate table"}, before), before, after


def told(config: Config, physics: Physics) -> Config:
    """The configuration of an engineer who knows how good the robot is, though not which errors it has."""
    robot, gyro = physics.robot, physics.gyro
    noise = dataclasses.replace(
        config.estimation.noise,
        wheel_m_per_sqrt_m=math.sqrt(robot.pavement_m_per_sqrt_m**2 + 2.0 * robot.bump_per_m * robot.bump_m**2),
        turn_rad_per_sqrt_rad=robot.skid * math.sqrt(2.0 * robot.skid_length_m * 0.5 * math.pi / CORNER_M),
        tread_per_sqrt_rad=0.0005,
        gyro_deg_per_sqrt_h=gyro.walk_deg_per_sqrt_h,
    )
    initial = dataclasses.replace(
        config.estimation.initial,
        tread=robot.tread_sigma,
        wheel_scale=math.hypot(robot.scale_sigma, robot.bump_per_m * robot.bump_m),
        gyro_scale=math.hypot(gyro.nonlinearity, 0.25 * gyro.scale_over_temperature / 2),
    )
    estimation = dataclasses.replace(config.estimation, noise=noise, initial=initial)
    return dataclasses.replace(config, estimation=estimation)


def configured(config: Config, cell: Cell) -> Config:
    """The daemon's configuration in a cell: with the filter, or with the gyro's heading alone."""
    estimation = dataclasses.replace(config.estimation, heading="filter" if cell.filtered else "gyro")
    return dataclasses.replace(config, estimation=estimation)


class Climate:
    """The gyro's temperature."""

    def __init__(self, weather: Weather, random: Random):
        self._weather = weather
        self._ambient_c = random.uniform(weather.coldest_c, weather.warmest_c)

    def temperature_c(self, time_s: Array) -> Array:
        """At times since the gyro was switched on."""
        w = self._weather
        return np.asarray(self._ambient_c + w.self_heating_c * (1.0 - np.exp(-time_s / w.self_heating_s)))


class SkidSteer:
    """The robot's encoders, read through the sizes that the configuration believes."""

    def __init__(self, config: Config, physics: Robot, random: Random):
        self._physics, self._random = physics, random
        self._tread_m = config.robot.tread_m * (1.0 + physics.tread_sigma * random.standard_normal())
        self._scales = 1.0 + physics.scale_sigma * random.standard_normal(2)
        self._count_m = 2.0 * math.pi * config.robot.wheel_radius_m / (config.encoders.counts_per_revolution or 4096.0)

    def read(self, way: Way) -> tuple[Array, Array]:
        """Left and right increments of a drive, m, each of shape (n,)."""
        p, random = self._physics, self._random
        along, turn = np.diff(way.travel_m), np.diff(way.heading_rad)
        grip = 1.0 + p.skid * correlated_along(along / p.skid_length_m, random)
        side = 0.5 * self._tread_m * grip * turn
        left, right = (
            self._counted(travel, s) for travel, s in zip((along - side, along + side), self._scales, strict=True)
        )
        return left, right

    def _counted(self, travel_m: Array, scale: float) -> Array:
        """Increments of one side's counter: with pavement and bumps, in whole counts."""
        p, random, way = self._physics, self._random, np.abs(travel_m)
        noise = p.pavement_m_per_sqrt_m * np.sqrt(way) * random.standard_normal(len(way))
        bumps = p.bump_m * random.poisson(p.bump_per_m * way)
        counts = np.floor(np.cumsum(scale * travel_m + noise + bumps) / self._count_m)
        return self._count_m * np.diff(counts, prepend=0.0)


def sensor_samples(
    way: Way, gyro: SimulatedGyro, wheels: SkidSteer, weather: Climate, start_s: float, delay_s: float
) -> Iterator[GyroSample | WheelSample]:
    """What the daemon gets, in the order of arrival. The gyro's samples bear the time of their arrival."""
    left, right = wheels.read(way)
    heading = way.heading_rad[::WHEEL_STEPS_PER_GYRO_STEP]
    ends = way.time_s[::WHEEL_STEPS_PER_GYRO_STEP][1:]
    true = np.diff(heading) / GYRO_STEP_S * DEG_PER_RAD
    rate, temperature = gyro.read(true, weather.temperature_c(start_s + ends), GYRO_STEP_S)
    wheel_ns = START_NS + np.round(way.time_s[1:] * NS_PER_S).astype(np.int64)
    gyro_ns = START_NS + np.round((ends + delay_s) * NS_PER_S).astype(np.int64)
    arriving: list[GyroSample | WheelSample] = [
        WheelSample(*row, 0.0)
        for row in zip(wheel_ns.tolist(), [WHEEL_STEP_S] * len(left), left.tolist(), right.tolist(), strict=True)
    ]
    arriving += [
        GyroSample(*row)
        for row in zip(
            gyro_ns.tolist(),
            [GYRO_STEP_S] * len(rate),
            (RAD_PER_DEG * rate).tolist(),
            temperature.tolist(),
            strict=True,
        )
    ]
    return iter(sorted(arriving, key=lambda sample: sample.t_ns))


class Run(NamedTuple):
    """What came of one run in one cell, as in Outcome."""

    return_m: float
    largest_m: float
    heading_deg: float
    path_m: Array
    trace_m: Array
    bound_m: float


def fed(
    estimator: Estimator, samples: Iterable[GyroSample | WheelSample]
) -> Iterator[tuple[GyroSample | WheelSample, Pose | None]]:
    """Feed the samples one after the other: each with the pose that it gave."""
    for sample in samples:
        yield sample, estimator.add_gyro(sample) if isinstance(sample, GyroSample) else estimator.add_wheels(sample)


def drive(way: Way, samples: list[GyroSample | WheelSample], config: Config, calibration: Calibration | None) -> Run:
    """Feed the daemon's estimator, compare its poses with the truth."""
    estimator = Estimator(config, calibration, publish_on="gyro")
    poses = [pose for _, pose in fed(estimator, samples) if pose is not None]
    t, x, y, heading = np.array([(p.t_ns, p.x_m, p.y_m, p.heading_rad) for p in poses]).T
    t = (t - START_NS) / NS_PER_S
    error = np.hypot(x - np.interp(t, way.time_s, way.x_m), y - np.interp(t, way.time_s, way.y_m))
    heading_deg = DEG_PER_RAD * float(heading[-1] - way.heading_rad[-1])
    seconds = way.seconds()
    path = np.column_stack([np.interp(seconds, t, v) for v in (x, y)])
    trace = np.interp(seconds, t, error)
    return Run(float(error[-1]), float(error.max()), heading_deg, path, trace, poses[-1].position_bound_m)
