"""Beside Table II: the filter's variances, a delay that the return position hides, and other robots."""

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.config.keys import Config
from drd.estimation.estimator import Estimator
from drd.estimation.filter import Sigmas, X, Y
from drd.estimation.noise import NoiseProfile
from drd.estimation.track import Track, make_track
from drd.samples import GyroSample, WheelSample
from drd_tools.emulate.drive import square_drive
from drd_tools.paper.gyro import SimulatedGyro
from drd_tools.paper.physics import Gyro, Robot, Weather
from drd_tools.paper.runs import (
    CELLS,
    Climate,
    Laboratory,
    SkidSteer,
    Way,
    calibrate,
    configured,
    drive,
    fed,
    sensor_samples,
    told,
)

Array = npt.NDArray[np.float64]

STATES: Final = ("x", "y", "heading", "right scale", "left scale", "tread", "gyro heading", "gyro scale", "gyro bias")
EVERY_NS: Final = 1_000_000_000
NOTHING_RAD2: Final = 1e9  # a variance beside which every other is nothing


def sigmas_over_laps(laboratory: Laboratory, laps: int = 3, seed: int = 0) -> tuple[Array, Array]:
    """Time in s, shape (n,), and the nine states' standard deviations, shape (n, 9), without calibration."""
    random = np.random.default_rng([seed, 2002])
    physics, config = laboratory.physics, laboratory.config
    gyro, wheels = SimulatedGyro(physics.gyro, random), SkidSteer(config, physics.robot, random)
    way = Way.of(square_drive(stand_s=config.estimation.static_bias.duration_s + 1.0, laps=laps))
    estimator = Estimator(config, publish_on="gyro")
    samples = list(sensor_samples(way, gyro, wheels, Climate(physics.weather, random), 0.0, physics.gyro.delay_s))
    rows, next_ns = [], samples[0].t_ns
    for sample, _ in fed(estimator, samples):
        if sample.t_ns >= next_ns:
            next_ns += EVERY_NS
            rows.append([(sample.t_ns - samples[0].t_ns) / EVERY_NS, *np.sqrt(np.diag(estimator.filter.P))])
    table = np.array(rows)
    return table[:, 0], table[:, 1 : 1 + len(STATES)]  # the paper has no lag and no sideways slip


def sigmas_with_and_without_comparing(laboratory: Laboratory, gyros: int = 4) -> Array:
    """Standard deviation of the return position, m, by the filter's own covariance, for calibrated gyros, (gyros, 2):
    with the wheels' turning, and without. No estimator that is told the truth gains more by it.
    """
    rows = []
    for seed in range(gyros):
        random = np.random.default_rng([seed, 2004])
        physics, config, way = laboratory.physics, laboratory.config, laboratory.ways[seed % 2]
        gyro, wheels = SimulatedGyro(physics.gyro, random), SkidSteer(config, physics.robot, random)
        calibration = calibrate(gyro, physics)[0]
        weather = Climate(physics.weather, random)
        samples = list(sensor_samples(way, gyro, wheels, weather, 0.0, physics.gyro.delay_s))
        tracks = (make_track, _deaf)
        estimators = (Estimator(config, calibration, new_track=track, publish_on="gyro") for track in tracks)
        rows.append([_return_sigma_m(estimator, samples) for estimator in estimators])
    return np.array(rows)


def _deaf(config: Config, sigmas: Sigmas, noise: NoiseProfile) -> Track:
    """A track to which no comparison of the headings says anything."""
    return make_track(config, sigmas, dataclasses.replace(noise, comparison_rad2=NOTHING_RAD2))


def _return_sigma_m(estimator: Estimator, samples: list[GyroSample | WheelSample]) -> float:
    for _ in fed(estimator, samples):
        pass
    P = estimator.filter.P
    return math.sqrt(P[X, X] + P[Y, Y])


def delay_alone(laboratory: Laboratory, delays_s: tuple[float, ...] = (0.0, 0.05, 0.1)) -> list[tuple[float, ...]]:
    """Perfect sensors, but a gyro that is late: rows of delay in s, return error and largest error on the way in m."""
    perfect = dataclasses.replace(
        laboratory.physics,
        gyro=Gyro(
            nonlinearity=0.0,
            scale_over_temperature=0.0,
            bias_over_temperature_deg_s=0.0,
            bias_stability_deg_s=0.0,
            walk_deg_per_sqrt_h=0.0,
        ),
        weather=Weather(self_heating_c=0.0),
        robot=Robot(scale_sigma=0.0, tread_sigma=0.0, skid=0.0, pavement_m_per_sqrt_m=0.0, bump_per_m=0.0, bump_m=0.0),
    )
    random = np.random.default_rng(0)
    gyro_alone = configured(laboratory.config, CELLS[0])
    rows: list[tuple[float, ...]] = []
    for delay_s in delays_s:
        gyro, wheels = SimulatedGyro(perfect.gyro, random), SkidSteer(gyro_alone, perfect.robot, random)
        samples = list(sensor_samples(laboratory.ways[1], gyro, wheels, Climate(perfect.weather, random), 0.0, delay_s))
        run = drive(laboratory.ways[1], samples, gyro_alone, None)
        rows.append((delay_s, run.return_m, run.largest_m))
    return rows


def other_robot(laboratory: Laboratory, changes: dict[str, float]) -> Laboratory:
    """The same path with another robot, and a configuration that knows how good that one is."""
    physics = dataclasses.replace(laboratory.physics, robot=dataclasses.replace(laboratory.physics.robot, **changes))
    return Laboratory(told(laboratory.config, physics), physics, laboratory.ways)
