"""Choice of the reader for a file."""

import argparse
from pathlib import Path
from typing import Final

from drd.config.schema import ConfigError
from drd_tools.importing.can_formats import begins, format_of, suffix_of
from drd_tools.importing.can_log import CanLog
from drd_tools.importing.fog_bytes import FogBytes
from drd_tools.importing.ros import RosSource
from drd_tools.importing.streams import Source
from drd_tools.importing.text_table import TextTable

BAG_SUFFIXES: Final = (".bag", ".db3", ".mcap")
BYTES_SUFFIXES: Final = (".bin", ".raw", ".dat")


def open_source(path: Path, chosen: argparse.Namespace) -> Source:
    """Open the file with the reader for its suffix and first bytes. Raises ConfigError."""
    if not path.exists():
        raise ConfigError(str(path), "", "a file, or the folder of a ROS 2 bag", "nothing there")
    suffix = suffix_of(path)
    if path.is_dir():
        if not (path / "metadata.yaml").exists():
            got = "a recording folder already" if (path / "robot.yaml").exists() else "a folder without metadata.yaml"
            raise ConfigError(str(path), "", "a file, or the folder of a ROS 2 bag", got)
        suffix = BAG_SUFFIXES[0]
    if suffix in BYTES_SUFFIXES:
        return FogBytes(path, chosen.config)
    if path.is_file() and (can_format := format_of(path)) is not None:
        return CanLog(path, can_format, chosen.config, chosen.channel)
    if suffix in BAG_SUFFIXES:
        _refuse_own(path)
        words = path, chosen.stamps, chosen.wheels_unit, chosen.joints
        return RosSource(*words, pose=chosen.wheels_from == "pose")
    return TextTable(
        path,
        chosen.time,
        chosen.time_unit,
        chosen.wheels_unit,
        degrees=chosen.heading_unit == "deg",
        temperature=chosen.temperature,
    )


def _refuse_own(path: Path) -> None:
    """Refuse the daemon's own recording, which needs no import."""
    if path.suffix.lower() == ".mcap" and b"drd" in begins(path)[:60]:
        got = "the daemon's own, which `drd replay` reads, or an export of it"
        raise ConfigError(str(path), "", "another system's recording", got)
