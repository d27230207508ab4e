"""VESC motor controllers: STATUS_5, 29-bit id = 27 << 8 | controller, int32 big-endian tachometer first.

Source: vedderb/bldc, documentation/comm_can.md and comm/comm_can.c: six tachometer counts per electrical turn.
"""

from pathlib import Path
from struct import Struct
from typing import Final

from drd.config.keys import Encoders
from drd.encoders.layout import CounterRestart, Layout, nodes
from drd.samples import CanFrame, WheelReading

STATUS_5: Final = 27
STATUS_5_DATA: Final = Struct(">ihh")  # tachometer, supply voltage in 0.1 V, reserved
COUNTS_PER_ELECTRICAL_TURN: Final = 6


class Vesc(Layout):
    """Tachometers of two VESC controllers."""

    def __init__(self, encoders: Encoders, base: Path):
        vesc = encoders.vesc
        self.counts_per_revolution = COUNTS_PER_ELECTRICAL_TURN * vesc.pole_pairs * vesc.gear_ratio
        self._sides = {(STATUS_5 << 8 | node, True): side for side, node in nodes(encoders, base, 0, 255).items()}
        self.can_ids = tuple(self._sides)
        self.modulus_counts: int | None = 1 << 32
        self.counters = {"wrong_length": 0}

    def decode(self, frame: CanFrame) -> tuple[WheelReading | CounterRestart, ...]:
        """One side's tachometer."""
        side = self._sides.get((frame.can_id, frame.extended))
        if side is None:
            return ()
        if len(frame.data) != STATUS_5_DATA.size:
            self.counters["wrong_length"] += 1
            return ()
        return (WheelReading(side, STATUS_5_DATA.unpack(frame.data)[0]),)
