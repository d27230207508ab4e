"""A fleet for tests of its engine and its store: tiny files, and calls that are quick, fail, or kill their process."""

import os
import signal
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from drd_tools.fleet.discover import contents
from drd_tools.fleet.task import Rows, Task, failed

START = datetime(2026, 3, 12, tzinfo=UTC)


def recording(folder: Path, text: str = "1") -> Path:
    """A folder that looks like a recording."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "fog.csv").write_text(text)
    return folder


def fleet(folder: Path, count: int) -> Path:
    """Recordings that differ."""
    for i in range(count):
        recording(folder / f"run_{i:03}", str(i))
    return folder


def rows(name: str, uri: str, value: float, **more: Any) -> Rows:
    """Some rows of each table."""
    about: dict[str, Any] = {
        "recording": name,
        "uri": uri,
        "digest": "d",
        "build": "b",
        "signature": "s",
        "own": '{"robot":"r","start":"2026-03-12T00:00:00Z"}',
        "verdict": "nothing_missing",
        "robot": "r",
        "start_utc": START,
        **more,
    }
    return {
        "recordings": [about],
        "constants": [{**about, "name": n, "value": value, "sigma": 0.1} for n in ("tread", "lag_s")],
        "products": [{**about, "at": i, "effect": "e", "information": [value, 1.0], "shape": "{}"} for i in range(2)],
    }


def stubbed(task: Task) -> Rows | None:
    """Stand in for the analysis: a figure from the file's text; "fails" fails."""
    place = Path(task.seen.uri)
    digest = contents(place, task.seen)
    if digest == task.digest:
        return None
    text = (place / "fog.csv").read_text()
    if text == "fails":
        return failed(task, "ValueError: no number", digest)
    about = {"digest": digest, "build": task.build, "signature": task.seen.signature}
    return rows(task.recording, task.seen.uri, float(text) ** 0.5, **about)


def killing(task: Task) -> Rows | None:
    """Like `stubbed`, but the first process that gets run_002 is killed, and each that gets run_003."""
    marker = Path(task.seen.uri).parent / "killed"
    if task.recording == "run_002" and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if task.recording == "run_003":
        os.kill(os.getpid(), signal.SIGKILL)
    return stubbed(task)


def slow(task: Task) -> Rows | None:
    """Like `stubbed`, but takes half a second."""
    time.sleep(0.5)
    return stubbed(task)
