"""KVH E-Core 1000 and 2000 (RD1100, RD2060, RD2100), digital output: 8 bytes of 7 bits, the first marked by bit 7.

The payloads, most significant first, form 7 bytes m0 to m6: m0 makes their sum 0 modulo 256, m5 and m6 are the rate,
a big-endian int16 of full scale / 32768. Sources: California PATH gyroread.c (2002) and Heudiasyc PACPUS
GyroComponent.cpp (parseEcore2000), which agree. Neither decodes m1 to m4: their layout is configured (config.Ecore).
"""

from math import nan
from typing import Final

from drd.config.keys import Fog
from drd.samples import FogReading
from drd.units import RAD_PER_DEG

SYNC_BIT: Final = 0x80
FRAME_BYTES: Final = 8
PAYLOAD_BYTES: Final = 7
COUNTS_PER_FULL_SCALE: Final = 32768


class EcoreParser:
    """Parser of frames: any byte with the sync bit starts one, so an intact frame is found whatever precedes it."""

    sequence_modulus: int | None = None

    def __init__(self, fog: Fog):
        self.counters = dict.fromkeys(("frames", "bad_checksum", "bad_flag", "framing_errors", "foreign_bytes"), 0)
        self._rad_s_per_count = fog.full_scale_deg_s * RAD_PER_DEG / COUNTS_PER_FULL_SCALE
        self._profile = fog.ecore
        self._frame = bytearray()

    def feed(self, data: bytes) -> list[FogReading]:
        """Take the next bytes; return the readings that they complete."""
        readings = []
        for byte in data:
            if byte & SYNC_BIT:
                if self._frame:
                    self.counters["framing_errors"] += 1
                self.reset()
            elif not self._frame:
                self.counters["foreign_bytes"] += 1
                continue
            self._frame.append(byte)
            if len(self._frame) == FRAME_BYTES:
                # A frame with a bad sum holds no second sync bit, so it need not be scanned again.
                if (reading := self._decode()) is not None:
                    readings.append(reading)
                self._frame.clear()
        return readings

    def reset(self) -> None:
        """Forget an unfinished frame; its bytes count as foreign."""
        self.counters["foreign_bytes"] += len(self._frame)
        self._frame.clear()

    def _decode(self) -> FogReading | None:
        number = 0
        for byte in self._frame:
            number = number << 7 | byte & ~SYNC_BIT
        m = number.to_bytes(PAYLOAD_BYTES, "big")
        if sum(m) % 256:
            self.counters["bad_checksum"] += 1
            return None
        profile = self._profile
        # With the status byte 0 (none) the mask is not used.
        status = m[profile.status_byte] & profile.status_mask if profile.status_byte else None
        valid = status is None or status == profile.status_good & profile.status_mask
        temperature_c = nan
        if first := profile.temperature_byte:
            counts = int.from_bytes(m[first : first + 2], "big", signed=True)
            temperature_c = counts * profile.temperature_scale_c + profile.temperature_offset_c
        self.counters["frames"] += 1
        self.counters["bad_flag"] += not valid
        rate_rad_s = int.from_bytes(m[5:7], "big", signed=True) * self._rad_s_per_count
        return FogReading(rate_rad_s, False, None, temperature_c, valid)
