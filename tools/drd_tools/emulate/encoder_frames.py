"""Encoding of wheel travel in CAN frames as sent by real encoders: the inverse of drd.encoders.

The byte layouts are implemented independently, from the same sources, to reveal a mistake in either.
"""

from math import floor, pi
from pathlib import Path
from struct import pack
from typing import TYPE_CHECKING, NamedTuple

import can

from drd.config.keys import Encoders, Robot
from drd.encoders.dbc import find_signal, load_database
from drd.samples import Side

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal


class _Wheel(NamedTuple):
    """One wheel as seen by its encoder, with the sign of its mounting and the scale of its tyre applied."""

    node: int
    travel_m: float
    turns: float
    speed_m_s: float
    turns_s: float


class WheelFrameEncoder:
    """Encoder of frames of one layout, for a robot exactly as in `robot`; to emulate another truth, pass another.

    Raises ConfigError if the layout is dbc and its file cannot be used.
    """

    def __init__(self, encoders: Encoders, robot: Robot, base: Path):
        self._encoders = encoders
        self._counts = encoders.counts_per_revolution or 0.0
        self._per_turn_m = 2.0 * pi * robot.wheel_radius_m
        self._scales = (robot.left_scale, robot.right_scale)
        self._dbc: list[tuple[Message, Signal]] = []
        if encoders.layout == "dbc":
            database = load_database(encoders, base)
            self._dbc = [find_signal(database, encoders, base, side) for side in Side]
        kinds = {"cia406": self._cia406, "agilex": self._agilex, "odrive": self._odrive, "vesc": self._vesc}
        self._frames = kinds.get(encoders.layout, self._any_dbc)

    def encode(self, left_m: float, right_m: float, left_m_s: float = 0.0, right_m_s: float = 0.0) -> list[can.Message]:
        """Make frames with the given travel since power-on, forward positive, and speeds; left first."""
        left, right = self._encoders.left, self._encoders.right
        wheels = []
        for wheel, scale, travel, speed in zip(
            (left, right), self._scales, (left_m, right_m), (left_m_s, right_m_s), strict=True
        ):
            factor = -1.0 / scale if wheel.reversed else 1.0 / scale
            travel_m, speed_m_s = travel * factor, speed * factor
            turns = travel_m / self._per_turn_m
            wheels.append(_Wheel(wheel.node, travel_m, turns, speed_m_s, speed_m_s / self._per_turn_m))
        return self._frames(wheels)

    def _modulo(self, counts: float, default: int) -> int:
        return floor(counts) % (self._encoders.modulus_counts or default)

    def _cia406(self, wheels: list[_Wheel]) -> list[can.Message]:
        key = self._encoders.cia406
        messages = []
        for wheel in wheels:
            counts = self._modulo(wheel.turns * self._counts, 256**key.byte_length)
            data = bytes(key.byte_offset) + counts.to_bytes(key.byte_length, "little")
            messages.append(_standard(0x080 + 0x100 * key.tpdo + wheel.node, data))
        return messages

    def _agilex(self, wheels: list[_Wheel]) -> list[can.Message]:
        counts = (self._modulo(wheel.travel_m * 1000.0, 1 << 32) for wheel in wheels)
        return [_standard(0x311, pack(">II", *counts))]

    def _odrive(self, wheels: list[_Wheel]) -> list[can.Message]:
        if self._encoders.odrive.message == "estimates":
            gear = self._encoders.odrive.gear_ratio
            return [_standard(w.node << 5 | 0x009, pack("<ff", gear * w.turns, gear * w.turns_s)) for w in wheels]
        messages = []
        for wheel in wheels:
            counts = wheel.turns * self._counts
            in_turn = floor(counts) % max(1, int(self._counts))
            data = pack("<II", self._modulo(counts, 1 << 32), in_turn)
            messages.append(_standard(wheel.node << 5 | 0x00A, data))
        return messages

    def _vesc(self, wheels: list[_Wheel]) -> list[can.Message]:
        per_turn = 6 * self._encoders.vesc.pole_pairs * self._encoders.vesc.gear_ratio
        messages = []
        for wheel in wheels:
            # 24.0 V supply; the last two bytes are reserved.
            data = pack(">Ihh", self._modulo(wheel.turns * per_turn, 1 << 32), 240, 0)
            messages.append(can.Message(arbitration_id=0x1B00 | wheel.node, data=data, is_extended_id=True))
        return messages

    def _any_dbc(self, wheels: list[_Wheel]) -> list[can.Message]:
        """Other signals of the messages are sent as raw zero; multiplexed messages are not emulated."""
        frames: dict[str, tuple[Message, dict[str, float]]] = {}
        for wheel, (message, signal) in zip(wheels, self._dbc, strict=True):
            blank: dict[str, float] = {s.name: 0 for s in message.signals}
            frames.setdefault(message.name, (message, blank))[1][signal.name] = self._raw(signal, wheel)
        return [
            can.Message(
                arbitration_id=message.frame_id,
                is_extended_id=message.is_extended_frame,
                data=message.encode(values, scaling=False, strict=False),
            )
            for message, values in frames.values()
        ]

    def _raw(self, signal: "Signal", wheel: _Wheel) -> float:
        if self._encoders.dbc.quantity == "speed":
            return signal.scaled_to_raw(wheel.speed_m_s / self._encoders.dbc.speed_unit_m_s)
        if signal.is_float:
            return wheel.turns * self._counts
        counts = self._modulo(wheel.turns * self._counts, 1 << signal.length)
        negative = signal.is_signed and counts >> (signal.length - 1)
        return counts - (1 << signal.length) if negative else counts


def _standard(can_id: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
