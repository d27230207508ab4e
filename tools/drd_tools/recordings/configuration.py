"""Configuration in force in a recording of the daemon."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from drd.config.file import check_estimate, check_layout, load_overlay
from drd.config.keys import CalibrationFile, Config, ModelFile
from drd.config.schema import loads
from drd.recording.in_force import CALIBRATION, DBC, IN_FORCE, MODEL
from drd_tools.recordings.mcap_file import McapFile


def config_in_force(
    recording: McapFile,
    folder: Path,
    config: Path | None = None,
    calibration: Path | None = None,
    model: Path | None = None,
) -> tuple[Config, Path]:
    """Load the configuration, and the base of its relative paths; write the attached files to `folder`.

    It is the recorded one, overridden by the file `config`, any part of which may be missing.
    Raises ConfigError.
    """
    found, base = attached_configuration(recording.attachments, folder, f"{recording.path}, {IN_FORCE}"), folder
    if config is not None:
        stated = load_overlay(config, found)
        check_layout(stated)
        check_estimate(stated)
        found = stated.value
    if calibration is not None:
        found = dataclasses.replace(found, calibration=CalibrationFile(file=str(calibration.resolve())))
    if model is not None:
        found = dataclasses.replace(found, model=ModelFile(file=str(model.resolve())))
    return found, base


def attached_configuration(files: Mapping[str, bytes], folder: Path, where: str) -> Config:
    """Load the configuration in force from these files; write the others, to which it refers, to `folder`."""
    found = loads(files[IN_FORCE].decode("utf-8", "replace"), Config, where).value
    for name in (CALIBRATION, MODEL, DBC):
        if name in files:
            (folder / name).write_bytes(files[name])
    if found.calibration.file is not None:
        found = dataclasses.replace(found, calibration=CalibrationFile(file=CALIBRATION))
    if found.model.file is not None:
        found = dataclasses.replace(found, model=ModelFile(file=MODEL))
    if found.encoders.dbc.file is not None:
        dbc = dataclasses.replace(found.encoders.dbc, file=DBC)
        found = dataclasses.replace(found, encoders=dataclasses.replace(found.encoders, dbc=dbc))
    return found
