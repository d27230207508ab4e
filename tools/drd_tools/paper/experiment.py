"""The whole experiment, on all processor cores."""

import dataclasses
import functools
import operator
import os
from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np
from tqdm import tqdm

from drd.arrays import Array
from drd.config.file import load_config
from drd.config.keys import Config
from drd_tools.calibrate.gyro.data_sets import data_sets_of_samples
from drd_tools.calibrate.gyro.error_function import fit_error_function
from drd_tools.paper.gyro import SimulatedGyro
from drd_tools.paper.physics import Physics
from drd_tools.paper.results import Results
from drd_tools.paper.runs import CELLS, CORNER_M, RUNS_EACH_WAY, Laboratory, Outcome, informed, run_gyro, seconds_of
from drd_tools.paper.studies import delay_alone, other_robot, sigmas_over_laps, sigmas_with_and_without_comparing
from drd_tools.processes import pool_of
from drd_tools.shipped import shipped_config
from drd_tools.simulate.truth import Truth

# Each with fewer gyros and one run each way: enough to show the trend of the filter's share.
OTHER_ROBOTS: Final = (
    {"skid": 0.005, "tread_sigma": 0.001, "pavement_m_per_sqrt_m": 0.0003, "bump_m": 0.0003},
    {"skid": 0.005, "tread_sigma": 0.001},
    {"tread_sigma": 0.02},
    {"skid": 0.05},
)
PERCENTILES: Final = (5.0, 50.0, 95.0)


def run_experiment(gyros: int, seed: int) -> Results:
    """Run all cells of Table II with `gyros` gyros, and the further studies. Shows a progress bar."""
    physics = Physics()
    config = informed(load_config(shipped_config("pioneer-at.yaml")).value, physics)
    laboratory = Laboratory.make(config, physics)
    few = max(2, gyros // 5)
    robots = [other_robot(laboratory, changes) for changes in OTHER_ROBOTS]
    calls: list[Callable[[], Outcome]] = [
        functools.partial(run_gyro, laboratory, 1000 * seed + i, RUNS_EACH_WAY) for i in range(gyros)
    ]
    calls += [functools.partial(run_gyro, robot, 1000 * seed + i, 1, CELLS[:2]) for robot in robots for i in range(few)]
    outcomes = _parallel(calls, "runs")
    main, rest = outcomes[:gyros], outcomes[gyros:]
    others = [np.mean([o.return_m for o in rest[k : k + few]], axis=(0, 1)) for k in range(0, len(rest), few)]
    time_s, sigma = sigmas_over_laps(laboratory)
    truth = laboratory.ways[0]
    seconds = seconds_of(truth)
    return Results(
        return_m=np.array([o.return_m for o in main]),
        largest_m=np.array([o.largest_m for o in main]),
        heading_deg=np.array([o.heading_deg for o in main]),
        bound_m=np.array([o.bound_m for o in main]),
        trace_m=np.percentile(np.array([o.trace_m for o in main]), PERCENTILES, axis=(0, 1)),
        example_true_m=np.column_stack([np.interp(seconds, truth.time_s, v) for v in (truth.x_m, truth.y_m)]),
        via_m=_via_points(truth),
        example_m=main[0].path_m[0],
        table_deg_s=np.array([(o.table_before_deg_s, o.table_after_deg_s) for o in main]),
        figure3=_figure3(physics, seed),
        variance_time_s=time_s,
        variance_sigma=sigma,
        delay=np.array(delay_alone(laboratory)),
        comparing_m=sigmas_with_and_without_comparing(laboratory),
        others=np.array(others),
        other_names=[", ".join(f"{k} {v:g}" for k, v in changes.items()) for changes in OTHER_ROBOTS],
        parameters=list(_parameters(physics)),
        told=list(_configuration_rows(config)),
        seed=seed,
    )


def _via_points(truth: Truth) -> Array:
    """Points at which the corners begin and end."""
    quarter_m = truth.distance_m[-1] / 4.0
    ends = quarter_m * np.arange(1, 5)
    along = np.sort(np.concatenate([ends - CORNER_M, ends]))
    return np.column_stack([np.interp(along, truth.distance_m, v) for v in (truth.x_m, truth.y_m)])


def _parallel(calls: list[Callable[[], Outcome]], what: str) -> list[Outcome]:
    with pool_of(os.cpu_count() or 1) as pool:
        made = pool.map(operator.call, calls)
        return list(tqdm(made, desc=what, total=len(calls), unit="gyro", disable=None))


def _figure3(physics: Physics, seed: int) -> Array:
    """Held-out data sets of one more gyro, before and after its calibration."""
    gyro = SimulatedGyro(physics.gyro, np.random.default_rng([seed, 2003]))
    fitted = fit_error_function(data_sets_of_samples(*gyro.on_rate_table(physics.table)))
    new = data_sets_of_samples(*gyro.on_rate_table(physics.table))
    return np.column_stack([new.table_rate_deg_s, new.temperature_c, new.error_deg_s, fitted.residual_deg_s(new)])


def _parameters(physics: Physics) -> Iterable[list[str]]:
    for part in dataclasses.fields(physics):
        section: Any = getattr(physics, part.name)
        for field in dataclasses.fields(section):
            about = field.metadata
            value = f"{getattr(section, field.name):.4g}"
            yield [f"{part.name}.{field.name}", value, about["unit"], about["text"], about["source"]]


def _configuration_rows(config: Config) -> Iterable[list[str]]:
    """Rows of the configuration that affect the outcome; null is the default for the robot's steering."""
    yield ["robot.tread_m", f"{config.robot.tread_m:g}"]
    yield ["robot.drive", config.robot.drive]
    for name in ("profile", "midpoint", "gate_sigma"):
        yield [f"estimation.{name}", str(getattr(config.estimation, name))]
    for part in ("static_bias", "initial", "noise"):
        section = getattr(config.estimation, part)
        for field in dataclasses.fields(section):
            value = getattr(section, field.name)
            yield [f"estimation.{part}.{field.name}", "null" if value is None else f"{value:.4g}"]
