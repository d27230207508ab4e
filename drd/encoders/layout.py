"""Common interface of the layouts of encoder frames: which frames they read, and what these contain."""

from math import pi
from pathlib import Path
from typing import NamedTuple, Protocol

from drd.config.keys import Encoders, Wheel
from drd.config.schema import ConfigError
from drd.samples import CanFrame, Side, WheelReading


class CounterRestart(NamedTuple):
    """Restart of a side's device: the next reading is a new start, not motion.

    `reply` holds the frames to send in answer; their `t_ns` has no meaning.
    """

    side: Side
    reply: tuple[CanFrame, ...]


class Layout(Protocol):
    """A layout of wheel readings in CAN frames. `decode` never raises: every bad frame has a counter.

    `can_ids`: the identifiers it reads, each with whether it is an extended (29-bit) one.
    `modulus_counts`: count at which the counter wraps; None: it never does (float revolutions, speed).
    `counts_per_revolution`: counts per turn of the wheel; 1 where readings are in revolutions.
    `reports_speed`: a reading is the speed of the wheel's rim in m/s instead of a count.
    `cyclic`: a frame that the daemon sends periodically, and its period in seconds.
    `from_file`: the content that it takes from a file, regardless of the file's name; None: nothing.
    """

    can_ids: tuple[tuple[int, bool], ...]
    modulus_counts: int | None
    counters: dict[str, int]
    counts_per_revolution: float = 1.0
    reports_speed: bool = False
    cyclic: tuple[CanFrame, float] | None = None
    from_file: str | None = None

    def metres_per_count(self, radius_m: float) -> float:
        """Travel of a wheel of this radius per count; 1 where readings are speeds."""
        return 1.0 if self.reports_speed else 2.0 * pi * radius_m / self.counts_per_revolution

    def decode(self, frame: CanFrame) -> tuple[WheelReading | CounterRestart, ...]:
        """The readings of the frame; empty if it is bad (counted) or not of this layout."""

    def start_frames(self) -> tuple[CanFrame, ...]:
        """Frames to send after each opening of the bus."""
        return ()


def wheels(encoders: Encoders) -> dict[Side, Wheel]:
    """The configuration of each side."""
    return {Side.LEFT: encoders.left, Side.RIGHT: encoders.right}


def side_key(side: Side, name: str) -> str:
    """Path of one side's configuration key, as named in errors."""
    return f"encoders.{side.name.lower()}.{name}"


def counts_per_revolution(encoders: Encoders, base: Path) -> float:
    """Counts per wheel turn. Raises ConfigError where they are not configured."""
    if encoders.counts_per_revolution is None:
        expected = f"a number, since layout {encoders.layout} reads counts"
        raise ConfigError(str(base), "encoders.counts_per_revolution", expected, "nothing")
    return encoders.counts_per_revolution


def nodes(encoders: Encoders, base: Path, low: int, high: int) -> dict[Side, int]:
    """Node id of each side. Raises ConfigError where one does not fit into the layout's identifiers."""
    for side, wheel in wheels(encoders).items():
        if not low <= wheel.node <= high:
            expected = f"a whole number from {low} to {high} (layout {encoders.layout})"
            raise ConfigError(str(base), side_key(side, "node"), expected, str(wheel.node))
    return {side: wheel.node for side, wheel in wheels(encoders).items()}
