"""The bound of the recording that poses come from, where it can be found."""

import json
from pathlib import Path

from drd.config.schema import ConfigError
from drd_tools.limit.limit import Limit, limit_of
from drd_tools.recordings.daemon_log import read


def limit_for(path: Path, reference_path: Path) -> Limit | None:
    """The bound of the recording itself, of that which the JSON beside POSES.csv names, or of the reference's folder.

    None where none of them is a recording from which poses can be made.
    """
    for candidate in (path, _named_beside(path), reference_path):
        if candidate is None or not (candidate.is_dir() or candidate.suffix == ".mcap"):
            continue
        try:
            return limit_of(read(candidate))
        except ConfigError:
            continue  # its files are judged where they are needed
    return None


def _named_beside(poses: Path) -> Path | None:
    """The recording that `drd replay` made the poses from."""
    try:
        content = json.loads(poses.with_suffix(".json").read_text(encoding="utf-8"))
        name = content["recording"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return Path(name) if isinstance(name, str) and Path(name).exists() else None
