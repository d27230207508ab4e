"""Conversion of JSON files to classes, with errors that name file and place."""

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec

from drd.config.schema import MISSING, ConfigError

T = TypeVar("T")

LONGEST: Final = 80  # letters of a value shown in an error


def read_json(file: Path, expected: str = "a readable file") -> Any:
    """Read the content. Raises ConfigError."""
    try:
        return json.loads(file.read_bytes())
    except OSError as error:
        raise ConfigError(str(file), "", expected, str(error.strerror)) from error
    except (ValueError, RecursionError) as error:  # not UTF-8, or not JSON
        raise ConfigError(str(file), "", "JSON", f"an error: {error}") from error


def converted(
    file: Path,
    content: Any,
    form: type[T],
    dec_hook: Callable[[type, Any], Any] | None = None,
    words: Mapping[str, str] | None = None,
) -> T:
    """Convert `content` of `file` to `form`. `words`: allowed values by name of the key. Raises ConfigError."""
    try:
        return msgspec.convert(content, form, dec_hook=dec_hook)
    except msgspec.ValidationError as error:
        raise _refused(str(file), content, str(error), words or {}) from error


def _refused(file: str, content: Any, message: str, words: Mapping[str, str]) -> ConfigError:
    """Make the error that names the place, and what is expected and found there."""
    what, _, path = message.partition(" - at `$")
    path = path.rstrip("`").lstrip(".")
    if missing := MISSING.fullmatch(what):
        place = f"{path}.{missing[1]}" if path else missing[1]
        return ConfigError(file, place, "a value (the key is required)", "nothing")
    value: Any = content
    for key, index in re.findall(r"([^.\[\]]+)|\[(\d+)\]", path):
        value = value[int(index)] if index else value.get(key) if isinstance(value, dict) else None
    text = json.dumps(value)
    got = text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."
    name = path.rpartition(".")[2]
    if what.startswith("Invalid enum value") and name in words:
        return ConfigError(file, path, f"one of {words[name]}", got)
    expected, _, sizes = what.removeprefix("Expected ").partition("; ")
    return ConfigError(file, path, expected.partition(", got")[0], sizes or got)
