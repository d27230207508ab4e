"""CANopen encoders, profile CiA 406: one node per wheel, position (object 6004h) in a TPDO.

Identifiers as in CiA 301's predefined connection set; default mapping of TPDO1 and TPDO2 is one UNSIGNED32,
little-endian, in bytes 0 to 3 (Lika IF55 ROT CB manual p. 55).
"""

from pathlib import Path
from typing import Final

from drd.config.keys import Encoders
from drd.encoders.layout import CounterRestart, Layout, counts_per_revolution, nodes
from drd.samples import CanFrame, Side, WheelReading

NMT_ID: Final = 0x000
SYNC_ID: Final = 0x080
EMERGENCY_ID: Final = 0x080  # plus the node
TPDO1_ID: Final = 0x180  # plus the node; TPDO2 to 4 follow at steps of 0x100
HEARTBEAT_ID: Final = 0x700  # plus the node
NMT_START: Final = 1
BOOT_UP: Final = b"\x00"


class Cia406(Layout):
    """Positions, boot-up messages and emergencies of two CiA 406 nodes."""

    def __init__(self, encoders: Encoders, base: Path):
        self._nodes = nodes(encoders, base, 1, 127)
        self.counts_per_revolution = counts_per_revolution(encoders, base)
        key = encoders.cia406
        self._field = slice(key.byte_offset, key.byte_offset + key.byte_length)
        self._start_nodes = key.start_nodes
        tpdo_id = TPDO1_ID + 0x100 * (key.tpdo - 1)
        self._positions = {tpdo_id + node: side for side, node in self._nodes.items()}
        self._heartbeats = {HEARTBEAT_ID + node: side for side, node in self._nodes.items()}
        self._emergencies = {EMERGENCY_ID + node for node in self._nodes.values()}
        ids = (*self._positions, *self._heartbeats, *self._emergencies)
        self.can_ids = tuple((can_id, False) for can_id in ids)
        # An encoder wraps at object 6002h, which may be less; encoders.modulus_counts must then state it.
        self.modulus_counts: int | None = 1 << (8 * key.byte_length)
        self.counters = {"wrong_length": 0, "boot_ups": 0, "emergencies": 0}
        if key.sync_period_s is not None:
            self.cyclic = (CanFrame(0, SYNC_ID, False, b""), key.sync_period_s)

    def start_frames(self) -> tuple[CanFrame, ...]:
        """NMT start for both nodes, where cia406.start_nodes asks for it."""
        return tuple(frame for side in Side for frame in self._start(side))

    def decode(self, frame: CanFrame) -> tuple[WheelReading | CounterRestart, ...]:
        """A position, or the restart of a node. Longer frames are fine: the mapping may hold more objects."""
        if frame.extended:
            return ()
        side = self._positions.get(frame.can_id)
        if side is not None:
            if len(frame.data) < self._field.stop:
                self.counters["wrong_length"] += 1
                return ()
            return (WheelReading(side, int.from_bytes(frame.data[self._field], "little")),)
        side = self._heartbeats.get(frame.can_id)
        if side is not None and frame.data == BOOT_UP:
            self.counters["boot_ups"] += 1
            return (CounterRestart(side, self._start(side)),)
        # Error code 0000h reports that an error is gone (CiA 301).
        if frame.can_id in self._emergencies and any(frame.data[:2]):
            self.counters["emergencies"] += 1
        return ()

    def _start(self, side: Side) -> tuple[CanFrame, ...]:
        if not self._start_nodes:
            return ()
        return (CanFrame(0, NMT_ID, False, bytes((NMT_START, self._nodes[side]))),)
