"""wheels.yaml: a piece of the daemon's configuration, with where its numbers come from."""

from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from drd import __version__


def provenance(inputs: Iterable[str]) -> list[str]:
    """Comment lines: program, version, date, inputs with their hashes."""
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return [f"`drd calibrate wheels`, drd {__version__}, {now}", "from", *(f"  {text}" for text in inputs)]


def write_snippet(
    file: Path,
    robot: dict[str, float],
    initial: dict[str, float],
    comments: Iterable[str],
) -> None:
    """Write the sections `robot` and `estimation: initial`, to be merged into a configuration. Raises OSError."""
    lines = [f"# {comment}".rstrip() for comment in comments]
    lines += ["robot:", *(f"  {name}: {value:.6g}" for name, value in robot.items())]
    lines += ["estimation:", "  initial:", *(f"    {name}: {value:.2g}" for name, value in initial.items())]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
