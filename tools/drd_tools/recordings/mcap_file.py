"""Reader of the daemon's recording (drd.recording), as far as it is readable, which also reports what is missing."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata
from mcap.stream_reader import get_chunk_data_stream

from drd.config.schema import ConfigError
from drd.recording.in_force import IN_FORCE
from drd.units import NS_PER_S, S_PER_NS

MAGIC: Final = b"\x89MCAP0\r\n"
# Opcode of a record, and length of its body.
RECORD: Final = struct.Struct("<BQ")
# Start of a message record: channel, sequence, log time, publish time.
MESSAGE: Final = struct.Struct("<HIQQ")
# Start of a chunk record: log times of its first and last message.
CHUNK_TIMES: Final = struct.Struct("<QQ")
OPCODES: Final = frozenset(Opcode)
MESSAGE_RECORD: Final = int(Opcode.MESSAGE)  # compared millions of times; the enumeration's own == is slow


class Recorded(NamedTuple):
    """One message. `number` counts the messages passed to the recorder, modulo 2^32; `log_ns` is wall-clock time."""

    number: int
    log_ns: int
    topic: str
    data: bytes

    def value(self) -> dict[str, Any]:
        """Decode the payload of a JSON topic. Raises ValueError if it is not an object."""
        try:
            found = msgspec.json.decode(self.data)
        except (msgspec.DecodeError, RecursionError) as error:
            raise ValueError(str(error)) from error
        if not isinstance(found, dict):
            raise ValueError("no object")
        return found


def nanoseconds(value: Any) -> int:
    """Check a time from a payload. Raises ValueError."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 63:
        raise ValueError(f"expected nanoseconds, got {value!r:.40}")
    return value


@dataclass
class McapFile:
    """Metadata of a recording, and the positions of its readable chunks. Made by `open_mcap`.

    `information` and `attachments` as the daemon wrote them. `end`: the metadata `drd.end`; None: the file was cut.
    `first_ns`, `last_ns`: log times of the readable messages, 0 if there are none. `cut_chunk_s`: time from `last_ns`
    to the last message of the chunk in which the file was cut, if the start of that chunk is readable.
    """

    path: Path
    information: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    end: dict[str, str] | None = None
    first_ns: int = 0
    last_ns: int = 0
    cut_chunk_s: float | None = None
    _chunks: list[tuple[int, int]] = field(default_factory=list)

    @property
    def is_cut(self) -> bool:
        """True if the file lacks the end that the daemon writes."""
        return self.end is None

    @property
    def part(self) -> int:
        """Number of the file's part in its run, from 1; also 1 if not stated."""
        part = self.information.get("part", "")
        return int(part) if part.isdecimal() else 1

    @property
    def seconds(self) -> float:
        """Time between the first and the last readable message."""
        return (self.last_ns - self.first_ns) * S_PER_NS

    @property
    def lost_if_killed_s(self) -> float | None:
        """Most time missing at the end if the daemon was killed; 0 if the file is complete."""
        return self._lost_s("flush_s")

    @property
    def lost_if_power_failed_s(self) -> float | None:
        """Most time missing at the end if the power failed; None if the file does not state its intervals."""
        return self._lost_s("fsync_s")

    def _lost_s(self, interval: str) -> float | None:
        if not self.is_cut:
            return 0.0
        try:
            least_s = float(self.information["flush_s"])
            return max(float(self.information[interval]), least_s) + (least_s if interval == "fsync_s" else 0.0)
        except (KeyError, ValueError):
            return None

    def sentence(self) -> str:
        """Sentence on how far the file is readable and what is missing."""
        if not self._chunks:
            reach = "no message can be read"
        else:
            until = datetime.fromtimestamp(self.last_ns * S_PER_NS, UTC)
            reach = f"{self.seconds:.1f} s can be read, until {until:%Y-%m-%d %H:%M:%S} UTC"
        if not self.is_cut:
            return f"complete: {reach}"
        text = f"cut: {reach}"
        if self.cut_chunk_s is not None:
            text += f"; {self.cut_chunk_s:.1f} s are lost in the piece that was cut"
        killed_s, power_s = self.lost_if_killed_s, self.lost_if_power_failed_s
        if killed_s is None or power_s is None:
            return f"{text}; how much is missing after that cannot be known"
        return (
            f"{text}; at most {killed_s:g} s are missing if the daemon was killed, {power_s:g} s if the power failed; "
            "if the file was cut later, while being copied, the loss is unknown"
        )

    def messages(self, *topics: str) -> Iterator[Recorded]:
        """All readable messages of these topics, or of all topics, in the order of recording."""
        names: dict[int, str] = {}
        with self.path.open("rb") as stream:
            for offset, length in self._chunks:
                stream.seek(offset)
                data = _chunk_data(stream.read(length))
                for opcode, start, end in _chunk_records(data):
                    if opcode == MESSAGE_RECORD:
                        channel, number, log_ns, _ = MESSAGE.unpack_from(data, start)
                        topic = names.get(channel, "")
                        if not topics or topic in topics:
                            yield Recorded(number, log_ns, topic, data[start + MESSAGE.size : end])
                    elif opcode == Opcode.CHANNEL:
                        found = Channel.read(ReadDataStream(BytesIO(data[start:end])))
                        names[found.id] = found.topic


