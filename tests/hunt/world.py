"""The true drive of a genome, and what its sensors deliver, in simulated CLOCK_MONOTONIC time."""

import math
from collections.abc import Callable
from itertools import accumulate
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.encoders.cia406 import BOOT_UP, HEARTBEAT_ID
from drd.estimation.estimate import MEASURED_TREAD, SKID_SCALE, SKID_SLIP_S, WHEEL_SCALE
from drd.estimation.noise import make_noise, skid_steer
from drd.samples import CanFrame
from drd.units import NS_PER_S, RAD_PER_DEG
from drd_tools.emulate import encoder_frames, fog_packets
from hunt.genome import Event, Genome
from hunt.kinds import SIDEWAYS, SLIP_BOTH

EPOCH_NS: Final = 1000 * NS_PER_S
STEP_S: Final = 0.01
# Speeds and rates of the legs run into each other over this long.
SMOOTHING_S: Final = 1.5
# Of what is stated. With less a gyro that works would say the same digits again and again, as one that is stuck does:
# an E-Core's last one is three quarters of its noise.
LEAST_NOISE: Final = 0.5
GUARD_S: Final = 1.0  # longer than the bias is measured the robot stands at first
# From the end of a gyro's interval to its packet's last byte: the least, and the mean beyond it. Together about what
# the configuration states.
GYRO_DELAY_S, JITTER_S = 0.008, 0.001
NODE_SKEW_S: Final = 0.001
CLOCK_ERROR: Final = 0.01
# Skid steering: the effective tread over the measured one, from where it is found out; where its sideways slip ends.
SKID_TREAD: Final = (1.25, 1.9)
MOST_SLIP_S: Final = 0.4

AT_ONCE_S: Final = 1e-6  # the same time, but for rounding

Item = tuple[float, Any]  # when it arrives, s, and bytes, a list of frames, or a command's event
# Makes of an item what comes instead, from the event, random numbers and when it began.
LineFault = Callable[[Item, Event, np.random.Generator, float], list[Item]]


def monotonic_ns(t_s: float) -> int:
    """The simulated clock at `t_s` since the beginning."""
    return EPOCH_NS + round(t_s * NS_PER_S)


