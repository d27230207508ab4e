"""Ten runs of one robot with one gyro, each estimated in the four configurations of Table II."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.batch.run import run
from drd.batch.samples import FIRST_NS, gyro_samples, wheel_samples
from drd.config.keys import Config
from drd.effects.catalogue import catalogue
from drd.estimation.calibration import Calibration
from drd.estimation.estimator import Estimator
from drd.samples import GyroSample, WheelSample
from drd.units import DEG_PER_RAD, S_PER_NS
from drd_tools.calibrate.gyro.data_sets import data_sets_of_samples
from drd_tools.calibrate.gyro.error_function import fit_error_function
from drd_tools.paper.gyro import SimulatedGyro
from drd_tools.paper.physics import Physics
from drd_tools.simulate.conditions import Conditions, Ground, Random, Reference
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.temperature import warming_c
from drd_tools.simulate.truth import Truth, make_truth

RUNS_EACH_WAY: Final = 5
TRACE_STEP_S: Final = 1.0
CORNER_M: Final = 6.0  # length of a quarter turn
Samples = tuple[list[GyroSample], list[WheelSample]]


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


def path(config: Config, side: str, laps: int = 1) -> Truth:
    """Path of the paper, cw or ccw, after a standstill in which the gyro bias is measured."""
    stand_s = config.estimation.static_bias.duration_s + 1.0
    return make_truth(make_drive(f"square-{side}", stand_s=stand_s, laps=laps), "constant")


def seconds_of(truth: Truth) -> Array:
    """Every second of the drive."""
    return np.arange(0.0, truth.duration_s, TRACE_STEP_S)


class Outcome(NamedTuple):
    """Results of one gyro's runs. Runs are cw first, then ccw; cells in the order of CELLS."""

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
    """Setup common to all gyros."""

    config: Config
    physics: Physics
    ways: tuple[Truth, Truth]  # cw, ccw

    @staticmethod
    def make(config: Config, physics: Physics) -> "Laboratory":
        """Make a laboratory with the paper's path."""
        return Laboratory(config, physics, (path(config, "cw"), path(config, "ccw")))


def run_gyro(
    laboratory: Laboratory, seed: int, runs_each_way: int = RUNS_EACH_WAY, cells: Sequence[Cell] = CELLS
) -> Outcome:
    """Draw a gyro and a robot, calibrate the gyro on the rate table, drive all runs."""
    random = np.random.default_rng([seed, 2001])
    physics = laboratory.physics
    robot = Robot(laboratory.config, physics, random)
    calibration, before, after = calibrate(robot.gyro, physics)
    configs = [configured(laboratory.config, cell) for cell in cells]
    rows: list[list[Run]] = []
    for number in range(2 * runs_each_way):
        truth = laboratory.ways[number >= runs_each_way]
        samples = robot.samples(truth, 1000 * seed + number, number * physics.weather.run_period_s)
        rows.append(
            [
                drive(truth, samples, config, calibration if cell.calibrated else None)
                for cell, config in zip(cells, configs, strict=True)
            ]
        )
    columns: Any = {name: np.array([[getattr(one, name) for one in row] for row in rows]) for name in Run._fields}
    return Outcome(**columns, table_before_deg_s=before, table_after_deg_s=after)


def calibrate(gyro: SimulatedGyro, physics: Physics) -> tuple[Calibration, float, float]:
    """Calibrate on the rate table; also return the rms error of new data sets before and after, deg/s. (2) to (6)"""
    data, new = (data_sets_of_samples(*gyro.on_rate_table(physics.table)) for _ in range(2))
    fitted = fit_error_function(data)
    before, after = (float(np.sqrt(np.mean(e**2))) for e in (new.error_deg_s, fitted.residual_deg_s(new)))
    return fitted.calibration(after, {"source": "simulated rate table"}, before), before, after


def informed(config: Config, physics: Physics) -> Config:
    """Configuration by an engineer who knows the robot's error statistics, but not its actual errors."""
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
    """Daemon's configuration in a cell: with the filter, or with the gyro's heading alone."""
    estimation = dataclasses.replace(config.estimation, heading="filter" if cell.filtered else "gyro")
    return dataclasses.replace(config, estimation=estimation)


class Robot:
    """One robot of the population: its deviations from the configuration, as the simulator's effects and conditions."""

    def __init__(self, config: Config, physics: Physics, random: Random):
        p, known = physics.robot, catalogue()
        self._config, self._weather = config, physics.weather
        self.gyro = SimulatedGyro(physics.gyro, random)
        left, right, tread = random.standard_normal(3).tolist()
        self._effects = [
            (known["wheel_radius_error"], {"left": p.scale_sigma * left, "right": p.scale_sigma * right}),
            (known["tread_error"], {"k": p.tread_sigma * tread}),
            (self.gyro, {}),
            (known["gyro_latency"], {"delay": physics.gyro.delay_s}),
        ]
        # The tread follows the mean of both sides, which wander independently.
        skid = math.sqrt(2.0) * p.skid
        ground = Ground(skid=skid, skid_length_m=p.skid_length_m, bump_per_m=p.bump_per_m, bump_m=p.bump_m)
        self._conditions = Conditions(ground=ground, reference=Reference(is_there=False))
        self._nominal = dataclasses.replace(
            self.gyro.sheet,
            wheel_radius_m=config.robot.wheel_radius_m,
            counts_per_revolution=config.encoders.counts_per_revolution,
            tread_m=config.robot.tread_m,
            encoders_rate_hz=config.encoders.rate_hz,
            slip_noise_m_per_sqrt_m=p.pavement_m_per_sqrt_m,
        )
        self._ambient_c = random.uniform(physics.weather.coldest_c, physics.weather.warmest_c)

    def samples(self, truth: Truth, seed: int, start_s: float = 0.0) -> Samples:
        """Samples for the daemon; the gyro's have the time of their arrival. `start_s`: time since power-on."""
        w = self._weather
        felt_c = warming_c(start_s + truth.middle_s, self._ambient_c, w.self_heating_c, w.self_heating_s)
        truth = dataclasses.replace(truth, temperature_c=felt_c)
        made = simulate(truth, self._nominal, self._effects, self._conditions, seed).recording
        gyro, _ = gyro_samples(made.fog, self._config, FIRST_NS)
        return gyro, wheel_samples(made.encoders, self._config, FIRST_NS)[0]


class Run(NamedTuple):
    """Results of one run in one cell, as in Outcome."""

    return_m: float
    largest_m: float
    heading_deg: float
    path_m: Array
    trace_m: Array
    bound_m: float


def drive(truth: Truth, samples: Samples, config: Config, calibration: Calibration | None) -> Run:
    """Run the daemon's estimator, and compare its poses with the truth."""
    poses = run(Estimator(config, calibration, publish_on="gyro"), *samples)
    t, x, y, heading = np.array([(p.t_ns, p.x_m, p.y_m, p.heading_rad) for p in poses]).T
    t = (t - FIRST_NS) * S_PER_NS
    error = np.hypot(x - np.interp(t, truth.time_s, truth.x_m), y - np.interp(t, truth.time_s, truth.y_m))
    heading_deg = DEG_PER_RAD * float(heading[-1] - truth.heading_rad[-1])
    seconds = seconds_of(truth)
    path_m = np.column_stack([np.interp(seconds, t, v) for v in (x, y)])
    trace_m = np.interp(seconds, t, error)
    return Run(float(error[-1]), float(error.max()), heading_deg, path_m, trace_m, poses[-1].position_bound_m)
