"""Real-time emulation of a robot's gyro and wheel encoders, as bytes and frames where the daemon expects them."""

import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple, Self

import can
import numpy as np

from drd.config.keys import Config
from drd.units import NS_PER_S, RAD_PER_DEG, S_PER_NS
from drd_tools.emulate import fog_packets
from drd_tools.emulate.canopen_node import CanopenNode, NmtState
from drd_tools.emulate.encoder_frames import WheelFrameEncoder
from drd_tools.emulate.endpoints import RECEIVED_FRAMES, PtyLink, can_endpoint
from drd_tools.emulate.fault import Fault
from drd_tools.emulate.sensors import SensorErrors, Sensors
from drd_tools.simulate.missions import Drive
from drd_tools.simulate.truth import make_truth

# Commands of an SLCAN host are answered at least this often.
POLL_S: Final = 0.01
# 14 hours of a 20 Hz counter.
TRUTH_ROWS: Final = 1_000_000


class Truth(NamedTuple):
    """True pose when the counters were sampled, and their travel then (without faults)."""

    t_ns: int  # CLOCK_MONOTONIC
    x_m: float
    y_m: float
    heading_rad: float
    left_m: float
    right_m: float


@dataclass
class _Schedule:
    """Schedule of evenly spaced samples, each sent `latency_s` later."""

    period_s: float
    latency_s: float
    number: int = 1

    @property
    def sampled_s(self) -> float:
        return self.number * self.period_s

    @property
    def due_s(self) -> float:
        return self.sampled_s + self.latency_s


