"""The state file: read at the start, replaced by a separate thread, so that no disk holds up the event loop."""

import logging
import os
import re
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from drd.config.file import file_name, in_state_directory
from drd.config.keys import Config
from drd.state.saved import LARGEST_BYTES
from drd.state.sealed import StateError
from drd.units import NS_PER_S

T = TypeVar("T")
log = logging.getLogger(__name__)

# Number of refused files that are kept; the oldest are deleted first.
KEPT_ASIDE: Final = 5
# A disk that has not taken a state for so long is reported.
SLOW_NS: Final = 10 * NS_PER_S


def state_file(config: Config) -> Path | None:
    """Path of a robot's state; None: it is not to be kept, or neither configuration nor systemd names a folder."""
    folder = config.state.folder
    if not config.state.enabled or (folder is None and not os.environ.get("STATE_DIRECTORY")):
        return None
    return in_state_directory(folder or "") / f"{file_name(config.robot.name)}.state"


class Store(Generic[T]):
    """Keeps the newest state in `file`, as `encode` writes it and `decode` reads it, which may raise StateError.

    `health` reports trouble; only `load` raises. At most one state waits: a newer one replaces it (`superseded`). Each
    is written to a second file, which is then renamed, and synced before and after: a power cut leaves the old state
    or the new one.
    """

    def __init__(self, file: Path, encode: Callable[[T], bytes], decode: Callable[[bytes], T]):
        self.file, self._encode, self._decode = file, encode, decode
        self.counters = dict.fromkeys(("written", "superseded", "errors", "unfit", "refused"), 0)
        self._trouble: str | None = None
        self._may_write = True
        self._slot: T | None = None
        self._since_ns: int | None = None  # since when a state has been waiting or being written
        self._lock = threading.Lock()
        self._due = threading.Event()
        self._stopping = False
        self._thread = threading.Thread(target=self._work, name="drd state", daemon=True)

    def load(self) -> T | None:
        """The stored state; None if there is none. An unusable file is put aside.

        Raises StateError then, with the file and the reason.
        """
        try:
            with self.file.open("rb") as stream:
                data = stream.read(LARGEST_BYTES + 1)
            if len(data) > LARGEST_BYTES:
                raise StateError(f"more than {LARGEST_BYTES} bytes")
            return self._decode(data)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise StateError(f"{self.file}: {error.strerror}; {self._put_aside()}") from error
        except StateError as error:
            raise StateError(f"{self.file}: {error}; {self._put_aside()}") from error

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def put(self, saved: T) -> None:
        """Queue this state for writing; takes microseconds."""
        with self._lock:
            self.counters["superseded"] += self._slot is not None
            self._slot = saved
            self._since_ns = self._since_ns or time.monotonic_ns()
        self._due.set()

    def close(self, deadline_s: float) -> bool:
        """Write what is waiting and end; False if the disk did not take it in time."""
        self._stopping = True
        self._due.set()
        self._thread.join(deadline_s)
        return not self._thread.is_alive()

    @property
    def trouble(self) -> str | None:
        """Why the newest state may not be on the disk; None: all is well."""
        since_ns = self._since_ns
        if since_ns is not None and time.monotonic_ns() - since_ns > SLOW_NS:
            return f"{self.file}: the disk has not taken it for {(time.monotonic_ns() - since_ns) // NS_PER_S} s"
        return self._trouble

    def health(self) -> dict[str, Any]:
        """File, trouble and counters."""
        return {"file": str(self.file), "trouble": self.trouble, **self.counters}

    def _put_aside(self) -> str:
        """Rename the refused file, and say so. One that cannot be moved is left, and never replaced."""
        self.counters["refused"] += 1
        pattern = re.compile(re.escape(self.file.name) + r"\.refused-(\d{1,9})")
        try:
            found = sorted((int(m[1]), f) for f in self.file.parent.iterdir() if (m := pattern.fullmatch(f.name)))
            aside = self.file.with_name(f"{self.file.name}.refused-{found[-1][0] + 1 if found else 1}")
            self.file.rename(aside)
            for _, old in found[: max(0, len(found) + 1 - KEPT_ASIDE)]:
                old.unlink(missing_ok=True)
        except OSError as error:
            self._may_write = False
            self._trouble = f"{self.file}: cannot be moved aside: {error.strerror}; no state is kept"
            return f"cannot be moved aside: {error.strerror}; no state is kept"
        return f"kept as {aside.name}"

    def _work(self) -> None:
        while not self._stopping:
            self._due.wait()
            self._due.clear()
            self._write_waiting()
        self._write_waiting()

    def _write_waiting(self) -> None:
        with self._lock:
            saved, self._slot = self._slot, None
            if saved is None:
                return
        try:
            if self._may_write:
                replace_file(self.file, self._encode(saved))
                self._tell(None)
                self.counters["written"] += 1
        except ValueError as error:
            self._tell(f"not written: {error}")
            self.counters["unfit"] += 1
        except OSError as error:
            self._tell(f"{self.file}: {error.strerror}")
            self.counters["errors"] += 1
        with self._lock:
            self._since_ns = None if self._slot is None else time.monotonic_ns()

    def _tell(self, trouble: str | None) -> None:
        if trouble != self._trouble:
            log.log(logging.WARNING if trouble else logging.INFO, "state=%s", trouble or "written again")
        self._trouble = trouble


def replace_file(file: Path, data: bytes, mode: int | None = None) -> None:
    """Replace `file` entirely or not at all, and wait for the disk; `mode`: permissions. Raises OSError."""
    file.parent.mkdir(parents=True, exist_ok=True)
    beside = file.with_name(f".{file.name}.new")
    try:
        with beside.open("wb") as stream:
            if mode is not None:
                os.fchmod(stream.fileno(), mode)
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        beside.rename(file)
    except OSError:
        with suppress(OSError):
            beside.unlink()
        raise
    folder = os.open(file.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