class World:
    """`truth`: x, y, heading at `time_s`, shape (n, 3). `items`: all that arrives, in order. `config`: as written."""

    def __init__(self, genome: Genome):
        self.genome, self.config = genome, genome.config()
        self._random = np.random.default_rng([genome.seed, 19])
        self._begin_s = self.config.estimation.static_bias.duration_s + GUARD_S
        self.seconds = self._begin_s + genome.seconds
        self.time_s = np.arange(round(self.seconds / STEP_S) + 1) * STEP_S
        self._drive()
        items = self._gyro_items() if self.config.fog.protocol != "none" else []
        items += self._wheel_items() + [(self.at_s(e), e) for e in genome.events if e.kind in COMMANDS]
        self.items = _read(self._stalled(sorted(items, key=lambda item: item[0])))

    def at_s(self, event: Event) -> float:
        """When an event begins."""
        return self._begin_s + event.at_s

    def during(self, t_s: Array, event: Event) -> npt.NDArray[np.bool_]:
        """Where in these times an event lasts."""
        return (t_s >= self.at_s(event)) & (t_s < self.at_s(event) + event.seconds)

    def _events(self, *kinds: str) -> list[Event]:
        return [event for event in self.genome.events if event.kind in kinds]

    # ---- the robot

    def _drive(self) -> None:
        """True pose, and what each wheel turns, as way on the nominal wheel."""
        random, noise_part = self._random, self.genome.gene("noise")
        t: Array = np.asarray(self.time_s[1:] - 0.5 * STEP_S, float)
        v, w, start_s = np.zeros_like(t), np.zeros_like(t), self._begin_s
        for leg in self.genome.legs:
            inside = (t >= start_s) & (t < start_s + leg.seconds)
            v[inside], w[inside] = leg.speed_m_s, leg.rate_rad_s
            start_s += leg.seconds
        box = np.full(round(SMOOTHING_S / STEP_S), STEP_S / SMOOTHING_S)
        v, w = (np.asarray(np.convolve(row, box)[: len(t)], float) for row in (v, w))
        robot, tread_m, scales, slip_s = self.config.robot, *self._robot()
        noise = make_noise("physical", self.config.estimation.noise, robot.tread_m)
        noise = skid_steer(noise, robot.tread_m) if self.genome.gene("skids") else noise
        part2 = noise_part**2 * STEP_S
        sideways, by_hand = slip_s * v * w, np.zeros_like(t)
        treads = np.full_like(t, tread_m)
        for e in self._events(SIDEWAYS):
            sideways += e.size * self.during(t, e)
        for e in self._events("turned by hand"):
            by_hand += e.size * RAD_PER_DEG * self.during(t, e)
        for e in self._events("other ground"):
            treads *= 1.0 + e.size * self.during(t, e)
        if self.genome.gene("skids"):  # on any ground, by so much
            treads = np.maximum(treads, SKID_TREAD[0] * robot.tread_m)

        def white(variance: Array) -> Array:
            return np.asarray(np.sqrt(variance * part2) * random.standard_normal(len(t)), float)

        heading = _sums((w + by_hand) * STEP_S)
        middle = 0.5 * (heading[1:] + heading[:-1])
        side = sideways * STEP_S + white(noise.lateral_m2_per_m * abs(v))
        c, s, wander = np.cos(middle), np.sin(middle), noise.position_m2_per_rad * abs(w)
        x = _sums(v * STEP_S * c - side * s + white(wander))
        y = _sums(v * STEP_S * s + side * c + white(wander))
        self.truth = np.column_stack([x, y, heading])
        skid = white(noise.turn_rad2_per_rad * abs(w)) * 0.5 * treads
        self._ways = []
        for sign, scale in zip((-1.0, 1.0), scales, strict=True):
            speed = v + sign * 0.5 * treads * w
            way = speed * STEP_S + white(noise.wheel_m2_per_m * abs(speed)) + sign * skid
            for e in self._events(SLIP_BOTH, "one wheel slips"):
                if e.kind == SLIP_BOTH or (e.side == 1) == (sign > 0.0):
                    way *= 1.0 + e.size * self.during(t, e)
            self._ways.append(_sums(way * (1.0 + scale)))

    def _robot(self) -> tuple[float, tuple[float, float], float]:
        """Tread, scales of the wheels and sideways slip, drawn from what the configuration takes for granted."""
        common, left, right, tread, slip = self._random.standard_normal(5).tolist()
        nominal_m, one = self.config.robot.tread_m, WHEEL_SCALE
        if not self.genome.gene("skids"):
            return nominal_m * (1.0 + MEASURED_TREAD * tread), (one * left, one * right), 0.0
        tread_m = nominal_m * float(self._random.uniform(*SKID_TREAD))
        scales = SKID_SCALE * common + one * left, SKID_SCALE * common + one * right
        return tread_m, scales, min(max(SKID_SLIP_S * slip, -MOST_SLIP_S), MOST_SLIP_S)

    # ---- the gyro

    def _gyro_items(self) -> list[Item]:
        random, fog, noise = self._random, self.config.fog, self.config.estimation.noise
        clock, scale, bias = random.standard_normal(3).tolist()
        period_s = 1.0 / fog.rate_hz / (1.0 + CLOCK_ERROR * clock)
        ends = np.arange(1, int(self.seconds / period_s)) * period_s
        turned = np.diff(np.interp(np.concatenate(([0.0], ends)), self.time_s, self.truth[:, 2]))
        initial = self.config.estimation.initial
        rate = (1.0 + initial.gyro_scale * scale) * turned / period_s + initial.gyro_bias_deg_s * bias * RAD_PER_DEG
        sigma = noise.gyro_deg_per_sqrt_h * RAD_PER_DEG / 60.0 / math.sqrt(period_s)
        sigma *= max(self.genome.gene("noise"), LEAST_NOISE)
        white, valid = sigma * random.standard_normal(len(ends)), np.ones(len(ends), bool)
        for e in self.genome.events:
            now, size = self.during(ends, e), e.size * RAD_PER_DEG
            if e.kind == "gyro bias steps":
                rate += size * now
            elif e.kind == "gyro scale steps":
                rate *= 1.0 + e.size * now
            elif e.kind == "gyro noise":
                white *= np.where(now, e.size, 1.0)
            elif e.kind == "gyro spikes":
                rate += size * now * (random.random(len(ends)) < 0.1)
            elif e.kind == "gyro stuck" and now.any():
                rate = np.where(now, rate[now][0], rate)
                white = np.where(now, 0.0, white)
            elif e.kind == "gyro invalid":
                valid &= ~now
        full_rad_s = fog.full_scale_deg_s * RAD_PER_DEG
        rate = np.clip(rate + white, -full_rad_s, full_rad_s)
        delay_s = GYRO_DELAY_S + max(-self.genome.gene("wheel_lag_s"), 0.0)
        late = np.maximum.accumulate(ends + delay_s + random.exponential(JITTER_S, len(ends)))
        encoder = fog_packets.make_encoder(fog)
        rows = zip(late.tolist(), rate.tolist(), valid.tolist(), strict=True)
        items: list[Item] = [(at_s, encoder.encode(r, period_s, 22.0, ok)) for at_s, r, ok in rows]
        return self._line(items, GYRO_LINE)

    # ---- the wheels

    def _wheel_items(self) -> list[Item]:
        encoders, robot = self.config.encoders, self.config.robot
        times = np.arange(1, round(self.seconds * encoders.rate_hz)) / encoders.rate_hz
        shown = [np.interp(times - max(self.genome.gene("wheel_lag_s"), 0.0), self.time_s, way) for way in self._ways]
        for e in self._events("counter to zero", "node restarts", "counter jumps"):
            after = times >= self.at_s(e)
            if after.any():
                shown[e.side] = shown[e.side] + after * (
                    e.size if e.kind == "counter jumps" else -shown[e.side][after][0]
                )
        bus = encoder_frames.WheelFrameEncoder(encoders, robot, Path())
        items: list[Item] = []
        for t_s, left_m, right_m in zip(times.tolist(), *(row.tolist() for row in shown), strict=True):
            frames = [
                CanFrame(monotonic_ns(t_s + node * NODE_SKEW_S), m.arbitration_id, m.is_extended_id, bytes(m.data))
                for node, m in enumerate(bus.encode(left_m, right_m))
            ]
            items.append((t_s + 2.0 * NODE_SKEW_S, frames))
        for e in self._events("node restarts"):
            boot_ns = monotonic_ns(self.at_s(e) - 2.0 * NODE_SKEW_S)
            items.append((self.at_s(e), [CanFrame(boot_ns, HEARTBEAT_ID + 1 + e.side, False, BOOT_UP)]))
        return self._line(sorted(items, key=lambda item: item[0]), BUS_LINE)

    # ---- the lines and the host

    def _line(self, items: list[Item], faults: dict[str, LineFault]) -> list[Item]:
        """What the line's faults make of the deliveries."""
        for e in self.genome.events:
            if (fault := faults.get(e.kind)) is not None:
                begin_s, end_s = self.at_s(e), self.at_s(e) + e.seconds
                found: list[Item] = []
                for item in items:
                    found += fault(item, e, self._random, begin_s) if begin_s <= item[0] < end_s else [item]
                items = found
        if not self._events("frames swapped"):  # nothing overtakes on a line
            latest = accumulate((t_s for t_s, _ in items), max)
            items = [(t_s, content) for t_s, (_, content) in zip(latest, items, strict=True)]
        return items

    def _stalled(self, items: list[Item]) -> list[Item]:
        """While the host stands still nothing is read; afterwards all of it at once."""
        for e in self._events("host stands still"):
            begin_s, end_s = self.at_s(e), self.at_s(e) + e.seconds
            items = [(end_s if begin_s <= t < end_s else t, content) for t, content in items]
        return sorted(items, key=lambda item: item[0])


