"""Results that a command saves in its folder, to be printed, compared and drawn again."""

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Self, TypeVar

import msgspec
import numpy as np

from drd.commands import writing
from drd.config.schema import ConfigError
from drd_tools.report.json_file import converted, read_json

FILE: Final = "results.json"
SIGNIFICANT_DIGITS: Final = 7  # in arrays
# For numbers with more digits before the point: times since 1970 to 0.1 ms, UTM coordinates to 0.1 mm.
DECIMALS: Final = 4


@dataclass(frozen=True)
class Saved:
    """Base of results that a command computes once, to be printed and drawn repeatedly: plain data and arrays.

    `FORMAT` identifies the file, `COMMAND` is the command that makes it.
    """

    FORMAT: ClassVar[str]
    COMMAND: ClassVar[str]

    def save(self, folder: Path) -> None:
        """Write results.json. Raises OSError."""
        self.write(folder / FILE)

    def write(self, file: Path) -> None:
        """Write JSON. Raises OSError."""
        text = json.dumps({"format": self.FORMAT, **msgspec.to_builtins(self, enc_hook=_plain)}, allow_nan=False)
        file.write_text(text + "\n", encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read results.json. Raises ConfigError."""
        return cls.read(folder / FILE)

    @classmethod
    def read(cls, file: Path) -> Self:
        """Read a file made by `write`. Raises ConfigError."""
        content = read_json(file, f"results of an earlier `{cls.COMMAND}`")
        if not isinstance(content, dict) or content.get("format") != cls.FORMAT:
            raise ConfigError(str(file), "format", cls.FORMAT, "another one or none")
        return converted(file, content, cls, lambda _, value: np.array(value, float))


def _plain(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value.item()  # one of numpy's numbers
    return np.reshape([_rounded(v) for v in value.ravel().tolist()], value.shape).tolist()


def _rounded(value: float) -> float:
    digits = float(f"{value:.{SIGNIFICANT_DIGITS}g}")
    return digits if abs(digits) < 10 ** (SIGNIFICANT_DIGITS - DECIMALS) else round(value, DECIMALS)


S = TypeVar("S", bound=Saved)


def keep_and_show(
    chosen: argparse.Namespace,
    kind: type[S],
    make: Callable[[], S],
    tell: Callable[[S], None],
    report: Callable[[S, Path], list[Path]],
) -> int:
    """Make a result, or load that of --draw; save it in --output if given, print it and draw it there.

    Returns exit code 0. Raises ConfigError.
    """
    folder: Path | None = chosen.draw or chosen.output
    with writing(folder):
        if chosen.draw is not None:
            result = kind.load(chosen.draw)
        else:
            result = make()
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
                result.save(folder)
                result = kind.load(folder)  # show exactly the saved digits
        tell(result)
        if folder is not None:
            tell_files([folder / FILE, *report(result, folder)])
    return 0


def tell_files(files: list[Path]) -> None:
    """Print the names of the files written."""
    print("\nfiles: " + ", ".join(map(str, files[:4])) + (" ..." if len(files) > 4 else ""))