class Emulator:
    """Emulator of the configured sensors along a path, in its own thread.

    The gyro's port and an slcan adapter's are pseudo-terminals, linked at the configured paths; other CAN interfaces
    are joined. Time zero is `start()`. Use it as a context manager, or call `stop()`. Raises ConfigError if a path
    is taken or a bus cannot be used; a bus that may be a real robot's needs `allow_real_bus`.

    `base`: the folder that the configuration's own paths are relative to. `seed` repeats all sensor noise. `fault`: an
    effect of the catalogue.
    `path`: the true motion. `counters`: packets and frames sent, and those lost because nobody listened.

    The public fields below are its faults. Each may be changed at any time.
    """

    fog_silent: bool = False
    fog_invalid: bool = False  # the packets say so
    fog_garbage: bytes = b""  # goes before each packet
    fog_drop_every: int = 0  # each n-th packet is missing; 0: none
    fog_corrupt_every: int = 0  # each n-th packet has one wrong bit; 0: none
    fog_offset_deg_s: float = 0.0  # added to the rate (ccw positive): a jump of the bias
    wheels_silent: bool = False
    left_silent: bool = False  # no effect if one frame holds both sides
    right_silent: bool = False
    wheels_drop_every: int = 0  # each n-th pair is missing; 0: none
    swap_frames: bool = False  # right before left
    count_offset_m: float = 0.0  # added to both counters: a preset write or a restart
    left_slip: float = 0.0  # share of extra counts; -1: the counter stands still
    right_slip: float = 0.0
    # Of CANopen encoders, from power-on or an NMT reset on; `nodes` are the two, with their NMT states.
    nodes_autostart: bool = True  # operational by themselves; otherwise they wait for NMT start
    heartbeat_s: float = 0.0  # producer heartbeat time; 0: none

    def __init__(
        self,
        config: Config,
        base: Path,
        drive: Drive,
        errors: SensorErrors | None = None,
        seed: int = 0,
        *,
        allow_real_bus: bool = False,
        fault: Fault | None = None,
    ):
        errors = errors or SensorErrors()
        fog, encoders = config.fog, config.encoders
        counted = ("fog_packets", "fog_dropped", "can_frames", "can_dropped", "can_received")
        self.counters = dict.fromkeys(counted, 0)
        self.truth: deque[Truth] = deque(maxlen=TRUTH_ROWS)
        self.received: deque[can.Message] = deque(maxlen=RECEIVED_FRAMES)  # what others sent on the bus
        self.path = make_truth(drive)
        self._sensors = Sensors(self.path, config.robot, errors, seed, fault)
        self._random = np.random.default_rng([seed, 3])
        self._fog = None if fog.protocol == "none" else fog_packets.make_encoder(fog)
        self._frames = WheelFrameEncoder(encoders, config.robot, base)
        wheels = (encoders.left, encoders.right) if encoders.layout == "cia406" else ()
        self.nodes = tuple(CanopenNode(w.node, autostart=True, heartbeat_s=0.0) for w in wheels)
        self._fog_port = None if self._fog is None else PtyLink(fog.port, "fog.port")
        self._bus = can_endpoint(encoders, allow_real_bus)
        fog_hz = fog.rate_hz * (1 + errors.clock_error_percent / 100)
        self._fog_schedule = _Schedule(1 / fog_hz, fog.latency_s)
        self._wheel_schedule = _Schedule(1 / encoders.rate_hz, encoders.latency_s)
        self._counted_m = (0.0, 0.0)
        self.start_ns = 0  # CLOCK_MONOTONIC of the drive's time zero
        self._stop = threading.Event()
        self._lock = threading.Lock()  # one step of the loop, or one unplugging
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Plug in and start driving. Raises ConfigError, leaving nothing behind."""
        self.plug_in()
        self.start_ns = time.monotonic_ns()
        self._thread = threading.Thread(target=self._run, name="drd emulator", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop and unplug, removing the links. May be called twice."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        self._unplug_all()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def is_running(self) -> bool:
        """Whether its thread is running."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def places(self) -> dict[str, str]:
        """Places of gyro and CAN bus, for people."""
        fog = "none" if self._fog_port is None else f"{self._fog_port.path} -> {self._fog_port.device}"
        return {"FOG": fog, "CAN": self._bus.place}

    def plug_in(self) -> None:
        """Only plug in, for use with `step()`. Raises ConfigError, leaving nothing behind."""
        try:
            self.replug_fog()
            self.replug_can()
        except BaseException:
            self._unplug_all()
            raise

    def step(self, now_s: float) -> float:
        """Send everything due until `now_s` after the start; return the next due time. Called by the thread."""
        with self._lock:
            frames = self._bus.received()
            self.counters["can_received"] += len(frames)
            self.received.extend(frames)
            for node in self.nodes:
                node.autostart, node.heartbeat_s = self.nodes_autostart, self.heartbeat_s
                for frame in [answer for command in frames for answer in node.take(command)] + node.due(now_s):
                    self._send_can(frame)
            while self._wheel_schedule.due_s <= now_s:
                self._send_wheels(self._wheel_schedule)
                self._wheel_schedule.number += 1
            if self._fog is None:
                return self._wheel_schedule.due_s
            while self._fog_schedule.due_s <= now_s:
                self._send_fog(self._fog, self._fog_schedule)
                self._fog_schedule.number += 1
            return min(self._fog_schedule.due_s, self._wheel_schedule.due_s)

    def unplug_fog(self) -> None:
        """Pull the gyro's cable: its port hangs up and the link vanishes."""
        with self._lock:
            if self._fog_port is not None:
                self._fog_port.close()

    def replug_fog(self) -> None:
        """Plug the gyro in again: a new pseudo-terminal behind the same name."""
        with self._lock:
            if self._fog_port is not None:
                self._fog_port.open()

    def unplug_can(self) -> None:
        """Pull the CAN adapter; a bus that is no adapter falls silent."""
        with self._lock:
            self._bus.close()

    def replug_can(self) -> None:
        """Plug the CAN adapter in again."""
        with self._lock:
            self._bus.open()

    def _unplug_all(self) -> None:
        self.unplug_fog()
        self.unplug_can()

    def _run(self) -> None:
        wait_s = 0.0
        while not self._stop.wait(wait_s):
            due_s = self.step(self._now_s())
            wait_s = min(max(due_s - self._now_s(), 0.0), POLL_S)

    def _now_s(self) -> float:
        return (time.monotonic_ns() - self.start_ns) * S_PER_NS

    def _send_fog(self, encoder: fog_packets.FogEncoder, now: _Schedule) -> None:
        rate_rad_s = self._sensors.rate_rad_s(now.sampled_s - now.period_s, now.sampled_s)
        rate_rad_s += self.fog_offset_deg_s * RAD_PER_DEG
        temperature_c = self._sensors.temperature_c(now.sampled_s)
        # A silent gyro goes on measuring, which an integrated angle or sequence number shows afterwards.
        packet = encoder.encode(rate_rad_s, now.period_s, temperature_c, valid=not self.fog_invalid)
        if self.fog_silent or _is_nth(now.number, self.fog_drop_every):
            return
        if _is_nth(now.number, self.fog_corrupt_every):
            packet = self._with_wrong_bit(packet)
        sent = self._fog_port is not None and self._fog_port.write(self.fog_garbage + packet)
        self.counters["fog_packets" if sent else "fog_dropped"] += 1

    def _send_wheels(self, now: _Schedule) -> None:
        left_m, right_m = self._sensors.travel_m(now.sampled_s, self.left_slip, self.right_slip)
        t_ns = self.start_ns + round(now.sampled_s * NS_PER_S)
        self.truth.append(Truth(t_ns, *self.path.at(now.sampled_s)[:3], left_m, right_m))
        left_m_s, right_m_s = (
            (m - before) / now.period_s for m, before in zip((left_m, right_m), self._counted_m, strict=True)
        )
        self._counted_m = (left_m, right_m)
        offset_m = self.count_offset_m
        frames = self._frames.encode(left_m + offset_m, right_m + offset_m, left_m_s, right_m_s)
        if self.wheels_silent or _is_nth(now.number, self.wheels_drop_every):
            return
        if len(frames) == 2:  # left first
            silent = [self.left_silent, self.right_silent]
            for k, node in enumerate(self.nodes):
                silent[k] |= node.state != NmtState.OPERATIONAL
            frames = [frame for frame, is_silent in zip(frames, silent, strict=True) if not is_silent]
        for frame in reversed(frames) if self.swap_frames else frames:
            self._send_can(frame)

    def _with_wrong_bit(self, packet: bytes) -> bytes:
        data = bytearray(packet)
        data[int(self._random.integers(len(data)))] ^= 1 << int(self._random.integers(8))
        return bytes(data)

    def _send_can(self, frame: can.Message) -> None:
        self.counters["can_frames" if self._bus.send(frame) else "can_dropped"] += 1


def _is_nth(number: int, every: int) -> bool:
    return every > 0 and number % every == 0
