"""The recordings' folder: names of a run's parts, and the limit on their total size."""

import logging
import re
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from drd.config.file import file_name
from drd.units import NS_PER_S

log = logging.getLogger(__name__)


def run_name(robot: str, started_wall_ns: int, run: str) -> str:
    """Common prefix of the names of a run's parts: robot, start in UTC, the run's random digits."""
    start = datetime.fromtimestamp(started_wall_ns // NS_PER_S, UTC)
    return f"{file_name(robot)}-{start:%Y%m%dT%H%M%SZ}-{run}"


def part_file(folder: Path, name: str, part: int) -> Path:
    """The file of one part; parts count from 1."""
    return folder / f"{name}-{part:04}.mcap"


def make_room(folder: Path, robot: str, name: str, limit_bytes: int) -> None:
    """Delete this robot's oldest recordings until the rest takes at most `limit_bytes`. Raises OSError.

    The parts of the current run, `name`, count as the newest, in order: the clock may not be set yet.
    """
    pattern = re.compile(re.escape(file_name(robot)) + r"-\d{8}T\d{6}Z-[0-9a-f]{8}-\d{4,}\.mcap")
    files = []
    for entry in folder.iterdir():
        if pattern.fullmatch(entry.name):
            with suppress(FileNotFoundError):  # somebody else may delete it at the same time
                status = entry.stat()
                is_own = entry.name.startswith(f"{name}-")
                age = (is_own, 0 if is_own else status.st_mtime_ns, len(entry.name), entry.name)
                files.append((age, status.st_size, entry))
    total = sum(size for _, size, _ in files)
    for _, size, entry in sorted(files):
        if total <= limit_bytes:
            return
        entry.unlink(missing_ok=True)
        total -= size
        log.info("deleted=%s reason=recording.max_total_mb", entry)
