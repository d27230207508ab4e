"""Take data from the daemon without ever waiting, and write them in a separate thread."""

import logging
import secrets
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from drd import __version__
from drd.config.file import in_state_directory
from drd.config.keys import Config
from drd.config.schema import Loaded
from drd.pipeline import Observer
from drd.recording.file import CHUNK_BYTES, RecordingFile
from drd.recording.folder import make_room, part_file, run_name
from drd.recording.in_force import files_in_force
from drd.recording.topics import Encoder
from drd.samples import CanFrame, GyroSample, Pose, WheelSample
from drd.units import NS_PER_S, S_PER_NS

log = logging.getLogger(__name__)

# Some 20 s of a 1000 Hz gyro with its decoded samples, a minute and more of a slow one.
QUEUE_ENTRIES: Final = 50_000
DRAIN_S: Final = 0.1
# The interpreter is released after this many entries: encoding must not hold up the event loop.
SLICE_ENTRIES: Final = 8
SLICE_PAUSE_S: Final = 0.0002
RETRY_NS: Final = 5 * NS_PER_S
BYTES_PER_MB: Final = 1_000_000
# A file ends a little early, so that the next flush and the index still fit.
FULL_PART: Final = 0.9


class _Entry(NamedTuple):
    """Something to record: its number, the time it was handed over (CLOCK_MONOTONIC), and its content."""

    number: int
    put_ns: int
    kind: str
    arguments: tuple[Any, ...]


class HandedOver(Observer, ABC):
    """Receives all data that a run hands over, as one entry each."""

    def fog_bytes(self, data: bytes, arrival_ns: int) -> None:
        """Bytes from the gyro's port."""
        self._put("fog_bytes", data, arrival_ns)

    def frames(self, frames: Sequence[CanFrame]) -> None:
        """A batch of frames from the bus."""
        if frames:
            self._put("frames", tuple(frames))

    def event(self, name: str, now_ns: int, **values: Any) -> None:
        """A tick, a port's state or a command, with its arguments."""
        self._put("event", name, now_ns, values)

    def gyro(self, sample: GyroSample) -> None:
        """A decoded gyro sample."""
        self._put("gyro", sample)

    def wheels(self, sample: WheelSample) -> None:
        """A decoded wheel sample."""
        self._put("wheels", sample)

    def pose(self, pose: Pose, wall_ns: int) -> None:
        """A pose as published."""
        self._put("pose", pose, wall_ns)

    def health_report(self, health: Mapping[str, Any]) -> None:
        """The health as published."""
        self._put("health", health)

    def findings_report(self, findings: Mapping[str, Any]) -> None:
        """The findings as published."""
        self._put("findings", findings)

    @abstractmethod
    def _put(self, kind: str, *arguments: Any) -> None:
        """Take an entry; `kind` and its arguments: see topics.Encoder."""


