"""The robot's true motion, lap after lap, and its sensors' deliveries in simulated CLOCK_MONOTONIC time."""

import heapq
import itertools
import math
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from drd.config.keys import Config
from drd.samples import CanFrame
from drd.units import NS_PER_S
from drd_tools.emulate import encoder_frames, fog_packets
from drd_tools.emulate.sensors import SensorErrors, Sensors
from drd_tools.simulate.missions import demo_drive
from drd_tools.simulate.truth import Place, make_truth
from soak.faults import FAULTS, Fault, Site

STEP_S: Final = 0.05
LAP_S: Final = 120.0
STAND_S: Final = 12.0
# When CLOCK_MONOTONIC began, as far as the daemon knows.
EPOCH_NS: Final = 1000 * NS_PER_S
# From the end of a gyro's interval to the arrival of the packet's last byte: the least, and the mean beyond it.
GYRO_DELAY_S: Final = 0.008
JITTER_S: Final = 0.001
NODE_SKEW_S: Final = 0.001


def monotonic_ns(t_s: float) -> int:
    """The simulated clock at `t_s` since the run's beginning."""
    return EPOCH_NS + round(t_s * NS_PER_S)


class Laps:
    """The same closed drive again and again, each lap from where the last one ended."""

    def __init__(self, count: int):
        self._lap = make_truth(demo_drive(LAP_S, stand_s=STAND_S))
        self.duration_s = self._lap.duration_s
        self._starts, end = [Place(0.0, 0.0, 0.0, 0.0)], self._lap.at(self.duration_s)
        for _ in range(count + 1):
            self._starts.append(_after(self._starts[-1], end))

    def at(self, t_s: float) -> Place:
        """Where the robot is."""
        lap = int(t_s // self.duration_s)
        return _after(self._starts[lap], self._lap.at(t_s - lap * self.duration_s))


def _after(start: Place, then: Place) -> Place:
    """Where `then`, which is seen from the origin, is from `start`."""
    x, y, heading, way = start
    c, s = math.cos(heading), math.sin(heading)
    x, y = x + c * then.x_m - s * then.y_m, y + s * then.x_m + c * then.y_m
    return Place(x, y, heading + then.heading_rad, way + then.distance_m)


class Arrival(NamedTuple):
    """Something that the daemon is to read at `t_s`: bytes of the gyro, or a frame of the bus."""

    t_s: float
    order: int
    content: bytes | CanFrame


class World:
    """Drives, samples and lets the fault at work have its way. `step` gives what arrives, in order.

    `packets`: how many the gyro has sent.
    """

    def __init__(self, config: Config, laps: int, seed: int):
        self.drive = Laps(laps)
        self.random = np.random.default_rng([seed, 3])
        self._fog = fog_packets.make_encoder(config.fog)
        self._bus = encoder_frames.WheelFrameEncoder(config.encoders, config.robot, Path())
        # The bias stays as it was measured: a warm-up is what a model is for.
        errors = SensorErrors(warm_up_c=0.0)
        self._sensors, self._celsius = Sensors(self.drive, config.robot, errors, seed), errors.temperature_c
        self._period_s = 1.0 / config.fog.rate_hz / (1.0 + errors.clock_error_percent / 100.0)
        self.packets, self._steps, self._orders = 0, 0, itertools.count()
        self._way: list[Arrival] = []
        self._fault, self._site = FAULTS[0], Site(self.random)
        self._began_s = self._line_s = 0.0
        # What arrived before, while the host stood still, is read then.
        self.read_from_s = 0.0
        self._shown_m, self._true_m, self._offset_m = (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)

    @property
    def now_s(self) -> float:
        """Since the run's beginning."""
        return self._steps * STEP_S

    @property
    def is_stalled(self) -> bool:
        """The host stands still: nothing is read, and no time seems to pass."""
        return self._fault.stalls

    def begin(self, fault: Fault) -> None:
        """From now on, until `end`."""
        self._fault, self._site, self._began_s = fault, Site(self.random), self.now_s

    def end(self) -> None:
        """All is well again; counters go on from what they showed."""
        if self._fault.stalls:
            self.read_from_s = self.now_s
        self._fault = FAULTS[0]
        self._offset_m = (self._shown_m[0] - self._true_m[0], self._shown_m[1] - self._true_m[1])

    def under_way(self) -> list[Arrival]:
        """All that was sent and not yet read."""
        rest, self._way = sorted(self._way), []
        return rest

    def step(self) -> list[Arrival]:
        """Go on by STEP_S; what is read until then. While the host stands still nothing is."""
        self._steps += 1
        self._site.elapsed_s = self.now_s - self._began_s
        while (end_s := (self.packets + 1) * self._period_s) <= self.now_s:
            self._send_packet(end_s)
        self._send_frames(self.now_s)
        found = []
        while not self._fault.stalls and self._way and self._way[0].t_s <= self.now_s:
            found.append(heapq.heappop(self._way))
        return found

    def _send_packet(self, end_s: float) -> None:
        start_s, self.packets = self.packets * self._period_s, self.packets + 1
        rate, celsius = self._fault.rate(self._sensors.rate_rad_s(start_s, end_s), self._celsius, self._site)
        packet = self._fog.encode(rate, end_s - start_s, celsius, self._fault.valid)
        arrival_s = end_s + GYRO_DELAY_S + self.random.exponential(JITTER_S)
        for later_s, data in self._fault.packet(packet, self._site):
            cut = int(self.random.integers(len(data) + 1))
            for half in (data[:cut], data[cut:]):
                self._line_s = max(self._line_s, arrival_s + later_s)  # bytes do not overtake each other
                self._send(self._line_s, half)

    def _send_frames(self, t_s: float) -> None:
        self._true_m = left_m, right_m = self._sensors.travel_m(t_s)
        left_m, right_m = left_m + self._offset_m[0], right_m + self._offset_m[1]
        self._shown_m = self._fault.travel(left_m, right_m, self._site)
        messages = self._bus.encode(*self._shown_m)
        frames = [
            CanFrame(monotonic_ns(t_s + node * NODE_SKEW_S), m.arbitration_id, m.is_extended_id, bytes(m.data))
            for node, m in enumerate(messages)
        ]
        for later_s, frame in self._fault.frames(frames, self._site):
            self._send((frame.t_ns - EPOCH_NS) / NS_PER_S + later_s, frame)

    def _send(self, t_s: float, content: Any) -> None:
        if content:
            heapq.heappush(self._way, Arrival(t_s, next(self._orders), content))
