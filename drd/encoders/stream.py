"""Convert CAN frames to wheel samples with the configured layout, counters and pairing."""

from collections import deque
from pathlib import Path

from drd.config.keys import Encoders, Robot
from drd.config.schema import ConfigError
from drd.encoders import make_layout
from drd.encoders.counter import MARGIN_COUNTS, Counter, Outcome, SpeedIntegral, Travel
from drd.encoders.layout import CounterRestart, wheels
from drd.encoders.pairing import Pairing
from drd.samples import CanFrame, Side, WheelReading, WheelSample, WheelTurns
from drd.units import NS_PER_S

# Assumed resolution where readings are not whole counts: far below any motion that matters.
UNCOUNTED_RESOLUTION_M = 1e-4
# Least pairing window, in periods: two free-running nodes are up to half a period apart, and jitter.
WINDOW_PART = 0.75
# Enough for replies to both nodes between two calls; a node in a boot loop must not fill the memory.
MAX_REPLIES = 16


class EncoderStream:
    """The wheel encoders of one robot. `feed` never raises on a frame's content.

    `can_ids`: identifiers to receive, each with whether it is extended. `cyclic`: a frame to send periodically and its
    period in seconds, or None. `last_ns`: arrival of each side's last good reading, None before the first;
    `first_ns`: that of either side's first. `metres`: forward travel per unit of each side's readings;
    `resolution_m`: that per count of the coarser side. `from_file`: see Layout.
    """

    def __init__(self, encoders: Encoders, robot: Robot, base: Path):
        self._layout = make_layout(encoders, base)
        self.can_ids = self._layout.can_ids
        self.cyclic = self._layout.cyclic
        self.from_file = self._layout.from_file
        self.last_ns: dict[Side, int | None] = dict.fromkeys(Side)
        self.first_ns: int | None = None
        self._known_ids = frozenset(self.can_ids)
        self._latency_ns = round(encoders.latency_s * NS_PER_S)
        scale = {Side.LEFT: robot.left_scale, Side.RIGHT: robot.right_scale}
        self._metres_per_rad = {side: robot.wheel_radius_m * scale[side] for side in Side}
        unit_m = self._layout.metres_per_count(robot.wheel_radius_m)
        self.metres = {side: (-unit_m if w.reversed else unit_m) * scale[side] for side, w in wheels(encoders).items()}
        counted = self._layout.modulus_counts is not None and not self._layout.reports_speed
        self.resolution_m = max(map(abs, self.metres.values())) if counted else UNCOUNTED_RESOLUTION_M
        self._travels = {side: self._travel(side, encoders, robot, base) for side in Side}
        period_s = 1.0 / encoders.rate_hz
        window_s = max(encoders.pair_window_s, WINDOW_PART * period_s)
        self._pairing = Pairing(window_s, encoders.gap_s, period_s)
        self._newest: WheelSample | None = None
        self._replies: deque[CanFrame] = deque(maxlen=MAX_REPLIES)
        self._counters = {"frames": 0, "foreign": 0, "samples": 0}

    @property
    def counters(self) -> dict[str, int]:
        """All counters in one mapping; those of one side begin with left_ or right_."""
        merged = {**self._counters, **self._layout.counters, **self._pairing.counters}
        for side, travel in self._travels.items():
            merged |= {f"{side.name.lower()}_{name}": count for name, count in travel.counters.items()}
        return merged

    def feed(self, frame: CanFrame) -> list[WheelSample]:
        """Take one frame; return the samples that it completes."""
        self._counters["frames"] += 1
        if (frame.can_id, frame.extended) not in self._known_ids:
            self._counters["foreign"] += 1
            return []
        samples = []
        for event in self._layout.decode(frame):
            if isinstance(event, CounterRestart):
                self._travels[event.side].restart()
                self._replies.extend(event.reply)
            elif (sample := self._read(frame.t_ns, event)) is not None:
                samples.append(sample)
                self._newest = sample
        self._counters["samples"] += len(samples)
        return samples

    def turns(self) -> WheelTurns | None:
        """The wheels' turns at the newest sample; None before the first, after a gap, and without counts."""
        sample, end = self._newest, self._pairing.end
        if self._layout.reports_speed or sample is None or end is None or end[0] != sample.t_ns:
            return None
        left_m, right_m = self._metres_per_rad[Side.LEFT], self._metres_per_rad[Side.RIGHT]
        left_rad_s = sample.left_m / (sample.interval_s * left_m)
        right_rad_s = sample.right_m / (sample.interval_s * right_m)
        return WheelTurns(sample.t_ns, end[1] / left_m, end[2] / right_m, left_rad_s, right_rad_s)

    def restart(self) -> None:
        """Drop replies: the bus was reopened. Counters kept running: the gap's length decides if motion is lost."""
        self._replies.clear()

    def start_frames(self) -> tuple[CanFrame, ...]:
        """Frames to send after each opening of the bus; their `t_ns` has no meaning."""
        return self._layout.start_frames()

    def take_replies(self) -> list[CanFrame]:
        """Frames to send now in reply to those received since the last call (a node's boot-up)."""
        replies = list(self._replies)
        self._replies.clear()
        return replies

    def _read(self, t_ns: int, reading: WheelReading) -> WheelSample | None:
        side, travel = reading.side, self._travels[reading.side]
        sampled_ns = t_ns - self._latency_ns
        outcome = travel.add(sampled_ns, reading.value)
        if outcome is Outcome.IGNORED:
            return None
        self.last_ns[side] = t_ns
        if self.first_ns is None:
            self.first_ns = t_ns
        travel_m, told = travel.total * self.metres[side], outcome is Outcome.GAP
        return self._pairing.add(side, sampled_ns, travel_m, moved=outcome is Outcome.MOVED, told=told)

    def _travel(self, side: Side, encoders: Encoders, robot: Robot, base: Path) -> Travel:
        """The side's accumulator. Raises ConfigError where readings could not be used even without losses."""
        period_s = 1.0 / encoders.rate_hz
        if encoders.gap_s <= period_s:
            got = f"{encoders.gap_s:g}"
            raise ConfigError(str(base), "encoders.gap_s", f"more than one period of rate_hz ({period_s:g} s)", got)
        max_units_s = robot.max_speed_m_s / abs(self.metres[side])
        if self._layout.reports_speed:
            return SpeedIntegral(max_units_s, encoders.gap_s)
        modulus = self._layout.modulus_counts
        counter = Counter(modulus, max_units_s, period_s, encoders.gap_s)
        if counter.longest_gap_s <= period_s:
            least = 2 * (max_units_s * period_s + MARGIN_COUNTS)
            expected = f"more than {least:.0f}: less can turn by half between two readings at max_speed_m_s"
            raise ConfigError(str(base), "encoders.modulus_counts", expected, str(modulus))
        return counter
