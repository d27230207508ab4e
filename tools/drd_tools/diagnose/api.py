"""Diagnose arrays: the Python interface."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from drd.batch.logs import EncoderLog, FogLog
from drd.config.nominal import Nominal
from drd.config.schema import ConfigError
from drd.units import RAD_PER_DEG
from drd_tools.diagnose.diagnosis import Diagnosis
from drd_tools.diagnose.problem import Array
from drd_tools.diagnose.run import run
from drd_tools.recordings.folder import Recording, ReferenceLog, continuous_rad

Columns = Mapping[str, Any]  # names of the recording format's columns to arrays, as a DataFrame has them

COUNTS: Final = ("left_counts", "right_counts")
SPEEDS: Final = ("left_rad_s", "right_rad_s")


def diagnose(
    gyro: Columns | None,
    wheels: Columns | None,
    robot: Nominal,
    *,
    reference: Columns | None = None,
) -> Diagnosis:
    """Find the physics that the nominal model of a robot leaves out.

    `gyro`: time_s, rate_deg_s and, where known, temperature_c. `wheels`: time_s and left_counts, right_counts, or
    left_rad_s, right_rad_s. `reference`: time_s, x_m, y_m, heading_deg. Two of the three are needed. Times are of one
    clock. Raises ConfigError where columns are missing, or have nothing in common.
    """
    nominal = robot
    recording = Recording(Path(nominal.name), nominal, _wheels(wheels), _gyro(gyro), _reference(reference), {})
    return run(recording)


def _gyro(columns: Columns | None) -> FogLog | None:
    if columns is None:
        return None
    time_s, rate_deg_s = _taken("gyro", columns, "time_s", "rate_deg_s")
    temperature_c = _taken("gyro", columns, "time_s", "temperature_c")[1] if "temperature_c" in columns else None
    return FogLog(time_s, RAD_PER_DEG * rate_deg_s, temperature_c)


def _wheels(columns: Columns | None) -> EncoderLog | None:
    if columns is None:
        return None
    if COUNTS[0] in columns:
        time_s, left, right = _taken("wheels", columns, "time_s", *COUNTS)
        return EncoderLog(time_s, left, right, None, None)
    time_s, left, right = _taken("wheels", columns, "time_s", *SPEEDS)
    return EncoderLog(time_s, None, None, left, right)


def _reference(columns: Columns | None) -> ReferenceLog | None:
    if columns is None:
        return None
    time_s, x_m, y_m, heading_deg = _taken("reference", columns, "time_s", "x_m", "y_m", "heading_deg")
    return ReferenceLog(time_s, x_m, y_m, continuous_rad(heading_deg))


def _taken(what: str, columns: Columns, *names: str) -> list[Array]:
    """Columns of one length of numbers, the first a rising time. Raises ConfigError."""
    missing = [name for name in names if name not in columns]
    if missing:
        raise ConfigError(what, missing[0], "a column of numbers", "none")
    arrays = [np.asarray(columns[name], np.float64) for name in names]
    for name, array in zip(names, arrays, strict=True):
        if array.shape != (len(arrays[0]),) or not np.isfinite(array).all():
            raise ConfigError(what, name, f"{len(arrays[0])} finite numbers", f"an array of shape {array.shape}")
    if not (np.diff(arrays[0]) > 0.0).all():
        raise ConfigError(what, names[0], "rising times", "one that is not after the one before")
    return arrays
