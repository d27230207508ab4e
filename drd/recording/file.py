"""One MCAP file that at any moment is readable up to its last flush."""

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from mcap.writer import LIBRARY_IDENTIFIER, Writer

from drd import __version__
from drd.recording.topics import CHANNELS, Message

# A chunk ends at a flush or at this size, whichever is first.
CHUNK_BYTES: Final = 64 * 1024


class _Sink:
    """Output of the MCAP writer: kept in memory, and appended to the file by `flush`, entirely or not at all."""

    def __init__(self, path: Path):
        self.size = 0
        self._pending = bytearray()
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)

    def write(self, data: bytes) -> int:
        self._pending += data
        return len(data)

    def tell(self) -> int:
        return self.size + len(self._pending)

    def flush(self) -> None:
        data, self._pending = bytes(self._pending), bytearray()
        written = 0
        try:
            while written < len(data):
                written += os.write(self._fd, data[written:] if written else data)
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._fd, self.size)
            raise
        self.size += written

    def sync(self) -> None:
        os.fdatasync(self._fd)

    def close(self) -> None:
        os.close(self._fd)


class RecordingFile:
    """A new file at `path` with its attachments and the metadata `drd`. Every method raises OSError.

    After an OSError only `abandon` may be called; the file then contains all that was flushed before.
    """

    def __init__(self, path: Path, information: Mapping[str, str], attachments: Mapping[str, bytes], wall_ns: int):
        self.path = path
        self._sink = _Sink(path)
        self._start_bytes: int | None = None  # size of the file without messages
        # Only partly typed.
        self._writer: Any = Writer(self._sink, chunk_size=CHUNK_BYTES)  # type: ignore[arg-type]
        try:
            self._begin(information, attachments, wall_ns)
        except OSError:
            self.abandon()
            raise
        self._start_bytes = self.size

    def _begin(self, information: Mapping[str, str], attachments: Mapping[str, bytes], wall_ns: int) -> None:
        self._writer.start(library=f"drd {__version__}, {LIBRARY_IDENTIFIER}")
        self._writer.add_metadata("drd", dict(information))
        for name, data in attachments.items():
            self._writer.add_attachment(wall_ns, wall_ns, name, "text/plain", data)
        self._channels = {}
        for c in CHANNELS:
            schema = self._writer.register_schema(c.schema_name, c.schema_encoding, c.schema)
            self._channels[c.topic] = self._writer.register_channel(c.topic, c.encoding, schema)
        self.flush()
        self.sync()
        folder = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)  # so that the name, too, survives a power cut
        finally:
            os.close(folder)

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._sink.size

    @property
    def pending(self) -> int:
        """Bytes of whole chunks that the next flush appends."""
        return self._sink.tell() - self._sink.size

    def add(self, message: Message, number: int, log_ns: int, publish_ns: int) -> None:
        """Append a message; times are wall-clock ns."""
        self._writer.add_message(
            self._channels[message.topic], log_ns, message.data, publish_ns, sequence=number & 0xFFFFFFFF
        )

    def flush(self) -> None:
        """Hand everything to the operating system, so that it survives the end of this process."""
        self._writer.flush()

    def sync(self) -> None:
        """Wait until all flushed data are on the disk, so that they survive a power cut."""
        self._sink.sync()

    def finish(self, end: Mapping[str, str]) -> None:
        """Write the rest, then the metadata `drd.end` and the index, and close."""
        self.flush()
        self._writer.add_metadata("drd.end", dict(end))
        self._writer.finish()
        self._sink.flush()
        self._sink.sync()
        self._sink.close()

    def abandon(self) -> bool:
        """Close without `drd.end`. True: no message was flushed, so the file is deleted. Never raises."""
        is_empty = self._start_bytes is None or self.size <= self._start_bytes
        with suppress(OSError):
            self._sink.close()
            if is_empty:
                self.path.unlink()
        return is_empty
