"""Results that a command keeps in its folder, so that they can be printed, compared and drawn again."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

from drd.schema import ConfigError

T = TypeVar("T")

FILE: Final = "results.json"


def save(folder: Path, form: str, content: dict[str, Any]) -> None:
    """Write FILE, marked with its form. Raises OSError."""
    text = json.dumps({"format": form, **content}, allow_nan=False)
    (folder / FILE).write_text(text + "\n", encoding="utf-8")


def load(folder: Path, form: str, command: str, revive: Callable[[dict[str, Any]], T]) -> T:
    """Read FILE of an earlier `command`; `revive` makes the results of it, and may fail in any usual way.

    Raises ConfigError.
    """
    file = folder / FILE
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        if content.pop("format") != form:
            raise ValueError("another format")
        return revive(content)
    except OSError as error:
        raise ConfigError(str(file), "", f"results of an earlier `{command}`", str(error.strerror)) from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ConfigError(str(file), "", f"a file of the form {form}", f"something else ({error})") from error
