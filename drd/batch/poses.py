"""The filter for arrays: `drd.run_filter`."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.batch.logs import Columns, gyro_log, wheel_log
from drd.batch.run import Filtered, filter_logs, latest
from drd.batch.samples import check_times, rate_hz
from drd.config.robot import Robot, nominal_config
from drd.effects.model import Model, Term, load_model
from drd.estimation.calibration import Calibration, load_calibration
from drd.estimation.covariance import of_upper
from drd.units import S_PER_NS


@dataclass(frozen=True)
class Poses:
    """Estimated poses in order of time, shape (n,) unless stated, relative to the start.

    x points ahead of the robot at the start, y to its left; the heading is counter-clockwise, and whole turns are
    kept.
    """

    time_s: Array  # on the wheels' clock
    x_m: Array
    y_m: Array
    heading_rad: Array
    covariance_m_rad: Array  # (n, 3, 3), of x in m, y in m and heading in rad
    position_bound_m: Array  # Radius that contains the true position in 99 of 100 cases
    validity: npt.NDArray[np.str_]  # "initialising", "valid", "degraded" or "invalid"
    notes: tuple[str, ...] = ()  # Sentences on suspicious input


def run_filter(
    gyro: Columns | None,
    wheels: Columns,
    robot: Robot,
    *,
    calibration: Path | str | Calibration | None = None,
    model: Path | str | Model | None = None,
) -> Poses:
    """Estimate where a robot went, with the filter of the daemon.

    `gyro`: time_s (s, rising), rate_deg_s (the mean since the row before, counter-clockwise positive) and, where
    known, temperature_c; None: no gyro. `wheels`: time_s and left_counts, right_counts (cumulative, rising while the
    robot drives forward), or left_rad_s, right_rad_s (speeds of the wheels since the row before); two rows at least.
    Both are mappings from these names to arrays (n,), such as a DataFrame, with times on one clock.
    `calibration` is the gyro's, `model` the result of a diagnosis: files, or their loaded content.

    Raises ConfigError with the column, what was expected and what was found; or with file and line.
    """
    nominal, notes, terms = robot, list[str](), tuple[Term, ...]()
    if model is not None:
        model = model if isinstance(model, Model) else load_model(Path(model))
        nominal = model.changed(nominal)
        terms, notes = model.holds_in(nominal.name)
    fog, encoders = gyro_log(gyro), wheel_log(wheels, nominal)
    check_times(fog, encoders)
    if calibration is not None and not isinstance(calibration, Calibration):
        calibration = load_calibration(Path(calibration))
    config = nominal_config(nominal, None if fog is None else rate_hz(fog), rate_hz(encoders))
    made = filter_logs(fog, encoders, config, calibration if fog is not None else None, terms)
    return _poses(replace(made, notes=[*notes, *made.notes]))


def _poses(made: Filtered) -> Poses:
    poses = latest(made.poses)
    rows = np.array([(p.x_m, p.y_m, p.heading_rad, p.position_bound_m, *p.covariance) for p in poses]).reshape(-1, 10)
    return Poses(
        time_s=np.array([(p.t_ns - made.zero_ns) * S_PER_NS for p in poses]),
        x_m=rows[:, 0],
        y_m=rows[:, 1],
        heading_rad=rows[:, 2],
        covariance_m_rad=of_upper(rows[:, 4:]),
        position_bound_m=rows[:, 3],
        validity=np.array([p.validity.value for p in poses], np.str_),
        notes=tuple(made.notes),
    )
