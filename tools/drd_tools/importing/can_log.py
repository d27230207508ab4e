"""CAN logs (candump, ASC, BLF, TRC, CSV, SQLite), decoded by the daemon's own layouts."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np
from tqdm import tqdm

from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.robot import longest_gap_s
from drd.config.schema import ConfigError
from drd.encoders.stream import UNCOUNTED_RESOLUTION_M, EncoderStream
from drd.samples import CanFrame, WheelSample
from drd.units import NS_PER_S, S_PER_NS
from drd_tools.importing.can_formats import messages
from drd_tools.importing.streams import Origin, Source, Wheels
from drd_tools.report.terminal import columns


class CanLog(Source):
    """A log of frames; `config` describes their layout and the robot. Raises ConfigError.

    `name`: the format, as returned by can_formats.format_of.
    """

    def __init__(self, path: Path, name: str, config: Path | None, channel: str | None):
        self.path, self._format, self._file, self._channel = path, name, config, channel

    def listing(self) -> list[str]:
        """Table of identifiers, with their rates and the bytes that change."""
        count: Counter[tuple[str, int, bool]] = Counter()
        first: dict[tuple[str, int, bool], bytes] = {}
        changed: dict[tuple[str, int, bool], set[int]] = {}
        begin, end = None, 0
        for channel, frame in self._frames():
            name = (channel, frame.can_id, frame.extended)
            count[name] += 1
            before = first.setdefault(name, frame.data)
            changed.setdefault(name, set()).update(
                k for k, b in enumerate(frame.data) if before[k : k + 1] != bytes([b])
            )
            begin, end = frame.t_ns if begin is None else begin, frame.t_ns
        if begin is None:
            raise ConfigError(str(self.path), "", "a log with data frames", "none")
        seconds = (end - begin) / NS_PER_S
        rows = [["channel", "id", "frames", "Hz", "bytes", "that change"]]
        for (channel, can_id, extended), n in sorted(count.items()):
            rate = f"{n / seconds:.1f}" if seconds > 0.0 else "-"
            name = (channel, can_id, extended)
            moving = ",".join(map(str, sorted(changed[name]))) or "none"
            text = f"{can_id:08X}" if extended else f"{can_id:03X}"
            rows.append([channel, text, str(n), rate, str(len(first[name])), moving])
        words = f"drd import {self.path} --config CONFIG --wheels can --output DIR"
        return [f"{self.path}: {count.total()} frames, {seconds:.1f} s", *columns(rows, (0, 5), ""), "",
                "CONFIG is a configuration of the daemon whose `encoders` and `robot` describe these frames:",
                f"  {words}"]  # fmt: skip

    def wheels(self, name: str) -> tuple[Wheels, Origin]:
        """The daemon's wheel samples as cumulative travel in m, paired in time, with wraps and losses handled."""
        if name != "can":
            raise ConfigError("command line", "--wheels", "can, for a CAN log", repr(name))
        config, base = self._config()
        stream = EncoderStream(config.encoders, config.robot, base)
        samples: list[WheelSample] = []
        for _, frame in self._frames():
            samples += stream.feed(frame)
        if not samples:
            seen = ", ".join(f"{n} {value}" for n, value in stream.counters.items() if value)
            ids = ", ".join(f"{can_id:X}" for can_id, _ in stream.can_ids)
            raise ConfigError(str(self.path), "--wheels", f"frames of {ids} that make wheel samples", seen or "none")
        origin = Origin("can", f"{config.encoders.layout}, decoded with {self._file}", "the frames' own")
        told = ", ".join(f"{n} {value}" for n, value in stream.counters.items() if value)
        origin.notes.append(f"decoded as by the daemon: {told}")
        return _travel(samples, stream.resolution_m, origin), origin

    def _config(self) -> tuple[Config, Path]:
        if self._file is None:
            raise ConfigError("command line", "--config", "a configuration that describes the frames", "nothing")
        config = load_config(self._file).value
        # Counts stay raw: a calibration's factors are applied when the recording is replayed.
        return replace(config, robot=replace(config.robot, left_scale=1.0, right_scale=1.0)), self._file.parent

    def _frames(self) -> Iterator[tuple[str, CanFrame]]:
        """Data frames with the channel's name."""
        try:
            with messages(self.path, self._format) as reader:
                for message in tqdm(reader, "frames", unit=" frames", disable=None, leave=False, delay=1.0):
                    if message.is_error_frame or message.is_remote_frame or not message.is_rx:
                        continue
                    channel = "" if message.channel is None else str(message.channel)
                    if self._channel is not None and channel != self._channel:
                        continue
                    whole = int(message.timestamp)
                    t_ns = whole * NS_PER_S + round((message.timestamp - whole) * NS_PER_S)
                    data = bytes(message.data)
                    yield channel, CanFrame(t_ns, message.arbitration_id, message.is_extended_id, data)
        except ConfigError:
            raise
        except Exception as error:  # the parsers may raise anything
            got = f"{type(error).__name__}: {error}"
            raise ConfigError(str(self.path), "", f"a CAN log ({self._format}) that can be read", got) from error


def _travel(samples: list[WheelSample], resolution_m: float, origin: Origin) -> Wheels:
    """Compute cumulative travel in m at both ends of each sample. Time lost before a sample remains a gap between rows
    if it is too long to be filled.
    """
    usual_s = median(sample.interval_s for sample in samples)
    rows: list[tuple[int, float, float]] = []
    left_m = right_m = 0.0
    lost = filled = 0
    for before, sample in zip([samples[0], *samples], samples, strict=False):
        begin_ns = sample.t_ns - round(sample.interval_s * NS_PER_S)
        if not rows:
            rows.append((begin_ns, left_m, right_m))
        elif begin_ns > rows[-1][0] + 1000:  # 1 us: rounding of the interval
            hole_s = (begin_ns - rows[-1][0]) * S_PER_NS
            if hole_s <= longest_gap_s(1.0 / usual_s):  # readers would not notice the gap, and assume a standstill
                filled += 1
                # Frames delivered in a burst have a whole period's travel each, in almost no time.
                part = hole_s / max(before.interval_s + sample.interval_s, 2.0 * usual_s)
                left_m += part * (before.left_m + sample.left_m)
                right_m += part * (before.right_m + sample.right_m)
            else:
                lost += 1
            rows.append((begin_ns, left_m, right_m))
        left_m, right_m = left_m + sample.left_m, right_m + sample.right_m
        rows.append((sample.t_ns, left_m, right_m))
    if filled:
        told = "is taken at the mean speed of just before and after"
        origin.notes.append(f"{filled} times the travel is not known for a moment; it {told}")
    if lost:
        origin.notes.append(f"{lost} times the travel is not known for a while; it is missing, not guessed")
    time_ns = np.array([row[0] for row in rows], dtype=np.int64)
    left, right = (np.array([row[k] for row in rows]) for k in (1, 2))
    if resolution_m != UNCOUNTED_RESOLUTION_M:
        origin.notes.append(f"one count is {resolution_m * 1e3:.6g} mm; counts begin at 0")
        counts = np.round(left / resolution_m), np.round(right / resolution_m)
        return Wheels(time_ns, *counts, "counts", count_m=resolution_m)
    return Wheels(time_ns, left, right, "m")
