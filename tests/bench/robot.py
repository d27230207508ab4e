"""The robot that the benchmarks share: its configuration, and what its sensors send while it drives a circle."""

import socket
from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

from drd.config.keys import Config
from drd.pipeline import Pipeline
from drd.samples import CanFrame
from drd.units import NS_PER_S
from drd_tools.emulate import encoder_frames, fog_packets

CONFIG: Final = """\
robot: {{name: bench, wheel_radius_m: 0.11, tread_m: 0.6}}
fog: {{protocol: ecore, port: {folder}/fog}}
encoders: {{layout: cia406, interface: slcan, channel: {folder}/can,
  counts_per_revolution: 20000, modulus_counts: 65536}}
estimation: {{static_bias: {{duration_s: 0}}}}
monitor: {{enabled: false}}
output: {{publish_on: {publish_on}, prefix: bench, listen: [{endpoint}]}}
"""
SPEED_M_S: Final = 0.5
RATE_RAD_S: Final = 0.3
TEMPERATURE_C: Final = 20.0
# A FOG packet arrives this long after the frames of the same moment.
FOG_LATER_NS: Final = 3_000_000


class Arrival(NamedTuple):
    """What comes in at one moment: bytes of the gyro, or frames of the encoders."""

    t_ns: int
    data: bytes | list[CanFrame]


class Circle:
    """The sensors of a robot with this configuration (gyro at 10 Hz, encoders at 20 Hz) that drives a circle."""

    def __init__(self, config: Config):
        self._fog = fog_packets.make_encoder(config.fog)
        self._frames = encoder_frames.WheelFrameEncoder(config.encoders, config.robot, Path())
        self._fog_period_s, self._wheel_period_s = 1.0 / config.fog.rate_hz, 1.0 / config.encoders.rate_hz
        turn_m_s = RATE_RAD_S * config.robot.tread_m / 2
        self._left_m_s, self._right_m_s = SPEED_M_S - turn_m_s, SPEED_M_S + turn_m_s

    def fog_packet(self) -> bytes:
        """The gyro's next packet."""
        return self._fog.encode(RATE_RAD_S, self._fog_period_s, TEMPERATURE_C)

    def wheel_frames(self, driven_s: float, t_ns: int) -> list[CanFrame]:
        """Both counters `driven_s` seconds after the start, in frames received at `t_ns`."""
        messages = self._frames.encode(self._left_m_s * driven_s, self._right_m_s * driven_s)
        return [CanFrame(t_ns, m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in messages]

    def arrivals(self, seconds: float) -> list[Arrival]:
        """Everything that arrives in that time, in order."""
        wheel_count, fog_count = round(seconds / self._wheel_period_s), round(seconds / self._fog_period_s)
        found = []
        for i in range(1, wheel_count + 1):
            driven_s = i * self._wheel_period_s
            t_ns = round(driven_s * NS_PER_S)
            found.append(Arrival(t_ns, self.wheel_frames(driven_s, t_ns)))
        for i in range(1, fog_count + 1):
            found.append(Arrival(round(i * self._fog_period_s * NS_PER_S) + FOG_LATER_NS, self.fog_packet()))
        return sorted(found, key=lambda arrival: arrival.t_ns)


def replay(pipeline: Pipeline, arrivals: Iterable[Arrival]) -> None:
    """Feed the pipeline as fast as it goes."""
    for t_ns, data in arrivals:
        if isinstance(data, bytes):
            pipeline.on_fog_bytes(data, t_ns)
        else:
            pipeline.on_frames(data)


def config_text(folder: Path, endpoint: str, publish_on: str = "wheels") -> str:
    """The configuration, with the gyro's port and the SLCAN adapter's linked in `folder`."""
    return CONFIG.format(folder=folder, endpoint=endpoint, publish_on=publish_on)


def free_endpoint() -> str:
    """A Zenoh end point on the loopback that nobody listens on."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{listener.getsockname()[1]}"
