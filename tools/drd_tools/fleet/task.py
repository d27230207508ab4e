"""The task that a worker is given, and the form in which it answers."""

from functools import cache
from typing import Any, Final, NamedTuple

from drd_tools.build import fingerprint
from drd_tools.fleet.discover import Seen
from drd_tools.fleet.labels import Labels, as_text

FAILED: Final = "failed"  # in place of a verdict
NO_LABELS: Final = Labels()
Rows = dict[str, list[dict[str, Any]]]  # by table
# What a recording's rows depend on.
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
    """Hash of the code that a recording's rows depend on."""
    return fingerprint(*CODE)


class Task(NamedTuple):
    """A recording to be analysed: its name in the store, the build that is asked for, and its digest there, if any."""

    seen: Seen
    recording: str
    build: str
    digest: str = ""


def failed(task: Task, error: str, digest: str = "", own: Labels = NO_LABELS) -> Rows:
    """Rows of a recording that could not be analysed. Without a digest it is tried again by the next update."""
    row = about(task, task.recording, digest, own)
    return {
        "recordings": [{**row, "verdict": FAILED, "error": error}],
        "errors": [{"recording": task.recording, "uri": task.seen.uri, "error": error}],
    }


def about(task: Task, name: str, digest: str, own: Labels) -> dict[str, Any]:
    """The columns that say whose row it is: of every recording, and of each part of a long one."""
    return {
        "recording": name,
        "uri": task.seen.uri,
        "digest": digest,
        "build": task.build,
        "signature": task.seen.signature,
        "own": as_text(own),
    }
