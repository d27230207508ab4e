"""Which kind of file it is, and its reader."""

import argparse
import gzip
from pathlib import Path
from typing import Final

from drd.config.schema import ConfigError
from drd_tools.importing.can_log import SUFFIXES as CAN_SUFFIXES
from drd_tools.importing.can_log import CanLog
from drd_tools.importing.fog_bytes import FogBytes
from drd_tools.importing.ros import RosSource
from drd_tools.importing.streams import Source
from drd_tools.importing.text_table import TextTable

BAG_SUFFIXES: Final = (".bag", ".db3", ".mcap")
BYTES_SUFFIXES: Final = (".bin", ".raw", ".dat")
GZIP: Final = b"\x1f\x8b"
BLF_HEADER_BYTES: Final = 144


def open_source(path: Path, chosen: argparse.Namespace) -> Source:
    """The reader for the file's kind, by its name's ending; of .log by its first line. Raises ConfigError."""
    if not path.exists():
        raise ConfigError(str(path), "", "a file, or the folder of a ROS 2 bag", "nothing there")
    suffix = next((s.lower() for s in reversed(path.suffixes) if s.lower() != ".gz"), "")
    if path.is_dir():
        if not (path / "metadata.yaml").exists():
            got = "a recording folder already" if (path / "robot.yaml").exists() else "a folder without metadata.yaml"
            raise ConfigError(str(path), "", "a file, or the folder of a ROS 2 bag", got)
        suffix = BAG_SUFFIXES[0]
    if suffix in BAG_SUFFIXES:
        _refuse_own(path)
        return RosSource(path, chosen.stamps, chosen.wheels_unit, chosen.joints, pose=chosen.wheels_from == "pose")
    if suffix in CAN_SUFFIXES or (suffix == ".log" and _begins(path).lstrip().startswith(b"(")):
        # python-can leaves a file open that is no BLF.
        if suffix == ".blf" and (len(head := _begins(path)) < BLF_HEADER_BYTES or not head.startswith(b"LOGG")):
            raise ConfigError(str(path), "", "a BLF file", f"one that begins with {head[:8]!r}")
        return CanLog(path, chosen.config, chosen.channel)
    if suffix in BYTES_SUFFIXES:
        return FogBytes(path, chosen.config)
    return TextTable(
        path,
        chosen.time,
        chosen.time_unit,
        chosen.wheels_unit,
        degrees=chosen.heading_unit == "deg",
        temperature=chosen.temperature,
    )


def _begins(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            packed = file.read(2) == GZIP
        with gzip.open(path) if packed else path.open("rb") as file:
            return file.read(200)
    except (OSError, EOFError) as error:
        raise ConfigError(str(path), "", "a readable file", str(error)) from error


def _refuse_own(path: Path) -> None:
    """A recording of the daemon needs no import."""
    if path.suffix.lower() == ".mcap" and b"drd" in _begins(path)[:60]:
        raise ConfigError(
            str(path), "", "another system's recording", "the daemon's own: `drd replay` reads it as it is"
        )