def open_mcap(path: Path) -> McapFile:
    """Open a recording of the daemon, cut or not. Raises ConfigError if the file cannot be read at all.

    A file cut at any byte, or whose end was never written, is read up to its last complete chunk.
    """
    found = McapFile(path)
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            start = stream.read(len(MAGIC))
            if not MAGIC.startswith(start) and start.strip(b"\0"):
                raise ConfigError(str(path), "", "an MCAP file", f"one that begins with {start!r}")
            _scan(found, stream, size)
    except OSError as error:
        raise ConfigError(str(path), "", "a readable MCAP file", str(error.strerror)) from error
    return found


def _scan(found: McapFile, stream: BinaryIO, size: int) -> None:
    """Collect all readable records."""
    good = min(size, len(MAGIC))
    while good + RECORD.size <= size:
        stream.seek(good)
        opcode, length = (int(value) for value in RECORD.unpack(stream.read(RECORD.size)))
        start, end = good + RECORD.size, good + RECORD.size + length
        if opcode == Opcode.FOOTER and end <= size:
            break
        if opcode not in OPCODES or end > size:
            if opcode == Opcode.CHUNK and start + CHUNK_TIMES.size <= size:
                found.cut_chunk_s = _cut_chunk_s(found, *CHUNK_TIMES.unpack(stream.read(CHUNK_TIMES.size)))
            break
        try:
            _take(found, opcode, start, stream.read(length))
        except Exception:  # a damaged record: decompressors and parsers may raise anything
            break
        good = end


def _cut_chunk_s(found: McapFile, first_ns: int, last_ns: int) -> float | None:
    """Length in s of the cut chunk beyond the readable messages; None if its times are implausible."""
    begin_ns = found.last_ns or first_ns
    return (last_ns - begin_ns) * S_PER_NS if begin_ns <= last_ns < begin_ns + 3600 * NS_PER_S else None


def _take(found: McapFile, opcode: int, offset: int, body: bytes) -> None:
    """Process one complete record of the data section."""
    data = ReadDataStream(BytesIO(body))
    if opcode == Opcode.METADATA:
        metadata = Metadata.read(data)
        if metadata.name == "drd":
            found.information = dict(metadata.metadata)
        elif metadata.name == "drd.end":
            found.end = dict(metadata.metadata)
    elif opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(data)
        found.attachments[attachment.name] = attachment.data
    elif opcode == Opcode.CHUNK:
        chunk = _chunk_data(body)
        starts = [start for opcode, start, _ in _chunk_records(chunk) if opcode == MESSAGE_RECORD]
        if starts:
            _, _, first_ns, _ = MESSAGE.unpack_from(chunk, starts[0])
            _, _, found.last_ns, _ = MESSAGE.unpack_from(chunk, starts[-1])
            found.first_ns = found.first_ns or first_ns
        found._chunks.append((offset, len(body)))


def _chunk_data(body: bytes) -> bytes:
    """Decompress a chunk record and check its CRC. Raises what the parsers raise if it is damaged."""
    stream, size = get_chunk_data_stream(Chunk.read(ReadDataStream(BytesIO(body))), validate_crc=True)
    return bytes(stream.read(size))


def _chunk_records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of each record in a chunk. Raises ValueError or struct.error for a truncated one.

    The library's parsers, which make an object of each, take ten times as long.
    """
    at, size = 0, len(data)
    while at < size:
        opcode, length = RECORD.unpack_from(data, at)
        start, at = at + RECORD.size, at + RECORD.size + length
        if at > size or (opcode == MESSAGE_RECORD and length < MESSAGE.size):
            raise ValueError("a record that is cut")
        yield opcode, start, at


def parts_before(file: McapFile) -> tuple[list[Path], list[int]]:
    """Find the earlier parts of the same run beside `file`, in order, and the numbers of missing ones."""
    name, _, part = file.path.stem.rpartition("-")
    numbers = range(1, file.part)
    paths = {number: file.path.with_name(f"{name}-{number:0{len(part)}}.mcap") for number in numbers}
    missing = [number for number, path in paths.items() if not path.exists()]
    return [path for number, path in paths.items() if number not in missing], missing


class Run(NamedTuple):
    """A run of the daemon: its parts in order, the numbers of missing ones, and its start by both clocks, ns."""

    parts: list[McapFile]
    missing: list[int]
    started_ns: int
    wall_ns: int

    def notes(self) -> list[str]:
        """Sentences on parts that are cut or missing."""
        cut = [f"{part.path.name}: {part.sentence()}" for part in self.parts if part.is_cut]
        return cut + [f"part {number} of the run is not there" for number in self.missing]


def open_run(file: Path) -> Run:
    """Open a recording of `drd run`, with the earlier parts of its run in the same folder. Raises ConfigError."""
    last = open_mcap(file)
    if IN_FORCE not in last.attachments:
        raise ConfigError(str(file), "", f"a recording of drd, with the attachment {IN_FORCE}", "one without it")
    earlier, missing = parts_before(last)
    texts = (last.information.get(name, "") for name in ("started_monotonic_ns", "started_wall_ns"))
    started_ns, wall_ns = (int(text) if text.isdecimal() else 0 for text in texts)
    return Run([*map(open_mcap, earlier), last], missing, started_ns, wall_ns)