class Recorder(HandedOver):
    """Records one run, in one or more files. `health` reports trouble with the disk; nothing raises after `start`.

    Data must not be changed after being handed over. The methods that take them are called from one thread, the
    event loop's, and take about a microsecond; if the writer is too far behind, new data are lost and counted.
    The constructor reads the files in force and raises ConfigError.
    """

    def __init__(self, loaded: Loaded[Config], base: Path):
        config = loaded.value
        self._settings, self._robot = config.recording, config.robot.name
        self._attachments = files_in_force(loaded, base)
        self._encoder = Encoder(config.output, config.recording.viewers)
        self._started_ns, self._started_wall_ns = time.monotonic_ns(), time.time_ns()
        self._run = secrets.token_hex(4)
        self._folder = in_state_directory(config.recording.folder)
        self._name = run_name(self._robot, self._started_wall_ns, self._run)
        self._queue: deque[_Entry] = deque()
        self._number = self._overflowed = 0  # written by the event loop only
        self._written = self._unflushed = self._unwritten = self._last_number = 0  # written by the thread only
        self._trouble: str | None = None
        self._file: RecordingFile | None = None
        self._part = 0
        self._opened_ns = self._flushed_ns = self._synced_ns = self._retry_ns = 0
        self._full_bytes = 0.0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._work, name="drd recorder", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def close(self, deadline_s: float) -> bool:
        """Write all waiting entries and end the file; False if the disk did not take them in time."""
        self._stopping.set()
        self._thread.join(deadline_s)
        return not self._thread.is_alive()

    def _put(self, kind: str, *arguments: Any) -> None:
        self._number += 1
        if len(self._queue) < QUEUE_ENTRIES:
            self._queue.append(_Entry(self._number, time.monotonic_ns(), kind, arguments))
        else:
            self._overflowed += 1

    # ---- what it says of itself ---------------------------------------------------------------------------------

    @property
    def trouble(self) -> str | None:
        """Fault of the recording; None: none. A loss is reported until the run's end."""
        lost = self.lost
        texts = [self._trouble] if self._trouble else []
        return "; ".join(texts + ([f"{lost} entries lost"] if lost else [])) or None

    @property
    def lost(self) -> int:
        """Number of entries that are in no file."""
        return self._overflowed + self._unwritten

    def health(self) -> dict[str, Any]:
        """State, file, and counts of entries: handed over, written, waiting and lost."""
        file, trouble = self._file, self.trouble
        return {
            "state": "degraded" if trouble else "recording",
            "reason": trouble,
            "file": str(file.path) if file is not None else None,
            "file_bytes": file.size if file is not None else None,
            "written": self._written,
            "waiting": len(self._queue),
            "lost": self.lost,
        }

    # ---- the thread ---------------------------------------------------------------------------------------------

    def _work(self) -> None:
        while not self._stopping.wait(DRAIN_S):
            self._turn(self._drain)
        self._turn(self._drain)
        self._turn(self._end)

    def _turn(self, action: Any) -> None:
        """Do one action; a failure ends the file, and a new one is tried later."""
        try:
            action()
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        text = (error.strerror if isinstance(error, OSError) else None) or repr(error)
        where = self._file.path if self._file is not None else self._folder
        if not isinstance(error, OSError):
            log.exception("recording=%s: a bug", where)
        elif self._trouble is None:
            log.warning("recording=%s failed=%s", where, text)
        self._trouble = f"{where}: {text}"
        self._retry_ns = time.monotonic_ns() + RETRY_NS
        self._unwritten += self._unflushed
        self._written -= self._unflushed
        self._unflushed = 0
        if self._file is not None:
            self._part -= self._file.abandon()
            self._file = None

    def _drain(self) -> None:
        for i in range(len(self._queue)):
            entry = self._queue.popleft()
            try:
                kept = self._write(entry)
            except Exception:
                self._unwritten += 1
                raise
            self._unwritten += not kept
            if i % SLICE_ENTRIES == SLICE_ENTRIES - 1:
                if not self._stopping.is_set():
                    time.sleep(SLICE_PAUSE_S)
                self._keep(time.monotonic_ns())
        self._keep(time.monotonic_ns())

    def _write(self, entry: _Entry) -> bool:
        """Write an entry; False if there is no file to write to for now."""
        if self._file is None and not self._open(time.monotonic_ns()):
            return False
        assert self._file is not None
        log_ns = self._wall_ns(entry.put_ns)
        for message in self._encoder.by_kind[entry.kind](*entry.arguments):
            self._file.add(message, entry.number, log_ns, self._wall_ns(message.t_ns))
        self._written += 1
        self._unflushed += 1
        self._last_number = entry.number
        return True

    def _wall_ns(self, monotonic_ns: int) -> int:
        """Wall-clock time that never steps, since both clocks are read together only at the start."""
        return max(0, self._started_wall_ns + monotonic_ns - self._started_ns)

    def _open(self, now_ns: int) -> bool:
        """Open the run's next part; False while a failure is too recent to try again."""
        if now_ns < self._retry_ns:
            return False
        settings = self._settings
        self._folder.mkdir(parents=True, exist_ok=True)
        # At least two files, else making room would leave only the newest.
        self._full_bytes = min(settings.max_file_mb, settings.max_total_mb / 2) * BYTES_PER_MB
        limit_bytes = round(settings.max_total_mb * BYTES_PER_MB - self._full_bytes)
        make_room(self._folder, self._robot, self._name, limit_bytes)
        path = part_file(self._folder, self._name, self._part + 1)
        self._file = RecordingFile(path, self._information(), self._attachments, self._wall_ns(now_ns))
        self._part += 1
        self._opened_ns = self._flushed_ns = self._synced_ns = time.monotonic_ns()
        self._trouble = None
        log.info("recording=%s", path)
        return True

    def _information(self) -> dict[str, str]:
        values = {
            "version": __version__,
            "robot": self._robot,
            "run": self._run,
            "part": self._part + 1,
            "started_wall_ns": self._started_wall_ns,
            "started_monotonic_ns": self._started_ns,
            "flush_s": self._settings.flush_s,
            "fsync_s": self._settings.fsync_s,
            "lost_before": self.lost,
        }
        return {name: str(value) for name, value in values.items()}

    def _keep(self, now_ns: int) -> None:
        """Flush, wait for the disk and change the file when due."""
        file, settings = self._file, self._settings
        if file is None:
            return
        is_full = file.size + file.pending + CHUNK_BYTES > FULL_PART * self._full_bytes  # one chunk is being filled
        next_ns = now_ns + DRAIN_S * NS_PER_S
        is_due = next_ns - self._flushed_ns >= settings.flush_s * NS_PER_S
        sync_is_due = next_ns - self._synced_ns >= settings.fsync_s * NS_PER_S
        if not (is_full or is_due or sync_is_due):
            return
        file.flush()
        self._unflushed, self._flushed_ns = 0, now_ns
        if sync_is_due:
            file.sync()
            self._synced_ns = now_ns
        if is_full or (now_ns - self._opened_ns) * S_PER_NS > settings.max_file_age_s:
            self._end("continued")

    def _end(self, reason: str = "stopped") -> None:
        """End the file properly."""
        if self._file is not None:
            self._file.flush()
            self._unflushed = 0
            self._file.finish({"reason": reason, "lost": str(self.lost), "last_entry": str(self._last_number)})
            self._file = None
