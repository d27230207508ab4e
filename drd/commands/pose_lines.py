"""`drd watch --json`: each pose as one line of JSON, for pipes."""

import json
import math
import select
import sys
import threading
import time
from collections import deque
from typing import Any, Final

import zenoh

from drd.output.messages import encode

# Poses queued for a slow reader: about 25 s of them. When full, the oldest are dropped, which `sequence` shows.
_WAITING: Final = 512
# How soon the end of the time or of the pipe is noticed while no pose arrives.
_LOOK_S: Final = 0.2


def print_poses(session: Any, prefix: str, seconds: float, most: float = math.inf) -> int:
    """Print each pose received within `seconds`, up to `most`; return how many.

    Raises BrokenPipeError as soon as the reader of standard output has gone. Messages that are not JSON objects are
    skipped, and counted on standard error at the end.
    """
    heard: deque[bytes] = deque(maxlen=_WAITING)
    arrived = threading.Event()

    def take(sample: Any) -> None:
        heard.append(sample.payload.to_bytes())
        arrived.set()

    subscriber = session.declare_subscriber(f"{prefix}/pose", zenoh.handlers.Callback(take, indirect=False))
    end_s, printed, unreadable = time.monotonic() + seconds, 0, 0
    while printed < most and (left_s := end_s - time.monotonic()) > 0:
        if not arrived.wait(min(left_s, _LOOK_S)):
            _look_at_pipe()
        arrived.clear()
        while heard and printed < most:
            line = pose_line(heard.popleft())
            if line is None:
                unreadable += 1
            else:
                print(line, flush=True)
                printed += 1
    subscriber.undeclare()
    if unreadable:
        print(f"drd watch: {unreadable} messages were no JSON objects", file=sys.stderr)
    return printed


def pose_line(payload: bytes) -> str | None:
    """A published pose as one line of strict JSON in ASCII; None: it is not a JSON object."""
    try:
        pose = json.loads(payload)
        return encode(pose).decode("ascii") if isinstance(pose, dict) else None
    except (ValueError, OverflowError, RecursionError):
        return None


def _look_at_pipe() -> None:
    """Raise BrokenPipeError where nobody reads standard output any more: without a pose, no write would fail."""
    try:
        watched = select.poll()
        watched.register(sys.stdout.fileno(), 0)
        if any(state & select.POLLERR for _, state in watched.poll(0)):
            raise BrokenPipeError
    except ValueError:  # standard output is not a file (in a test)
        return
