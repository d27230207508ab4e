"""Writer of an import's recording folder, and of import.yaml, its provenance."""

import argparse
import dataclasses
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

import drd
from drd.commands import writing
from drd.config.file import load_config
from drd.config.robot import Robot, load_robot
from drd.config.schema import ConfigError
from drd_tools.importing.checks import Finding
from drd_tools.importing.streams import Origin, Wheels
from drd_tools.recordings.folder import file_hash

FORMAT: Final = "drd-import/1"
SAID: Final = "import.yaml"
MADE: Final = ("robot.yaml", "encoders.csv", "fog.csv", "reference.csv", SAID)


def nominal_of(chosen: argparse.Namespace, wheels: Wheels | None) -> Robot | None:
    """The robot stated by --robot or --config, overridden by the options; None if nothing needs it.

    Nothing is guessed: raises ConfigError naming the option that is missing.
    """
    stated = load_robot(chosen.robot).value if chosen.robot is not None else None
    if stated is None and wheels is None and chosen.wheel_radius is None:
        return None
    given = load_config(chosen.config).value.robot if chosen.config is not None and stated is None else None
    known = stated or given
    radius_m = chosen.wheel_radius or (known.wheel_radius_m if known else None)
    tread_m = chosen.tread or (known.tread_m if known else None)
    for option, what, value in (("--wheel-radius", "wheels' radius", radius_m), ("--tread", "tread", tread_m)):
        if value is None:
            expected = f"the {what} in m (or --robot FILE), since wheels are imported"
            raise ConfigError("command line", option, expected, "nothing")
    assert radius_m is not None
    assert tread_m is not None
    counts = chosen.counts_per_revolution or (stated.counts_per_revolution if stated else None)
    if wheels is not None:
        if wheels.unit != "counts":
            counts = None
        elif wheels.count_m is not None:
            counts = 2.0 * np.pi * radius_m / wheels.count_m
        elif counts is None:
            expected = "counts of one turn of the wheel (or --robot FILE), since the wheels are counts"
            raise ConfigError("command line", "--counts-per-revolution", expected, "nothing")
    counts = None if counts is None else float(counts)
    if stated is None:
        name = given.name if given is not None else chosen.name or chosen.output.resolve().name
        stated = Robot(name=name, wheel_radius_m=radius_m, tread_m=tread_m)
    if chosen.standstill is not None:
        stated = replace(stated, standstill_at_start_s=chosen.standstill)
    return replace(stated, wheel_radius_m=radius_m, counts_per_revolution=counts, tread_m=tread_m)


def prepare(folder: Path) -> None:
    """Make the folder, or delete an earlier import's files. Raises ConfigError if it holds another recording."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        found = [name for name in MADE if (folder / name).exists()]
        if found and SAID not in found:
            got = f"{', '.join(found)} that no import made"
            raise ConfigError(str(folder), "--output", "a folder without a recording, or of an earlier import", got)
        for name in found:
            (folder / name).unlink()


def write_robot(file: Path, nominal: Robot, rates_hz: dict[str, float | None]) -> None:
    """Write robot.yaml; rates not stated are the measured ones, the rest stays null. Raises OSError."""
    if nominal.gyro_rate_hz is None and (rate_hz := rates_hz.get("gyro")):
        nominal = replace(nominal, gyro_rate_hz=float(f"{rate_hz:.6g}"))
    if nominal.encoders_rate_hz is None and (rate_hz := rates_hz.get("wheels")):
        nominal = replace(nominal, encoders_rate_hz=float(f"{rate_hz:.6g}"))
    content = nominal.sections()
    head = "# The robot as stated to drd import; null: not stated. rate_hz is measured where it was not stated.\n"
    file.write_text(head + yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def write_said(
    file: Path,
    inputs: Sequence[Path],
    options: Sequence[str],
    origins: dict[str, Origin],
    applied: dict[str, Any],
    findings: Sequence[Finding],
    zero_ns: int,
) -> None:
    """Write import.yaml. Raises OSError."""
    content = {
        "format": FORMAT,
        "drd": drd.__version__,
        "inputs": {str(path): hashes(path) for path in inputs},
        "options": list(options),
        "zero": f"{zero_ns // 10**9}.{zero_ns % 10**9:09d}",
        "streams": {name: dataclasses.asdict(origin) for name, origin in origins.items()},
        "applied": applied,
        "findings": [dataclasses.asdict(finding) for finding in findings],
    }
    head = "# Where this recording is from. zero: the source's time, in s, at which time_s is 0.\n"
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=110)
    file.write_text(head + text, encoding="utf-8")


def hashes(path: Path) -> str | dict[str, str]:
    """Compute the SHA-256 of the file, or of each file in a bag's folder. Raises ConfigError."""
    if path.is_dir():
        return {file.name: file_hash(file) for file in sorted(path.iterdir()) if file.is_file()}
    return file_hash(path)
