"""Encoding of yaw rates in the packets that the configured gyro would send.

`encode` makes the packet after `interval_s` at the mean `rate_rad_s` (counter-clockwise positive at the robot). All
numbers must be finite; they are rounded to the packet's resolution and clipped to its range, as in the sensor.
"""

import struct

from drd.config.keys import Fog
from drd.fog.dsp17xx import AXES, BODY, HEADER, SEQUENCE_MODULUS, crc32_mpeg2
from drd.fog.ecore import COUNTS_PER_FULL_SCALE, FRAME_BYTES, PAYLOAD_BYTES, SYNC_BIT
from drd.units import DEG_PER_RAD


class EcoreEncoder:
    """E-Core: 8 bytes of 7 bits. Invalid readings can be marked only if the profile has status bits."""

    def __init__(self, fog: Fog):
        self._counts_per_rad_s = _sign(fog) * DEG_PER_RAD * COUNTS_PER_FULL_SCALE / fog.full_scale_deg_s
        self._profile = fog.ecore

    def encode(
        self,
        rate_rad_s: float,
        interval_s: float,  # noqa: ARG002  # the interface's; this gyro sends rates
        temperature_c: float,
        valid: bool = True,
    ) -> bytes:
        """Encode one frame."""
        profile, m = self._profile, bytearray(PAYLOAD_BYTES)
        m[5:7] = _int16(rate_rad_s * self._counts_per_rad_s)
        if first := profile.temperature_byte:
            counts = (temperature_c - profile.temperature_offset_c) / profile.temperature_scale_c
            m[first : first + 2] = _int16(counts)
        if profile.status_byte:
            bits = profile.status_good if valid else ~profile.status_good
            kept = m[profile.status_byte] & ~profile.status_mask
            m[profile.status_byte] = kept | bits & profile.status_mask
        m[0] = -sum(m) % 256
        number = int.from_bytes(m, "big")
        payloads = [number >> 7 * place & ~SYNC_BIT & 0xFF for place in reversed(range(FRAME_BYTES))]
        return bytes([payloads[0] | SYNC_BIT, *payloads[1:]])


class Dsp3000Encoder:
    """DSP-3000: one ASCII line, in columns as in the known real line. It carries no temperature."""

    def __init__(self, fog: Fog):
        self._deg_per_rad = _sign(fog) * DEG_PER_RAD
        self._mode = fog.dsp3000.mode
        self._angle_deg = 0.0

    def encode(
        self,
        rate_rad_s: float,
        interval_s: float,
        temperature_c: float,  # noqa: ARG002  # the interface's; this gyro sends none
        valid: bool = True,
    ) -> bytes:
        """Encode one line."""
        value_deg = rate_rad_s * self._deg_per_rad
        if self._mode != "rate":
            value_deg *= interval_s
        if self._mode == "integrated":
            self._angle_deg = value_deg = (self._angle_deg + value_deg) % 360.0
        return f"{max(-999.0, min(999.0, value_deg)):15.6f}   {int(valid)}\r\n".encode("ascii")


class Dsp17xxEncoder:
    """DSP-1760 and relatives, format A: the configured axis turns, the others and the accelerations are 0."""

    ALL_VALID = 0x77

    def __init__(self, fog: Fog):
        self._unit_per_rad = _sign(fog) * (DEG_PER_RAD if fog.dsp17xx.angle_unit == "degrees" else 1.0)
        self._is_angle = fog.dsp17xx.rotation == "delta"
        self._temperature_scale_c = fog.dsp17xx.temperature_scale_c
        self._axis = AXES.index(fog.axis)
        self._sequence = 0

    def encode(self, rate_rad_s: float, interval_s: float, temperature_c: float, valid: bool = True) -> bytes:
        """Encode one packet."""
        values = [0.0] * 6
        values[self._axis] = rate_rad_s * self._unit_per_rad * (interval_s if self._is_angle else 1.0)
        status = self.ALL_VALID if valid else self.ALL_VALID & ~(1 << self._axis)
        counts = int.from_bytes(_int16(temperature_c / self._temperature_scale_c), "big", signed=True)
        body = BODY.pack(HEADER, *values, status, self._sequence, counts)
        self._sequence = (self._sequence + 1) % SEQUENCE_MODULUS
        return body + crc32_mpeg2(body)


FogEncoder = EcoreEncoder | Dsp3000Encoder | Dsp17xxEncoder


def make_encoder(fog: Fog) -> FogEncoder:
    """Make the counterpart of the configured parser. Raises ValueError for protocol none."""
    encoders: dict[str, type[FogEncoder]] = {
        "ecore": EcoreEncoder,
        "dsp3000": Dsp3000Encoder,
        "dsp17xx": Dsp17xxEncoder,
    }
    if fog.protocol not in encoders:
        raise ValueError(f"no gyro protocol {fog.protocol!r}")
    return encoders[fog.protocol](fog)


def _sign(fog: Fog) -> float:
    """Sign of a counter-clockwise turn in the gyro's own axis."""
    return -1.0 if fog.positive == "clockwise" else 1.0


def _int16(value: float) -> bytes:
    """Encode as big-endian, rounded and clipped."""
    return struct.pack(">h", max(-32768, min(32767, round(value))))
