"""Labels of recordings (robot, place, batch, start): their own, overridden by those of ROBOTS.yaml.

A recording may bring fleet.yaml (FILE.fleet.yaml next to FILE.mcap). ROBOTS.yaml is a list of rules, all of which apply
in turn to the recordings that they match; patterns are those of a shell, on the path below FOLDERS.
"""

import csv
import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final

import msgspec
import yaml
from msgspec import Struct

from drd.config.schema import ConfigError
from drd_tools.fleet.files import Files

UNKNOWN: Final = "unknown"
NULL: Final = ("", "~", "null")  # of YAML
RUN: Final = re.compile(r"-(\d{8}T\d{6}Z)-[0-9a-f]+-\d+")  # in the name of a daemon's file
HEADER: Final = ("date", "robot", "what")
# Not UTF-8, no YAML, no date (or none in UTC), wrong form; regular expressions and lists can be nested too deeply.
UNREADABLE: Final = (ValueError, OverflowError, RecursionError, yaml.YAMLError)


class Labels(Struct, frozen=True, forbid_unknown_fields=True):
    """Labels of a recording; None if unknown. `batch`: that of the robot's gyro."""

    robot: str | None = None
    place: str | None = None
    batch: str | None = None
    start: datetime | None = None  # UTC if it has no zone

    def over(self, other: "Labels") -> "Labels":
        """These labels, with the other's in place of those unknown."""
        pairs = zip(msgspec.structs.astuple(self), msgspec.structs.astuple(other), strict=True)
        return Labels(*(a if a is not None else b for a, b in pairs))

    def columns(self, begins_s: float = 0.0) -> dict[str, Any]:
        """Label columns of the tables, for a part that begins `begins_s` after the start."""
        start = _utc(self.start)
        with suppress(OverflowError):  # beyond the year 9999
            start = start and start + timedelta(seconds=begins_s)
        return {"robot": self.robot or UNKNOWN, "place": self.place, "batch": self.batch, "start_utc": start}


class Rule(Struct, frozen=True, forbid_unknown_fields=True):
    """Labels of the recordings that match one of the patterns.

    `start_in_name`: a regular expression that finds the start in the recording's name, with groups named year, month,
    day, hour, minute and second; a two-digit year is of this century.
    """

    recordings: list[str]
    robot: str | None = None
    place: str | None = None
    batch: str | None = None
    start_in_name: str | None = None

    def labels(self, name: str) -> Labels:
        """Labels of a recording by its name. Raises ConfigError if its start is no date."""
        found = re.search(self.start_in_name, name) if self.start_in_name else None
        return Labels(self.robot, self.place, self.batch, None if found is None else _date(name, found))


def read_rules(file: str | None) -> list[Rule]:
    """Read the rules of ROBOTS.yaml; none without a file. Raises ConfigError."""
    if file is None:
        return []
    try:
        rules = msgspec.convert(_loaded(_text(file)), list[Rule])
        for rule in rules:
            re.compile(rule.start_in_name or "")
    except (*UNREADABLE, re.error) as error:
        raise ConfigError(file, "", "a list of rules, as `drd fleet update --help` shows", str(error)) from error
    return rules


def ruled(rules: Sequence[Rule], name: str, own: Labels) -> Labels:
    """Override a recording's `own` labels by those of the rules that match its name, later ones over earlier ones."""
    for rule in rules:
        if any(fnmatchcase(name, pattern) for pattern in rule.recordings):
            own = rule.labels(name).over(own)
    return own


def read_own(file: Path) -> Labels:
    """Read a recording's own labels; none without its file. Raises ConfigError."""
    if not file.exists():
        return Labels()
    try:
        return msgspec.convert(_loaded(file.read_text("utf-8")), Labels)
    except (OSError, *UNREADABLE) as error:
        raise ConfigError(str(file), "", "keys robot, place, batch, start", str(error)) from error


def start_of_run(name: str) -> datetime | None:
    """Start of a run, from the name that the daemon gives its file; None for another name."""
    found = RUN.search(name)
    return None if found is None else datetime.strptime(found[1], "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC)


def _loaded(text: str) -> Any:
    """Load YAML with names as text, even if they look like numbers: robot 7 is "7"."""
    return _typed(yaml.load(text, yaml.BaseLoader))


def _typed(value: Any) -> Any:
    if isinstance(value, list):
        return [_typed(v) for v in value]
    if isinstance(value, dict):
        typed = {k: _typed(v) for k, v in value.items()}
        return {
            k: _utc(datetime.fromisoformat(v)) if k == "start" and isinstance(v, str) else v for k, v in typed.items()
        }
    return None if value in NULL else value


def read_maintenance(file: str) -> list[dict[str, Any]]:
    """Read the maintenance log: rows with date, robot, what. Raises ConfigError."""
    rows = list(csv.reader(_text(file).splitlines()))
    if not rows or tuple(cell.strip() for cell in rows[0]) != HEADER:
        raise ConfigError(f"{file}:1", "header", ",".join(HEADER), ",".join(rows[0]) if rows else "an empty file")
    made = []
    for number, row in enumerate(rows[1:], 2):
        if not row:
            continue
        if len(row) != len(HEADER):
            raise ConfigError(f"{file}:{number}", "", "3 columns", str(len(row)))
        when, robot, what = (cell.strip() for cell in row)
        try:
            made.append({"date": _utc(datetime.fromisoformat(when)), "robot": robot, "what": what})
        except (ValueError, OverflowError) as error:
            raise ConfigError(f"{file}:{number}", "date", "a date, as in 2026-03-12", repr(when)) from error
    return made


def _text(file: str) -> str:
    folder, _, name = file.rpartition("/")
    try:
        content = Files(folder or ("/" if file.startswith("/") else ".")).read(name)
        if content is None:
            raise ConfigError(file, "", "a readable file", "nothing there")
        return content.decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(file, "", "a readable UTF-8 text file", str(error)) from error


def _date(name: str, found: re.Match[str]) -> datetime:
    try:
        parts = {key: int(value) for key, value in found.groupdict().items() if value}
        if parts.get("year", 100) < 100:
            parts["year"] += 2000
        return datetime(**{"month": 1, "day": 1, **parts}, tzinfo=UTC)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(name, "start_in_name", "groups that make a date", str(found.groupdict())) from error


def _utc(time: datetime | None) -> datetime | None:
    if time is None:
        return None
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


def as_text(own: Labels) -> str:
    """Labels as JSON."""
    return msgspec.json.encode(own).decode()


def from_text(text: str) -> Labels:
    """Labels from JSON. Raises ConfigError."""
    try:
        return msgspec.json.decode(text, type=Labels)
    except (ValueError, RecursionError) as error:
        raise ConfigError(
            "labels of a recording in the store", "", "keys robot, place, batch, start", str(error)
        ) from error
