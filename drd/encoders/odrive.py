"""ODrive, CAN Simple protocol: id = node << 5 | command, little-endian (odriverobotics/ODrive, docs/can-protocol).

Its stock DBC declares the floats as integers, so this layout unpacks the bytes itself.
"""

from math import isfinite
from pathlib import Path
from struct import Struct
from typing import Final

from drd.config.keys import Encoders
from drd.config.schema import ConfigError
from drd.encoders.layout import CounterRestart, Layout, counts_per_revolution, nodes
from drd.samples import CanFrame, WheelReading

ESTIMATES: Final = 0x009
ESTIMATES_DATA: Final = Struct("<ff")  # position rev, velocity rev/s
COUNTS: Final = 0x00A
COUNTS_DATA: Final = Struct("<ii")  # shadow count, count within one turn


class Odrive(Layout):
    """Position estimates (revolutions) or shadow counts of two ODrive axes."""

    def __init__(self, encoders: Encoders, base: Path):
        counts = encoders.odrive.message == "counts"
        command, self._data = (COUNTS, COUNTS_DATA) if counts else (ESTIMATES, ESTIMATES_DATA)
        self.counts_per_revolution = encoders.odrive.gear_ratio
        if counts:
            if encoders.odrive.gear_ratio != 1.0:
                expected, got = "1, since counts_per_revolution includes the gear", f"{encoders.odrive.gear_ratio:g}"
                raise ConfigError(str(base), "encoders.odrive.gear_ratio", expected, got)
            self.counts_per_revolution = counts_per_revolution(encoders, base)
        self._sides = {(node << 5 | command, False): side for side, node in nodes(encoders, base, 0, 63).items()}
        self.can_ids = tuple(self._sides)
        self.modulus_counts: int | None = 1 << 32 if counts else None
        self.counters = {"wrong_length": 0, "not_finite": 0}

    def decode(self, frame: CanFrame) -> tuple[WheelReading | CounterRestart, ...]:
        """One side's position."""
        side = self._sides.get((frame.can_id, frame.extended))
        if side is None:
            return ()
        if len(frame.data) != self._data.size:
            self.counters["wrong_length"] += 1
            return ()
        position = self._data.unpack(frame.data)[0]
        if not isfinite(position):
            self.counters["not_finite"] += 1
            return ()
        return (WheelReading(side, position),)
