"""Recorder of the real gyro, which uses the daemon's own port, parser and clock."""

import asyncio
import csv
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from drd.config.keys import Config, Fog
from drd.config.schema import ConfigError
from drd.fog.stream import FogStream
from drd.ports.serial_port import SerialPort
from drd.samples import GyroSample
from drd.units import DEG_PER_RAD, RAD_PER_DEG, S_PER_NS

# A gyro that sends nothing usable for this long is considered dead.
SILENCE_S: Final = 3.0
SILENCE_BEATS: Final = 5.0
POLL_S: Final = 0.1


@dataclass
class Progress:
    """Running totals of a recording; angles in degrees, for display. The temperature is NaN if none is sent."""

    samples: int = 0
    recorded_s: float = 0.0
    sum_deg: float = 0.0
    sum_squares: float = 0.0
    temperature_c: float = math.nan
    first_ns: int | None = None

    @property
    def mean_deg_s(self) -> float:
        """Mean rate; NaN before the first sample."""
        return self.sum_deg / self.samples if self.samples else math.nan

    @property
    def sigma_deg_s(self) -> float:
        """Standard deviation of the samples; NaN before the second."""
        if self.samples < 2:
            return math.nan
        spread = self.sum_squares / self.samples - self.mean_deg_s**2
        return math.sqrt(max(spread, 0.0) * self.samples / (self.samples - 1))

    def add(self, sample: GyroSample) -> float:
        """Add a sample; return its time since the first, s."""
        rate_deg_s = sample.rate_rad_s * DEG_PER_RAD
        if self.first_ns is None:
            self.first_ns = sample.t_ns
        self.samples += 1
        self.sum_deg += rate_deg_s
        self.sum_squares += rate_deg_s**2
        self.recorded_s = (sample.t_ns - self.first_ns) * S_PER_NS
        if not math.isnan(sample.temperature_c):
            self.temperature_c = sample.temperature_c
        return self.recorded_s


class SampleFile:
    """A CSV file written as samples arrive, so that a power cut costs only seconds. `header` names the columns.

    `constants` are columns between time and rate. Raises ConfigError if the file cannot be made.
    """

    def __init__(self, file: Path, header: Sequence[str], constants: Sequence[str] = ()):
        self._constants, self._flushed_s = tuple(constants), 0.0
        try:
            self._stream = file.open("w", encoding="utf-8", newline="")
        except OSError as error:
            raise ConfigError(str(file), "", "a file that can be written", str(error.strerror)) from error
        self._writer = csv.writer(self._stream, lineterminator="\n")
        self._writer.writerow(header)

    def add(self, time_s: float, sample: GyroSample) -> None:
        """Write a row; the temperature is empty if the gyro sends none."""
        temperature = "" if math.isnan(sample.temperature_c) else f"{sample.temperature_c:.4g}"
        rate = f"{sample.rate_rad_s * DEG_PER_RAD:.9g}"
        self._writer.writerow((f"{time_s:.6f}", *self._constants, rate, temperature))
        if time_s >= self._flushed_s + 1.0:
            self._stream.flush()
            self._flushed_s = time_s

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()


class RecordingError(Exception):
    """The gyro delivers no samples, or none any more. The text says why; the file keeps those recorded."""


def gyro_of(config: Config, where: str) -> Fog:
    """The gyro's configuration. Raises ConfigError if the robot has none."""
    if config.fog.protocol == "none":
        raise ConfigError(where, "fog.protocol", "a gyro", "'none'")
    return config.fog


def record(
    config: Config,
    seconds: float,
    on_sample: Callable[[float, GyroSample], None],
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Progress:
    """Record the configured gyro until its samples cover `seconds`: `on_sample(time_s, sample)` gets each.

    `time_s` counts from the first sample. The rate is the daemon's, before bias and calibration: counter-clockwise
    positive, after sign and axis. `on_progress` is called ten times a second. Raises RecordingError where the port
    cannot be opened, is lost or silent; KeyboardInterrupt passes through.
    """
    return asyncio.run(_record(config, seconds, on_sample, on_progress))


async def _record(
    config: Config,
    seconds: float,
    on_sample: Callable[[float, GyroSample], None],
    on_progress: Callable[[Progress], None],
) -> Progress:
    progress, stream = Progress(), FogStream(config.fog, config.robot.max_acceleration_deg_s2 * RAD_PER_DEG)
    ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    last_s, patience_s = time.monotonic(), max(SILENCE_S, SILENCE_BEATS / config.fog.rate_hz)

    def on_bytes(data: bytes, arrival_ns: int) -> None:
        nonlocal last_s
        for sample in stream.feed(data, arrival_ns):
            if ended.done():
                return
            last_s = time.monotonic()
            try:
                on_sample(progress.add(sample), sample)
            except OSError as error:  # the disk is full
                ended.set_exception(RecordingError(f"cannot write: {error.strerror}"))
            # The first sample covers an interval too.
            if progress.recorded_s + sample.interval_s >= seconds and not ended.done():
                ended.set_result(None)

    def on_state(text: str | None) -> None:
        nonlocal last_s
        last_s = time.monotonic()
        if text is not None and not ended.done():
            ended.set_exception(RecordingError(text + (": stop the daemon first" if "in use" in text else "")))

    port = SerialPort(config.fog, on_bytes, on_state)
    reading = asyncio.create_task(port.run())
    try:
        while not ended.done():
            await asyncio.wait({ended}, timeout=POLL_S)
            on_progress(progress)
            if not ended.done() and time.monotonic() - last_s > patience_s:
                ended.set_exception(RecordingError(_silence(config.fog, port.counters["bytes"], stream.counters)))
        ended.result()
    finally:
        reading.cancel()
        await asyncio.gather(reading, return_exceptions=True)
    return progress


def _silence(fog: Fog, count: int, counters: dict[str, int]) -> str:
    """Sentence on why there are no samples, according to how far the bytes get."""
    if count == 0:
        what = "no byte has come: is the gyro powered, is its cable on this port?"
    elif not counters["frames"]:
        what = f"{count} bytes came, but no packet: are fog.protocol ({fog.protocol}) and fog.baud ({fog.baud}) right?"
    else:
        told = ", ".join(f"{name}={number}" for name, number in counters.items() if number)
        what = f"packets came, but none that can be used: {told}"
    return f"{fog.port} is silent: {what}"
