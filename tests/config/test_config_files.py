"""The files in config/ are the manual of the configuration: complete, and true to drd.config.keys."""

import dataclasses
import re
from pathlib import Path
from typing import Literal, get_args, get_origin

import pytest

from drd.cli import main
from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.schema import keys, loads, meanings

REQUIRED = (
    "robot.wheel_radius_m",
    "robot.tread_m",
)  # `test_a_file_states_the_true_defaults` shows the others' defaults
FOLDER = Path(__file__).parents[2] / "config"
FILES = sorted(FOLDER.glob("*.yaml"))
KEY_LINE = re.compile(r"( *)(# )?([a-z][a-z0-9_]*):(?: (.+))?")
COMMENT_LINE = re.compile(r" *# (.*)")

pytestmark = pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)


@dataclasses.dataclass
class Entry:
    """A key as a file shows it: the comment above it, its value, and whether it is in force."""

    comment: str
    value: str | None
    active: bool


def entries_of(text: str) -> dict[str, Entry]:
    """All keys of a file by path, commented-out ones included; sections have no value."""
    found: dict[str, Entry] = {}
    path: list[str] = []
    comment: list[str] = []
    for line in text.splitlines():
        if match := KEY_LINE.fullmatch(line):
            indent, hidden, name, value = match.groups()
            path = [*path[: len(indent) // 2], name]
            assert ".".join(path) not in found, f"{path} twice"
            found[".".join(path)] = Entry(" ".join(comment), value, hidden is None)
            comment = []
        elif match := COMMENT_LINE.fullmatch(line):
            comment.append(match[1])
        else:
            assert not line.strip() or line.strip() == "#", f"neither comment nor key: {line}"
            comment = []
    return found


def nested(values: dict[str, str]) -> str:
    """YAML text from values by path."""
    lines, before = [], [""]
    for path, value in values.items():
        *sections, name = path.split(".")
        for depth, section in enumerate(sections):
            if before[: depth + 1] != sections[: depth + 1]:
                lines.append("  " * depth + f"{section}:")
        before = sections
        lines.append("  " * len(sections) + f"{name}: {value}")
    return "\n".join(lines)


def stated(entry: Entry) -> tuple[str, list[str]]:
    """What the comment says: the meaning, and what stands in brackets."""
    match = re.fullmatch(r"(.*?) \[((?:[^\[\]]|\[.*?\])*)\](?: .*)?", entry.comment)
    assert match, entry.comment
    return match[1], match[2].split("; ")


def test_a_file_loads_and_drd_check_finds_it_good(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(file)]) == 0
    assert capsys.readouterr().out.endswith(f"{file}: good\n")


def test_a_file_holds_every_key_in_its_section_and_no_other(file: Path) -> None:
    leaves = [path for path, entry in entries_of(file.read_text()).items() if entry.value is not None]
    assert leaves == [path for path, _ in keys(Config)]


def test_a_file_says_of_each_key_what_drd_config_says(file: Path) -> None:
    entries = entries_of(file.read_text())
    said = meanings(Config)
    for path, key in keys(Config):
        text, facts = stated(entries[path])
        assert text == said[path], path
        assert facts[-1].split(" ")[0] == ("required" if path in REQUIRED else "default"), path
        units_and_limits = facts[:-1]
        if key.unit:
            assert units_and_limits.pop(0) == key.unit, path
        if get_origin(key.kind) is Literal:
            assert units_and_limits.pop(0) == " | ".join(get_args(key.kind)), path
        elif key.low > float("-inf"):
            low, high = (float(eval_power(limit)) for limit in units_and_limits.pop(0).split(" to "))
            assert (low, high) == (key.low, key.high), path
        assert units_and_limits == [], path


def eval_power(text: str) -> float:
    base, _, exponent = text.partition("^")
    return float(base) ** int(exponent or 1)


def test_a_file_states_the_true_defaults(file: Path) -> None:
    values = {}
    for path, entry in entries_of(file.read_text()).items():
        if entry.value is not None:
            default = stated(entry)[1][-1]
            values[path] = entry.value if default == "required" else default.removeprefix("default ")
    geometry = load_config(file).value.robot
    robot = type(geometry)(wheel_radius_m=geometry.wheel_radius_m, tread_m=geometry.tread_m)
    assert loads(nested(values), Config).value == Config(robot=robot)


def test_what_is_commented_out_is_at_its_default(file: Path) -> None:
    """So that taking the comment sign away changes nothing, and everything may be taken in at once."""
    text = file.read_text()
    uncommented = nested({path: e.value for path, e in entries_of(text).items() if e.value is not None})
    assert loads(uncommented, Config).value == load_config(file).value
    active = {path for path, e in entries_of(text).items() if e.active and e.value is not None}
    origins = load_config(file).origins
    assert active == {path for path, origin in origins.items() if origin != "default"}


def test_no_line_is_wider_than_100_columns(file: Path) -> None:
    assert max(map(len, file.read_text().splitlines())) <= 100
