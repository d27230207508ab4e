"""The recording folder, which also holds the truth."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
import yaml

from drd.arrays import Array
from drd.commands import writing
from drd.units import DEG_PER_RAD
from drd_tools.mujoco_world.measure import Manoeuvre
from drd_tools.mujoco_world.sensors import Readings
from drd_tools.mujoco_world.world import ROW_HZ, Motion
from drd_tools.recordings.folder import write_table
from drd_tools.simulate.files import TRUE_MOTION, write_recording

TRUTH_HZ: Final = 50
# Speeds along the body's axes; wheel angles: mean of a side's two.
TRUTH_HEADER: Final = "time_s,x_m,y_m,heading_deg,speed_m_s,lateral_m_s,left_wheel_rad,right_wheel_rad,friction"


def write_folder(folder: Path, readings: Readings, motion: Motion, truth: dict[str, Any]) -> None:
    """Write robot.yaml, the sensors' files, truth.yaml and truth.csv; files of an earlier simulation are replaced.

    Raises ConfigError if the folder holds a recording that was not simulated, or cannot be written.
    """
    text = "# What emerged in MuJoCo; robot.yaml is what is believed.\n" + yaml.safe_dump(truth, sort_keys=False)
    write_recording(folder, readings.recording, text)
    with writing(folder):
        # + 0.0: no "-0"
        write_table(folder / TRUE_MOTION, TRUTH_HEADER.split(","), _true_rows(motion) + 0.0, "%.2f" + ",%.6f" * 8)


def truth_of(found: Sequence[Manoeuvre], about: dict[str, Any]) -> dict[str, Any]:
    """Make the content of truth.yaml."""
    rows = [
        {name: round(value, 6) if isinstance(value, float) else value for name, value in asdict(m).items()}
        for m in found
    ]
    known = [{name: None if isinstance(v, float) and math.isnan(v) else v for name, v in row.items()} for row in rows]
    return {"world": "mujoco", "mujoco": mujoco.__version__, **about, "manoeuvres": known}


def _true_rows(motion: Motion) -> Array:
    m = motion
    columns = (
        m.time_s, m.x_m, m.y_m, m.heading_rad * DEG_PER_RAD, m.speed_m_s, m.lateral_m_s,
        m.left_rad, m.right_rad, m.friction,
    )  # fmt: skip
    return np.column_stack(columns)[:: ROW_HZ // TRUTH_HZ]
