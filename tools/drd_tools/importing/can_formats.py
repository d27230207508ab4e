"""Formats of CAN log files, recognised by their first bytes; python-can reads all but candump's screen output."""

import gzip
import re
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final

import can

from drd.config.schema import ConfigError

GZIP: Final = b"\x1f\x8b"
BLF_HEADER_BYTES: Final = 144
# `candump` is the file format of candump -l, `screen` its screen output; the others are python-can's suffixes.
BY_SUFFIX: Final = {".asc": "asc", ".blf": "blf", ".trc": "trc"}
BY_BEGINNING: Final = (
    ("blf", re.compile(rb"LOGG")),
    ("csv", re.compile(rb"timestamp,arbitration_id,extended,remote,error,dlc,data\b")),
    ("candump", re.compile(rb"\s*\(\d+\.\d+\) +\S+ +[0-9A-Fa-f]+#")),
    # (time), channel, id, [length], with or without the time.
    ("screen", re.compile(rb"\s*(\([^)]*\) +)?\S+ +((TX|RX) [-B] [-E] +)?([0-9A-F]{3}|[0-9A-F]{8}) +\[\d+\]")),
)
_SCREEN_LINE: Final = re.compile(
    r"\s*(?:\((?P<time>[^)]*)\)\s+)?(?P<channel>\S+)\s+(?:(?:TX|RX) [-B] [-E]\s+)?"
    r"(?P<id>[0-9A-F]{3}|[0-9A-F]{8})\s+\[(?P<length>\d+)\]\s*(?P<data>.*)"
)
# CAN_ERR_FLAG of linux/can.h: the identifier of an error frame.
_ERROR_FRAME: Final = 0x20000000
# candump -tz and -td print seconds with three digits, -ta those of the Unix epoch.
_WALL_TIME: Final = re.compile(r"\d{9,}\.\d{6,9}")


def format_of(path: Path) -> str | None:
    """Format of a CAN log, a name of BY_BEGINNING or BY_SUFFIX, or db; None for anything else.

    Raises ConfigError for an MF4 file, an SQLite file with unknown tables, and an unreadable file.
    """
    head = begins(path)
    if head.startswith((b"MDF ", b"UnFinMF ")):
        # python-can could read it, but if asammdf is installed, always loads it: 100 MB, also in the daemon.
        expected = "another form of it: can_logconvert RUN.mf4 RUN.blf (pip install python-can asammdf, elsewhere)"
        raise ConfigError(str(path), "", expected, "an MF4 file")
    if head.startswith(b"SQLite format 3\0"):
        return _sqlite_format(path)
    by_beginning = next((name for name, pattern in BY_BEGINNING if pattern.match(head)), None)
    return by_beginning or BY_SUFFIX.get(suffix_of(path))


def suffix_of(path: Path) -> str:
    """Suffix of the file name in lower case, ignoring .gz."""
    return next((s.lower() for s in reversed(path.suffixes) if s.lower() != ".gz"), "")


def begins(path: Path) -> bytes:
    """First 200 bytes, decompressed. Raises ConfigError."""
    try:
        with opened(path) as file:
            return bytes(file.read(200))
    except (OSError, EOFError) as error:
        raise ConfigError(str(path), "", "a readable file", str(error)) from error


@contextmanager
def opened(path: Path, mode: str = "rb") -> Iterator[Any]:
    """Open the file, decompressing gzip."""
    with path.open("rb") as file:
        packed = file.read(2) == GZIP
    with gzip.open(path, mode) if packed else path.open(mode) as file:
        yield file


@contextmanager
def messages(path: Path, name: str) -> Iterator[Iterable[can.Message]]:
    """Frames of a file of format `name`, with wall times if the file has them. Raises what its reader raises."""
    if name == "db":
        with can.SqliteReader(path) as reader:
            yield reader
        return
    with opened(path, "rb" if name == "blf" else "rt") as file:
        # python-can does not close a file that is not BLF.
        if name == "blf" and (len(head := file.read(BLF_HEADER_BYTES)) < BLF_HEADER_BYTES or head[:4] != b"LOGG"):
            raise ConfigError(str(path), "", "a BLF file", f"one that begins with {head[:8]!r}")
        file.seek(0)
        if name == "screen":
            yield _of_screen(path, file)
        elif name == "asc":
            # Its times count from the file's start; adding the start's date makes them comparable with other files.
            yield can.ASCReader(file, relative_timestamp=False)
        else:
            readers: dict[str, Any] = {"blf": can.BLFReader, "candump": can.CanutilsLogReader, "csv": can.CSVReader,
                       "trc": can.TRCReader}  # fmt: skip
            yield readers[name](file)


def _of_screen(path: Path, file: Iterable[str]) -> Iterator[can.Message]:
    """Data frames of `candump -ta`. Raises ConfigError for another clock, or none. The last line may be truncated."""
    for number, line in enumerate(file, 1):
        if not line.strip() or not line.endswith("\n"):
            continue
        where, found = f"{path}:{number}", _SCREEN_LINE.match(line)
        if found is None:
            raise ConfigError(where, "", "a line of candump's screen output", repr(line.strip()[:60]))
        if not _WALL_TIME.fullmatch(found["time"] or ""):
            got = f"({found['time']}), which is another clock" if found["time"] else "none"
            raise ConfigError(where, "", "times since 1970, as candump -ta and candump -l write them", got)
        can_id, length = int(found["id"], 16), int(found["length"])
        if can_id & _ERROR_FRAME or found["data"].startswith("remote"):
            continue
        cells = found["data"].split()[:length]
        if len(cells) < length or not all(re.fullmatch("[0-9A-F]{2}", cell) for cell in cells):
            raise ConfigError(where, "", f"{length} bytes", repr(found["data"].strip()[:60]))
        yield can.Message(
            timestamp=float(found["time"]), arbitration_id=can_id, is_extended_id=len(found["id"]) == 8,
            channel=found["channel"], data=bytes.fromhex("".join(cells)), is_fd=length > 8,
        )  # fmt: skip


def _sqlite_format(path: Path) -> str | None:
    """db for frames of python-can's SqliteWriter, None for a ROS 2 bag. Raises ConfigError for another file."""
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
            tables = {name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            columns = {row[1] for row in base.execute("PRAGMA table_info(messages)")}
    except sqlite3.Error as error:
        raise ConfigError(str(path), "", "an SQLite file that can be read", str(error)) from error
    if {"topics", "messages"} <= tables:
        if path.suffix.lower() != ".db3":
            raise ConfigError(str(path), "", "the name of a ROS 2 bag to end in .db3", f"{path.suffix}; rename it")
        return None
    if "arbitration_id" not in columns:
        expected = "an SQLite file that is a ROS 2 bag or a CAN log of python-can"
        raise ConfigError(str(path), "", expected, f"the tables {', '.join(sorted(tables)) or 'none'}")
    return "db"
