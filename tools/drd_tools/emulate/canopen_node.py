"""Common functions of CANopen devices except PDOs (CiA 301): NMT states, boot-up, heartbeat, object 1017h by SDO."""

from enum import IntEnum
from struct import pack, unpack_from
from typing import Final

import can

from drd.units import NS_PER_MS, S_PER_NS

S_PER_MS: Final = NS_PER_MS * S_PER_NS
# Identifiers of the predefined connection set; all but NMT's are plus the node.
NMT_ID: Final = 0x000
SDO_ANSWER_ID: Final = 0x580
SDO_REQUEST_ID: Final = 0x600
HEARTBEAT_ID: Final = 0x700
NMT_RESETS: Final = (129, 130)  # node, communication
EVERY_NODE: Final = 0
HEARTBEAT_TIME: Final = 0x1017  # producer heartbeat time, UNSIGNED16, ms; 0: none
SDO_BYTES: Final = 8
# SDO command bytes, those of expedited transfers of two bytes, and abort codes.
UPLOAD: Final = 0x40
UPLOADED: Final = 0x4B
DOWNLOAD: Final = 0x2B
DOWNLOADED: Final = 0x60
ABORT: Final = 0x80
NO_SUCH_COMMAND: Final = 0x0504_0001
NO_SUCH_OBJECT: Final = 0x0602_0000
NO_SUCH_SUBINDEX: Final = 0x0609_0011


class NmtState(IntEnum):
    """NMT states, as encoded in the heartbeat."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


NMT_COMMANDS: Final = {1: NmtState.OPERATIONAL, 2: NmtState.STOPPED, 128: NmtState.PRE_OPERATIONAL}


class CanopenNode:
    """One device. `state`: its PDOs are sent only while it is operational.

    `autostart`: becomes operational without NMT, as devices do if object 1F80h says so; otherwise it waits for NMT.
    `heartbeat_s`: producer heartbeat time at power-on, 0 for none, until a master writes object 1017h.
    """

    def __init__(self, number: int, *, autostart: bool, heartbeat_s: float):
        self.number, self.autostart, self.heartbeat_s = number, autostart, heartbeat_s
        self.state = NmtState.BOOT_UP
        self._written_ms: int | None = None
        self._period_s = 0.0
        self._next_s = 0.0

    def take(self, frame: can.Message) -> list[can.Message]:
        """Obey an NMT command, or answer an SDO request; return frames to send. A booting node ignores all frames."""
        data = bytes(frame.data)
        if frame.is_extended_id or self.state == NmtState.BOOT_UP:
            return []
        if frame.arbitration_id == NMT_ID and len(data) == 2 and data[1] in (EVERY_NODE, self.number):
            if data[0] in NMT_RESETS:
                self.state, self._written_ms = NmtState.BOOT_UP, None
            self.state = NMT_COMMANDS.get(data[0], self.state)
        elif (
            frame.arbitration_id == SDO_REQUEST_ID + self.number
            and len(data) == SDO_BYTES
            and data[0] != ABORT
            and self.state != NmtState.STOPPED
        ):
            return [self._message(SDO_ANSWER_ID, self._answer(data))]
        return []

    def due(self, now_s: float) -> list[can.Message]:
        """The boot-up message after power-on and resets, then heartbeats until `now_s`, which must not decrease."""
        frames = []
        if self.state == NmtState.BOOT_UP:
            frames.append(self._message(HEARTBEAT_ID, bytes((NmtState.BOOT_UP,))))
            self.state = NmtState.OPERATIONAL if self.autostart else NmtState.PRE_OPERATIONAL
            self._period_s = 0.0
        period_s = self._heartbeat_ms * S_PER_MS
        if period_s != self._period_s:
            self._period_s, self._next_s = period_s, now_s + period_s
        while period_s and self._next_s <= now_s:
            frames.append(self._message(HEARTBEAT_ID, bytes((self.state,))))
            self._next_s += period_s
        return frames

    @property
    def _heartbeat_ms(self) -> int:
        return round(self.heartbeat_s / S_PER_MS) if self._written_ms is None else self._written_ms

    def _answer(self, request: bytes) -> bytes:
        """Answer a read or a write of object 1017h; abort everything else with the reason."""
        command, index, subindex = unpack_from("<BHB", request)
        if index != HEARTBEAT_TIME:
            code = NO_SUCH_OBJECT
        elif subindex != 0:
            code = NO_SUCH_SUBINDEX
        elif command == UPLOAD:
            return pack("<BHBH2x", UPLOADED, index, 0, self._heartbeat_ms)
        elif command == DOWNLOAD:
            (self._written_ms,) = unpack_from("<H", request, 4)
            return pack("<BHB4x", DOWNLOADED, index, 0)
        else:
            code = NO_SUCH_COMMAND
        return pack("<BHBI", ABORT, index, subindex, code)

    def _message(self, base_id: int, data: bytes) -> can.Message:
        return can.Message(arbitration_id=base_id + self.number, data=data, is_extended_id=False)
