"""Results that a command keeps in its folder, so that they can be printed, compared and drawn again."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec
import numpy as np

from drd.config.schema import ConfigError

T = TypeVar("T")

FILE: Final = "results.json"
SIGNIFICANT_DIGITS: Final = 7  # of arrays


@dataclass(frozen=True)
class _Head:
    format: str


def save(file: Path, form: str, result: Any) -> None:
    """Write a dataclass, marked with its form. Raises OSError."""
    text = json.dumps({"format": form, **msgspec.to_builtins(result, enc_hook=_plain)}, allow_nan=False)
    file.write_text(text + "\n", encoding="utf-8")


def load(file: Path, form: str, command: str, kind: type[T]) -> T:
    """Read what `save` wrote for an earlier `command`. Raises ConfigError."""
    try:
        data = file.read_bytes()
        if msgspec.json.decode(data, type=_Head).format != form:
            raise ValueError("another format")
        return msgspec.json.decode(data, type=kind, dec_hook=lambda _, value: np.array(value, float))
    except OSError as error:
        raise ConfigError(str(file), "", f"results of an earlier `{command}`", str(error.strerror)) from error
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise ConfigError(str(file), "", f"a file of the form {form}", f"something else ({error})") from error


def _plain(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value.item()  # one of numpy's numbers
    rounded = [float(f"{v:.{SIGNIFICANT_DIGITS}g}") for v in value.ravel()]
    return np.reshape(rounded, value.shape).tolist()
