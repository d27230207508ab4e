"""Task of a worker, and the form of its answer."""

from functools import cache
from typing import Any, Final, NamedTuple

from drd_tools.build import fingerprint
from drd_tools.fleet.discover import Seen
from drd_tools.fleet.labels import Labels, as_text

FAILED: Final = "failed"  # in place of a verdict
NO_LABELS: Final = Labels()
Rows = dict[str, list[dict[str, Any]]]  # by table
# Code on which a recording's rows depend.
CODE: Final = (
    "drd.batch",
    "drd.effects",
    "drd.estimation",
    "drd_tools.calibrate",
    "drd_tools.diagnose",
    "drd_tools.evaluate",
    "drd_tools.limit",
    "drd_tools.recordings",
    "drd_tools.replay",
    "drd_tools.fleet.analysis",
    "drd_tools.fleet.labels",
    "drd_tools.fleet.products",
    "drd_tools.fleet.task",
)


@cache
def build() -> str:
    """Hash of the code on which a recording's rows depend."""
    return fingerprint(*CODE)


class Task(NamedTuple):
    """A recording to analyse: its name in the store, the build required, and its digest there, if any."""

    seen: Seen
    recording: str
    build: str
    digest: str = ""


def failed(task: Task, error: str, digest: str = "", own: Labels = NO_LABELS) -> Rows:
    """Rows of a recording that could not be analysed. Without a digest the next update tries it again."""
    row = about(task, task.recording, digest, own)
    return {
        "recordings": [{**row, "verdict": FAILED, "error": error}],
        "errors": [{"recording": task.recording, "uri": task.seen.uri, "error": error}],
    }


def about(task: Task, name: str, digest: str, own: Labels) -> dict[str, Any]:
    """Columns that identify a recording, or a part of a long one."""
    return {
        "recording": name,
        "uri": task.seen.uri,
        "digest": digest,
        "build": task.build,
        "signature": task.seen.signature,
        "own": as_text(own),
    }