def _read(items: list[Item]) -> list[Item]:
    """Bytes that have come at the same time are read at once, as the port does."""
    found: list[Item] = []
    for t_s, content in items:
        since_s, before = found[-1] if found else (0.0, None)
        if isinstance(before, bytes) and isinstance(content, bytes) and t_s < since_s + AT_ONCE_S:
            found[-1] = since_s, before + content
        else:
            found.append((t_s, content))
    return found


def _sums(steps: Array) -> Array:
    return np.concatenate(([0.0], np.cumsum(steps)))


def _flipped(data: bytes, random: np.random.Generator) -> bytes:
    i, bit = int(random.integers(len(data))), int(random.integers(8))
    return data[:i] + bytes([data[i] ^ 1 << bit]) + data[i + 1 :]


def _late_ns(frames: list[CanFrame], by_s: float) -> list[CanFrame]:
    return [frame._replace(t_ns=frame.t_ns + round(by_s * NS_PER_S)) for frame in frames]


def _bunched(item: Item, e: Event, _: Any, begin_s: float) -> list[Item]:
    t_s, data = item
    return [(t_s + e.size - (t_s - begin_s) % e.size, data)]


def _foreign(item: Item, e: Event, random: np.random.Generator, _: float) -> list[Item]:
    """Frames of others, and cut ones of the wheels' own."""
    t_s, frames = item
    if not frames:  # lost already
        return [item]
    strangers = [frames[0]._replace(can_id=0x5A5, data=b"?" * 8), frames[-1]._replace(data=b"?")]
    return [(t_s, [*frames, *(strangers[int(random.integers(2))] for _ in range(round(e.size)))])]


