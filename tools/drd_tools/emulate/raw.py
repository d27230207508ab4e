"""Conversion of a simulated recording to the hardware's bytes and frames: to an MCAP file, or live."""

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import can
import numpy as np
from tqdm import tqdm

from drd import __version__
from drd.config.keys import Config
from drd.config.schema import ConfigError, Loaded
from drd.pipeline import Pipeline
from drd.ports.clock import TICK_S
from drd.recording.file import RecordingFile
from drd.recording.in_force import files_in_force
from drd.recording.recorder import HandedOver
from drd.recording.topics import Encoder
from drd.samples import CanFrame, Pose
from drd.units import NS_PER_S
from drd_tools.emulate import fog_packets
from drd_tools.emulate.encoder_frames import WheelFrameEncoder
from drd_tools.emulate.endpoints import PtyLink, can_endpoint
from drd_tools.recordings.folder import Recording

# Start of a run, fixed so that files are bit-identical: CLOCK_MONOTONIC, and 2026-01-01 on the wall clock.
START_NS: Final = 1000 * NS_PER_S
START_WALL_NS: Final = 1_767_225_600 * NS_PER_S
FLUSH_MESSAGES: Final = 2000
POLL_S: Final = 0.01
# Unplugging a terminal discards pending data: a reader gets this long.
LINGER_S: Final = 0.3


class Arrival(NamedTuple):
    """Data that arrive `time_s` after the start: bytes of the gyro, or frames of the encoders."""

    time_s: float
    fog: bytes
    frames: list[can.Message]


def arrivals(recording: Recording, config: Config, base: Path) -> list[Arrival]:
    """Arrivals of a whole recording, in order, with the latencies of the configuration. Raises ConfigError."""
    log, per_revolution = recording.encoders, recording.nominal.counts_per_revolution
    if log.left_counts is None or log.right_counts is None or per_revolution is None:
        path = "wheel.counts_per_revolution"
        raise ConfigError(recording.name, path, "a number: frames are made of counts", "null")
    count_m = 2.0 * math.pi * recording.nominal.wheel_radius_m / per_revolution
    # In a count's middle, so that an encoder that rounds down gives the same count.
    left, right = (count_m * (counts + 0.5) for counts in (log.left_counts, log.right_counts))
    step_s = np.diff(log.time_s, prepend=2.0 * log.time_s[0] - log.time_s[1])
    speeds = (np.diff(travel, prepend=travel[0]) / step_s for travel in (left, right))
    wheels = WheelFrameEncoder(config.encoders, config.robot, base)
    columns = (log.time_s + config.encoders.latency_s, left, right, *speeds)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    found = [Arrival(at_s, b"", wheels.encode(*row)) for at_s, *row in rows]
    if recording.fog is not None and config.fog.protocol != "none":
        gyro, fog = fog_packets.make_encoder(config.fog), recording.fog
        interval_s = float(np.median(np.diff(fog.time_s))) if len(fog.time_s) > 1 else 1.0 / config.fog.rate_hz
        temperature_c = np.full(len(fog.time_s), 20.0) if fog.temperature_c is None else fog.temperature_c
        columns = (fog.time_s + config.fog.latency_s, fog.rate_rad_s, temperature_c)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        found += [Arrival(at_s, gyro.encode(rate, interval_s, celsius), []) for at_s, rate, celsius in rows]
    return sorted(found, key=lambda arrival: arrival.time_s)


class _Writer(HandedOver):
    """Recorder of a run faster than real time, which writes the pipeline's inputs directly to the file."""

    def __init__(self, file: RecordingFile, config: Config):
        self._file, self._encoder = file, Encoder(config.output, config.recording.viewers)
        self.number = self.now_ns = 0

    def _put(self, kind: str, *arguments: Any) -> None:
        self.number += 1
        for message in self._encoder.by_kind[kind](*arguments):
            self._file.add(message, self.number, _wall_ns(self.now_ns), _wall_ns(message.t_ns))
        if self.number % FLUSH_MESSAGES == 0:
            self._file.flush()


def _wall_ns(monotonic_ns: int) -> int:
    return START_WALL_NS + monotonic_ns - START_NS


def write_mcap(file: Path, recording: Recording, config: Loaded[Config], base: Path) -> int:
    """Write what the daemon would have recorded, with its poses; return their number. Raises ConfigError.

    `base`: the folder to which paths in the configuration are relative.
    """
    sent = arrivals(recording, config.value, base)
    information = {
        "version": __version__,
        "robot": config.value.robot.name,
        "run": "00000000",
        "part": "1",
        "started_wall_ns": str(START_WALL_NS),
        "started_monotonic_ns": str(START_NS),
        "lost_before": "0",
        "simulated": recording.name,
    }
    try:
        file.unlink(missing_ok=True)
        out = RecordingFile(file, information, files_in_force(config, base), START_WALL_NS)
        writer = _Writer(out, config.value)
        count = 0

        def on_pose(pose: Pose, _: int) -> None:
            nonlocal count
            count += 1
            writer.pose(pose, _wall_ns(pose.t_ns))

        pipeline = Pipeline(config.value, base, on_pose, [writer])
        due_s = 0.0
        for arrival in tqdm(sent, "mcap", unit=" arrivals", disable=None, leave=False, delay=1.0):
            while due_s <= arrival.time_s:
                writer.now_ns = _monotonic_ns(due_s)
                pipeline.tick(writer.now_ns)
                due_s += TICK_S
            writer.now_ns = _monotonic_ns(arrival.time_s)
            if arrival.fog:
                pipeline.on_fog_bytes(arrival.fog, writer.now_ns)
            else:
                pipeline.on_frames(
                    [CanFrame(writer.now_ns, m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in arrival.frames]
                )
        out.finish({"reason": "stopped", "lost": "0", "last_entry": str(writer.number)})
    except OSError as error:
        raise ConfigError(str(file), "", "a file to write to", str(error.strerror)) from error
    return count


def _monotonic_ns(time_s: float) -> int:
    return START_NS + round(time_s * NS_PER_S)


def drive_live(recording: Recording, config: Config, base: Path, *, allow_real_bus: bool = False) -> Iterator[str]:
    """Emulate the recording's hardware in real time, at the devices of the daemon's configuration.

    Yields sentences on the devices, and at the end on what was sent. Raises ConfigError.
    """
    sent = arrivals(recording, config, base)
    fog = PtyLink(config.fog.port, "fog.port") if config.fog.protocol != "none" else None
    bus = can_endpoint(config.encoders, allow_real_bus)
    lost = 0
    try:
        if fog is not None:
            fog.open()
            yield f"FOG: {fog.path} -> {fog.device}"
        bus.open()
        yield f"CAN: {bus.place}"
        start_s = time.monotonic()
        for arrival in tqdm(sent, "live", unit=" arrivals", disable=None, leave=False):
            while True:
                bus.received()  # an adapter's commands are to be answered
                wait_s = start_s + arrival.time_s - time.monotonic()
                if wait_s <= 0.0:
                    break
                time.sleep(min(wait_s, POLL_S))
            if arrival.fog and fog is not None:
                lost += not fog.write(arrival.fog)
            for message in arrival.frames:
                lost += not bus.send(message)
        time.sleep(LINGER_S)
        yield f"{len(sent)} arrivals sent, {lost} packets or frames lost for want of a reader"
    finally:
        bus.close()
        if fog is not None:
            fog.close()
