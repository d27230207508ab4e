"""The configuration and the files that it names, as text for each recording."""

import dataclasses
from pathlib import Path
from typing import Final

import yaml

from drd.config.keys import Config
from drd.config.schema import ConfigError, Loaded

AS_WRITTEN: Final = "configuration.yaml"
IN_FORCE: Final = "configuration-in-force.yaml"
CALIBRATION: Final = "calibration.yaml"
MODEL: Final = "model.yaml"
DBC: Final = "encoders.dbc"


def files_in_force(loaded: Loaded[Config], base: Path) -> dict[str, bytes]:
    """Attachments by name. `base` is the folder that relative paths start from. Raises ConfigError."""
    config = loaded.value
    found = {IN_FORCE: yaml.safe_dump(dataclasses.asdict(config), sort_keys=False).encode()}
    named = {
        AS_WRITTEN: (loaded.file if loaded.file != "(text)" else None, ""),
        CALIBRATION: (config.calibration.file, "calibration.file"),
        MODEL: (config.model.file, "model.file"),
        DBC: (config.encoders.dbc.file if config.encoders.layout == "dbc" else None, "encoders.dbc.file"),
    }
    for name, (file, path) in named.items():
        if file is not None:
            try:
                found[name] = (Path(file) if name == AS_WRITTEN else base / file).read_bytes()
            except OSError as error:
                raise ConfigError(str(file), path, "a readable file", str(error.strerror)) from error
    return found