def _one_side(item: Item, e: Event, *_: Any) -> list[Item]:
    t_s, frames = item
    return [(t_s, [frame for i, frame in enumerate(frames) if i != e.side or len(frames) == 1])]


def _hit(r: np.random.Generator, e: Event) -> bool:
    return bool(r.random() < e.size)


GYRO_LINE: Final[dict[str, LineFault]] = {
    "gyro silent": lambda *_: [],
    "gyro port lost": lambda *_: [],
    "gyro packets lost": lambda item, e, r, _: [] if _hit(r, e) else [item],
    "gyro packets flipped": lambda item, e, r, _: [(item[0], _flipped(item[1], r) if _hit(r, e) else item[1])],
    "gyro packets doubled": lambda item, e, r, _: [item, item] if _hit(r, e) else [item],
    "gyro in bunches": _bunched,
    "gyro late": lambda item, e, *_: [(item[0] + e.size, item[1])],
    "garbage on the line": lambda item, e, r, _: [(item[0], r.bytes(round(e.size)) + item[1])],
}
BUS_LINE: Final[dict[str, LineFault]] = {
    "both counters silent": lambda *_: [],
    "bus lost": lambda *_: [],
    "one counter silent": _one_side,
    "frames lost": lambda item, e, r, _: [(item[0], [frame for frame in item[1] if not _hit(r, e)])],
    "frames doubled": lambda item, e, r, _: [item, item] if _hit(r, e) else [item],
    "frames late": lambda item, e, *_: [(item[0] + e.size, item[1])],
    "frames stamped late": lambda item, e, *_: [(item[0] + e.size, _late_ns(item[1], e.size))],
    "frames swapped": lambda item, e, r, _: [(item[0] + 0.15 if _hit(r, e) else item[0], item[1])],
    "foreign frames": _foreign,
}
COMMANDS: Final = ("set_pose", "reset", "calibrate_bias")
