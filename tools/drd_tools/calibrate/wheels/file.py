"""Writer of wheels.yaml, a part of the daemon's configuration, with its provenance."""

from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from drd import __version__


def provenance(inputs: Iterable[str]) -> list[str]:
    """Comment lines: program, version, date, inputs with their hashes."""
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return [f"`drd calibrate wheels`, drd {__version__}, {now}", "from", *(f"  {text}" for text in inputs)]


def write_snippet(file: Path, sections: Mapping[str, Any], comments: Iterable[str]) -> None:
    """Write keys and values in their sections, to be merged into a configuration. Raises OSError.

    A value is a number or a word, or either with a comment.
    """
    lines = [f"# {comment}".rstrip() for comment in comments]
    file.write_text("\n".join([*lines, *_lines(sections, "")]) + "\n", encoding="utf-8")


def _lines(section: Mapping[str, Any], indent: str) -> Iterator[str]:
    for name, value in section.items():
        if isinstance(value, Mapping):
            if value:
                yield f"{indent}{name}:"
                yield from _lines(value, indent + "  ")
            continue
        number, comment = value if isinstance(value, tuple) else (value, "")
        yield f"{indent}{name}: {plain(number)}" + (f"  # {comment}" if comment else "")


def plain(number: float | str) -> str:
    """Format a number with ten digits and no exponent, since other YAML readers read 5e-05 as text; keep a word."""
    if isinstance(number, str):
        return number
    return str(np.format_float_positional(number, precision=10, fractional=False, trim="0"))
