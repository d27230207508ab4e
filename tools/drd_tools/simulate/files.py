"""The simulated recording's folder, which also holds the truth: truth.yaml and truth.csv."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from drd import __version__
from drd.arrays import Array
from drd.batch.logs import COUNTS, RATE_AND_TEMPERATURE, SPEEDS
from drd.commands import writing
from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD
from drd_tools.recordings.folder import POSES, Recording, read_table, write_table
from drd_tools.simulate.robot import robot_yaml
from drd_tools.simulate.sensors import DECIMALS, Effects
from drd_tools.simulate.simulator import Simulated

ROBOT, ENCODERS, FOG, REFERENCE = "robot.yaml", "encoders.csv", "fog.csv", "reference.csv"
TRUTH, TRUE_MOTION = "truth.yaml", "truth.csv"
# Keep every tenth state of the 500 Hz.
EVERY: Final = 10
MOTION: Final = (
    "time_s", "x_m", "y_m", "heading_deg", "speed_m_s", "lateral_m_s", "rate_deg_s", "temperature_c",
)  # fmt: skip
# Changes that the effects cause: the gyro's rate, and the travel counted since the start.
CHANGES: Final = ("gyro_change_deg_s", "left_change_m", "right_change_m")


def write_folder(simulated: Simulated, folder: Path, about: dict[str, Any], without: Simulated | None = None) -> None:
    """Write the recording; `about` goes into truth.yaml. `without`: the same run without effects, for the changes.

    Files of an earlier simulation are replaced. Raises ConfigError if the folder holds a recording that was not
    simulated, or cannot be written.
    """
    write_recording(folder, simulated.recording, truth_yaml(simulated, about))
    columns = _motion(simulated)
    if without is not None:
        columns |= _changes(simulated, without, columns["time_s"])
    with writing(folder):
        _write(folder / TRUE_MOTION, tuple(columns), list(columns.values()))


def write_recording(folder: Path, recording: Recording, truth: str) -> None:
    """Write robot.yaml, the sensors' files, and truth.yaml with the text `truth`. Raises ConfigError, see above."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / ROBOT).exists() and not (folder / TRUTH).exists():
            raise ConfigError(str(folder), "", "an empty folder, or a simulated recording", "another recording")
        for name in (FOG, REFERENCE):
            (folder / name).unlink(missing_ok=True)  # the new recording may not have it
        (folder / TRUTH).write_text(truth, encoding="utf-8")
        (folder / ROBOT).write_text(robot_yaml(recording.nominal), encoding="utf-8")
        _write_logs(recording, folder)


def truth_yaml(simulated: Simulated, about: dict[str, Any]) -> str:
    """Make the text of truth.yaml; its `effects` are in the form of a model file."""
    truth = simulated.truth
    content = {
        **about,
        "drd": __version__,
        "seed": simulated.seed,
        "duration_s": round(truth.duration_s, DECIMALS),
        "whole_laps": truth.laps,
        "length_m": round(truth.length_m, 3),
        "gyro_bias_deg_s": round(simulated.bias_rad_s * DEG_PER_RAD, 9),
        "conditions": _plain(asdict(simulated.conditions)),
        "effects": effect_rows(simulated.effects),
    }
    return "# What is true of this simulated recording; robot.yaml is what is believed.\n" + yaml.safe_dump(
        content, sort_keys=False
    )


def effect_rows(effects: Effects) -> list[dict[str, Any]]:
    """Effects in the form of a model file: values in the catalogue's units."""
    return [
        {
            "effect": effect.id,
            "parameters": {
                p.name: value if isinstance(value := values[p.name], str) else float(f"{value / p.si:.12g}")
                for p in effect.parameters
            },
        }
        for effect, values in effects
    ]


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, tuple):
        return list(value)
    return "gaussian" if isinstance(value, float) and math.isinf(value) else value


def _write_logs(recording: Recording, folder: Path) -> None:
    log, fog, reference = recording.encoders, recording.fog, recording.reference
    if log.left_counts is not None and log.right_counts is not None:
        _write(folder / ENCODERS, COUNTS, [log.time_s, log.left_counts, log.right_counts], "%.0f")
    elif log.left_rad_s is not None and log.right_rad_s is not None:
        _write(folder / ENCODERS, SPEEDS, [log.time_s, log.left_rad_s, log.right_rad_s])
    if fog is not None and fog.temperature_c is not None:
        columns = [fog.time_s, fog.rate_rad_s * DEG_PER_RAD, fog.temperature_c]
        _write(folder / FOG, RATE_AND_TEMPERATURE, columns)
    if reference is not None:
        columns = [reference.time_s, reference.x_m, reference.y_m, reference.heading_rad * DEG_PER_RAD]
        _write(folder / REFERENCE, POSES, columns)


def _motion(simulated: Simulated) -> dict[str, Array]:
    t = simulated.truth
    at = np.arange(0, len(t.x_m), EVERY)
    step = np.maximum(at - 1, 0)
    columns = (
        t.time_s[at], t.x_m[at], t.y_m[at], t.heading_rad[at] * DEG_PER_RAD,
        t.speed_m_s[step], t.lateral_m_s[step], t.rate_rad_s[step] * DEG_PER_RAD, t.temperature_c[step],
    )  # fmt: skip
    return dict(zip(MOTION, columns, strict=True))


def _changes(simulated: Simulated, without: Simulated, time_s: Array) -> dict[str, Array]:
    """Readings minus those without the effects, at given times; the noise, being the same, cancels."""
    columns = [np.zeros_like(time_s)]
    fog, plain = simulated.recording.fog, without.recording.fog
    if fog is not None and plain is not None:
        row = np.searchsorted(fog.time_s, time_s).clip(0, len(fog.time_s) - 1)
        columns = [((fog.rate_rad_s - plain.rate_rad_s) * DEG_PER_RAD)[row]]
    radius_m = simulated.recording.nominal.wheel_radius_m
    angles = simulated.recording.wheel_angles_rad(), without.recording.wheel_angles_rad()
    for with_, plain_ in zip(*angles, strict=True):
        columns.append(np.interp(time_s, simulated.recording.encoders.time_s, radius_m * (with_ - plain_)))
    return dict(zip(CHANGES, columns, strict=True))


def _write(file: Path, header: tuple[str, ...], columns: list[Array], rest: str = f"%.{DECIMALS}f") -> None:
    form = ",".join([f"%.{DECIMALS}f", *[rest] * (len(header) - 1)])
    write_table(file, header, np.column_stack(columns) + 0.0, form)  # no "-0"


def read_true_motion(folder: Path) -> dict[str, Array]:
    """Columns of truth.csv by name. Raises ConfigError."""
    table = read_table(folder / TRUE_MOTION, (MOTION, (*MOTION, *CHANGES)))
    return dict(zip(table.header, table.values.T, strict=True))


def read_truth(folder: Path) -> dict[str, Any]:
    """Read truth.yaml. Raises ConfigError."""
    file = folder / TRUTH
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(str(file), "", "a file that drd simulate wrote", str(error)) from error
    if not isinstance(content, dict) or "effects" not in content:
        raise ConfigError(str(file), "effects", "a file that drd simulate wrote", "something else")
    return content
