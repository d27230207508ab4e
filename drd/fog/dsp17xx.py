"""KVH DSP-1760, 1725, 1750 and 1775, binary format A: 36 bytes, big-endian.

Header FE 81 FF 55; rotation x, y, z and acceleration x, y, z as float32; status bits; sequence 0 to 127; temperature
int16; CRC-32/MPEG-2 of all that (polynomial 04C11DB7, initial value FFFFFFFF, not reflected, not inverted).
Sources: KVH 1775 IMU manual; ESA-PRL/drivers-dsp1760 src/dsp1760.hpp; osudrl/atrias firmware medulla_imu.c and crc.c.
"""

from binascii import crc32
from math import isfinite
from struct import Struct
from typing import Final

from drd.config.keys import Fog
from drd.samples import FogReading
from drd.units import RAD_PER_DEG

HEADER: Final = b"\xfe\x81\xff\x55"
# Header, rotation x y z, acceleration x y z, status, sequence, temperature.
BODY: Final = Struct(">4s3f3fBBh")
CRC_BYTES: Final = 4
FRAME_BYTES: Final = BODY.size + CRC_BYTES
SEQUENCE_MODULUS: Final = 128
# Bits 0 to 2 of the status byte: gyro x, y, z valid.
AXES: Final = ("x", "y", "z")
BITS_REVERSED: Final = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc32_mpeg2(data: bytes) -> bytes:
    """CRC-32/MPEG-2, big-endian: the standard library's CRC-32 works on mirrored bits and inverts its result."""
    return (~crc32(data.translate(BITS_REVERSED)) & 0xFFFFFFFF).to_bytes(4, "little").translate(BITS_REVERSED)


class Dsp17xxParser:
    """Reads the axis that points up. Formats B and C and BIT messages between packets count as foreign bytes.

    The header may occur inside a packet: one that fails its CRC is scanned again from its second byte.
    """

    sequence_modulus: int | None = SEQUENCE_MODULUS

    def __init__(self, fog: Fog):
        self.counters = dict.fromkeys(("frames", "bad_checksum", "bad_flag", "not_finite", "foreign_bytes"), 0)
        self._axis = AXES.index(fog.axis)
        self._is_angle = fog.dsp17xx.rotation == "delta"
        self._rad_per_unit = RAD_PER_DEG if fog.dsp17xx.angle_unit == "degrees" else 1.0
        self._temperature_scale_c = fog.dsp17xx.temperature_scale_c
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[FogReading]:
        """Take the next bytes; return the readings that they complete."""
        self._buffer += data
        readings = []
        while self._find_header() and len(self._buffer) >= FRAME_BYTES:
            packet = bytes(self._buffer[:FRAME_BYTES])
            if crc32_mpeg2(packet[: BODY.size]) != packet[BODY.size :]:
                self.counters["bad_checksum"] += 1
                self._skip(1)
                continue
            del self._buffer[:FRAME_BYTES]
            readings.append(self._decode(packet))
        return readings

    def reset(self) -> None:
        """Forget an unfinished packet; its bytes count as foreign."""
        self._skip(len(self._buffer))

    def _find_header(self) -> bool:
        """Drop the bytes before the next header; without one, keep only its possible beginning and return False."""
        start = self._buffer.find(HEADER)
        self._skip(start if start >= 0 else len(self._buffer) - (len(HEADER) - 1))
        return start >= 0

    def _skip(self, count: int) -> None:
        if count > 0:
            self.counters["foreign_bytes"] += count
            del self._buffer[:count]

    def _decode(self, packet: bytes) -> FogReading:
        _, *values, status, sequence, temperature = BODY.unpack_from(packet)
        rotation = values[self._axis]
        flag, finite = bool(status >> self._axis & 1), isfinite(rotation)
        self.counters["frames"] += 1
        self.counters["bad_flag"] += not flag
        self.counters["not_finite"] += not finite
        return FogReading(
            value=rotation * self._rad_per_unit if finite else 0.0,
            is_angle=self._is_angle,
            sequence=sequence % SEQUENCE_MODULUS,
            temperature_c=temperature * self._temperature_scale_c,
            valid=flag and finite,
        )
