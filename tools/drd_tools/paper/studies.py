"""Further studies: the filter's variances, a delay that the return position hides, and other robots."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from drd.arrays import Array
from drd.batch.run import run
from drd.config.keys import Config
from drd.estimation.estimator import Estimator
from drd.estimation.noise import NoiseProfile
from drd.estimation.state import Sigmas, X, Y
from drd.estimation.track import Track, make_track
from drd_tools.paper import physics as p
from drd_tools.paper.runs import CELLS, Laboratory, Robot, Samples, calibrate, configured, drive, informed, path

STATES: Final = ("x", "y", "heading", "right scale", "left scale", "tread", "gyro heading", "gyro scale", "gyro bias")
LAPS, GYROS = 3, 4
EVERY_NS: Final = 1_000_000_000
NOTHING_RAD2: Final = 1e9  # a variance compared with which all others are negligible


def sigmas_over_laps(laboratory: Laboratory) -> tuple[Array, Array]:
    """Time in s, shape (n,), and the nine states' standard deviations, shape (n, 9), without calibration."""
    robot = Robot(laboratory.config, laboratory.physics, np.random.default_rng([0, 2002]))
    estimator, rows = Estimator(laboratory.config, publish_on="gyro"), []

    def watched(samples: list[Any]) -> Iterator[Any]:
        next_ns = samples[0].t_ns
        for sample in samples:
            yield sample
            if sample.t_ns >= next_ns:
                next_ns += EVERY_NS
                rows.append([(sample.t_ns - samples[0].t_ns) / EVERY_NS, *np.sqrt(np.diag(estimator.filter.P))])

    run(estimator, *robot.samples(path(laboratory.config, "ccw", LAPS), 0), watched)
    table = np.array(rows)
    return table[:, 0], table[:, 1 : 1 + len(STATES)]  # the paper has no lag and no sideways slip


def sigmas_with_and_without_comparing(laboratory: Laboratory) -> Array:
    """Standard deviation of the return position, m, by the filter's own covariance, for calibrated gyros, (GYROS, 2):
    with the turn of the wheels and without. No estimator that knows the true noise can gain more from it.
    """
    rows = []
    for seed in range(GYROS):
        config, random = laboratory.config, np.random.default_rng([seed, 2004])
        robot = Robot(config, laboratory.physics, random)
        calibration = calibrate(robot.gyro, laboratory.physics)[0]
        samples = robot.samples(laboratory.ways[seed % 2], seed)
        tracks = (make_track, _deaf)
        estimators = (Estimator(config, calibration, new_track=track, publish_on="gyro") for track in tracks)
        rows.append([_return_sigma_m(estimator, samples) for estimator in estimators])
    return np.array(rows)


def _deaf(config: Config, sigmas: Sigmas, noise: NoiseProfile) -> Track:
    """Make a track on which comparisons of the headings have no influence."""
    return make_track(config, sigmas, dataclasses.replace(noise, comparison_rad2=NOTHING_RAD2))


def _return_sigma_m(estimator: Estimator, samples: Samples) -> float:
    run(estimator, *samples)
    P = estimator.filter.P
    return math.sqrt(P[X, X] + P[Y, Y])


def delay_alone(laboratory: Laboratory, delays_s: tuple[float, ...] = (0.0, 0.05, 0.1)) -> list[tuple[float, ...]]:
    """Drive with perfect sensors, but a late gyro: rows of delay in s, return error and largest error in m."""
    perfect = dataclasses.replace(
        laboratory.physics,
        gyro=p.Gyro(
            nonlinearity=0.0,
            scale_over_temperature=0.0,
            bias_over_temperature_deg_s=0.0,
            bias_stability_deg_s=0.0,
            walk_deg_per_sqrt_h=0.0,
        ),
        weather=p.Weather(self_heating_c=0.0),
        robot=p.Robot(
            scale_sigma=0.0, tread_sigma=0.0, skid=0.0, pavement_m_per_sqrt_m=0.0, bump_per_m=0.0, bump_m=0.0
        ),
    )
    gyro_alone = configured(laboratory.config, CELLS[0])
    rows: list[tuple[float, ...]] = []
    for delay_s in delays_s:
        physics = dataclasses.replace(perfect, gyro=dataclasses.replace(perfect.gyro, delay_s=delay_s))
        samples = Robot(gyro_alone, physics, np.random.default_rng(0)).samples(laboratory.ways[1], 0)
        run_ = drive(laboratory.ways[1], samples, gyro_alone, None)
        rows.append((delay_s, run_.return_m, run_.largest_m))
    return rows


def other_robot(laboratory: Laboratory, changes: dict[str, float]) -> Laboratory:
    """Laboratory with the same path, another robot, and a configuration for that robot."""
    physics = dataclasses.replace(laboratory.physics, robot=dataclasses.replace(laboratory.physics.robot, **changes))
    return Laboratory(informed(laboratory.config, physics), physics, laboratory.ways)
