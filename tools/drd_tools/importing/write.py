"""The recording folder that an import makes, and import.yaml, which says what it is from."""

import dataclasses
import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

import drd
from drd.batch.logs import COUNTS, RATE, RATE_AND_TEMPERATURE, SPEEDS
from drd.config.file import load_config
from drd.config.nominal import Nominal, Wheel, load_nominal
from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD
from drd_tools.importing.checks import Finding
from drd_tools.importing.convert import EncoderRows
from drd_tools.importing.streams import Array, Origin, Reference, Wheels
from drd_tools.recordings.folder import POSES

FORMAT: Final = "drd-import/1"
SAID: Final = "import.yaml"
MADE: Final = ("robot.yaml", "encoders.csv", "fog.csv", "reference.csv", SAID)


def nominal_of(
    robot: Path | None,
    config: Path | None,
    wheels: Wheels | None,
    *,
    name: str,
    radius_m: float | None,
    tread_m: float | None,
    counts_per_revolution: float | None,
    standstill_s: float | None,
) -> Nominal | None:
    """The robot as --robot, --config or the options state it, the options last; None where nothing needs it.

    Nothing is guessed: raises ConfigError with the option that is missing.
    """
    stated = load_nominal(robot).value if robot is not None else None
    if stated is None and wheels is None and radius_m is None:
        return None
    given = None
    if config is not None and stated is None:
        given = load_config(config).value.robot
    radius_m = radius_m or (stated.wheel.radius_m if stated else given.wheel_radius_m if given else None)
    tread_m = tread_m or (stated.tread_m if stated else given.tread_m if given else None)
    for option, what, value in (("--wheel-radius", "wheels' radius", radius_m), ("--tread", "tread", tread_m)):
        if value is None:
            raise ConfigError(
                "command line", option, f"the {what} in m (or --robot FILE), since wheels are imported", "nothing"
            )
    assert radius_m is not None
    assert tread_m is not None
    counts = counts_per_revolution or (stated.wheel.counts_per_revolution if stated else None)
    if wheels is not None:
        if wheels.unit != "counts":
            counts = None
        elif wheels.count_m is not None:
            counts = 2.0 * np.pi * radius_m / wheels.count_m
        elif counts is None:
            expected = "counts of one turn of the wheel (or --robot FILE), since the wheels are counts"
            raise ConfigError("command line", "--counts-per-revolution", expected, "nothing")
    wheel = Wheel(radius_m=radius_m, counts_per_revolution=None if counts is None else float(counts))
    if stated is None:
        stated = Nominal(name=given.name if given is not None else name, wheel=wheel, tread_m=tread_m)
    if standstill_s is not None:
        stated = replace(stated, standstill_at_start_s=standstill_s)
    return replace(stated, wheel=wheel, tread_m=tread_m)


def prepare(folder: Path) -> None:
    """Make the folder, or clear it of an earlier import's files. Raises ConfigError where others' are in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        found = [name for name in MADE if (folder / name).exists()]
        if found and SAID not in found:
            got = f"{', '.join(found)} that no import made"
            raise ConfigError(str(folder), "--output", "a folder without a recording, or of an earlier import", got)
        for name in found:
            (folder / name).unlink()
    except OSError as error:
        raise ConfigError(str(folder), "--output", "a folder to write to", str(error.strerror)) from error


def write_robot(file: Path, nominal: Nominal, rates_hz: dict[str, float | None]) -> None:
    """robot.yaml; rates that nobody stated are those measured, the rest stays null. Raises OSError."""
    fog, encoders = nominal.fog, nominal.encoders
    if fog.rate_hz is None and rates_hz.get("gyro"):
        fog = replace(fog, rate_hz=_rounded(rates_hz["gyro"]))
    if encoders.rate_hz is None and rates_hz.get("wheels"):
        encoders = replace(encoders, rate_hz=_rounded(rates_hz["wheels"]))
    content = dataclasses.asdict(replace(nominal, fog=fog, encoders=encoders))
    head = "# The robot as stated to drd import; null: not stated. rate_hz is measured where it was not stated.\n"
    file.write_text(head + yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def write_fog(file: Path, time_s: Array, rate_rad_s: Array, temperature_c: Array | None) -> None:
    """fog.csv. Raises OSError."""
    columns = [time_s, rate_rad_s * DEG_PER_RAD]
    if temperature_c is None:
        return _write(file, RATE, "%.9f,%.9g", columns)
    return _write(file, RATE_AND_TEMPERATURE, "%.9f,%.9g,%.6g", [*columns, temperature_c])


def write_encoders(file: Path, time_s: Array, rows: EncoderRows) -> None:
    """encoders.csv. Raises OSError."""
    header, form = (COUNTS, "%.9f,%.0f,%.0f") if rows.are_counts else (SPEEDS, "%.9f,%.9g,%.9g")
    _write(file, header, form, [time_s, rows.left, rows.right])


def write_reference(file: Path, time_s: Array, reference: Reference) -> None:
    """reference.csv. Raises OSError."""
    heading_deg = np.unwrap(reference.heading_rad) * DEG_PER_RAD
    _write(file, POSES, "%.9f,%.9g,%.9g,%.9g", [time_s, reference.x_m, reference.y_m, heading_deg])


def write_said(
    file: Path,
    inputs: Sequence[Path],
    options: Sequence[str],
    origins: dict[str, Origin],
    applied: dict[str, Any],
    findings: Sequence[Finding],
    zero_ns: int,
) -> None:
    """import.yaml. Raises OSError."""
    content = {
        "format": FORMAT,
        "drd": drd.__version__,
        "inputs": {str(path): sha256 for path in inputs for sha256 in [hashes(path)]},
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
    """SHA-256 of the file, or of each file in a bag's folder. Raises ConfigError."""
    try:
        if path.is_dir():
            return {file.name: str(hashes(file)) for file in sorted(path.iterdir()) if file.is_file()}
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ConfigError(str(path), "", "a readable file", str(error.strerror)) from error


def _rounded(rate_hz: float | None) -> float | None:
    return None if rate_hz is None else float(f"{rate_hz:.6g}")


def _write(file: Path, header: tuple[str, ...], form: str, columns: Sequence[Array]) -> None:
    rows = np.column_stack(columns)
    with file.open("w", encoding="utf-8", newline="") as out:
        out.write(",".join(header) + "\n")
        out.write((form + "\n") * len(rows) % tuple(rows.ravel().tolist()))
