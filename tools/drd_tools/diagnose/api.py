"""Diagnose arrays: the Python interface."""

from pathlib import Path

from drd.batch.logs import Columns, columns, gyro_log, wheel_log
from drd.config.robot import Robot
from drd_tools.diagnose.diagnosis import Diagnosis
from drd_tools.diagnose.observe.parts import from_its_start
from drd_tools.diagnose.run import run
from drd_tools.recordings.folder import POSES, Recording, ReferenceLog, continuous_rad


def diagnose(
    gyro: Columns | None,
    wheels: Columns | None,
    robot: Robot,
    *,
    reference: Columns | None = None,
) -> Diagnosis:
    """Find the physics that the nominal model of a robot leaves out.

    `gyro`: time_s, rate_deg_s and, where known, temperature_c. `wheels`: time_s and left_counts, right_counts, or
    left_rad_s, right_rad_s. `reference`: time_s, x_m, y_m, heading_deg. Two of the three are needed, with times of one
    clock. Raises ConfigError if columns are missing, do not overlap in time, or contradict each other in sign, unit or
    scale.
    """
    encoders = None if wheels is None else wheel_log(wheels, robot)
    recording = Recording(Path(robot.name), robot, encoders, gyro_log(gyro), _reference(reference), {})
    return run(from_its_start(recording))


def _reference(given: Columns | None) -> ReferenceLog | None:
    if given is None:
        return None
    time_s, x_m, y_m, heading_deg = columns("reference", given, POSES)
    return ReferenceLog(time_s, x_m, y_m, continuous_rad(heading_deg))
