"""Raw bytes from the serial line of a fibre-optic gyro, read by the daemon's own parsers."""

import zlib
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from drd.config.file import load_config
from drd.config.schema import ConfigError
from drd.fog import make_protocol
from drd.fog.protocol import FogProtocol
from drd.samples import FogReading
from drd.units import NS_PER_S
from drd_tools.importing.can_formats import opened
from drd_tools.importing.streams import Gyro, Origin, Source

CHUNK: Final = 1 << 16
# Counters of damaged packets; each took one sampling period.
DAMAGED: Final = ("malformed_lines", "bad_checksum", "framing_errors")


class FogBytes(Source):
    """A file of bytes without times, which follow from the packet count at the configured rate.

    `config`: file whose `fog` section describes the packets. Raises ConfigError.
    """

    def __init__(self, path: Path, config: Path | None):
        self.path, self._config = path, config

    def listing(self) -> list[str]:
        """Describe how to import such a file."""
        return [
            f"{self.path}: {self.path.stat().st_size} bytes",
            "",
            "raw bytes of a gyro, if CONFIG's `fog` section describes them:",
            f"  drd import {self.path} --config CONFIG --gyro fog --output DIR",
        ]

    def _read(self) -> bytes:
        try:
            with opened(self.path) as file:
                data: bytes = file.read()
        except (OSError, EOFError, zlib.error) as error:
            raise ConfigError(str(self.path), "", "a readable file of a gyro's bytes", str(error)) from error
        return data

    def gyro(self, name: str) -> tuple[Gyro, Origin]:
        """Valid readings as rates, with `fog.positive` applied."""
        if name != "fog":
            raise ConfigError("command line", "--gyro", "fog, for a file of a gyro's bytes", repr(name))
        if self._config is None:
            raise ConfigError("command line", "--config", "a configuration that describes the packets", "nothing")
        fog = load_config(self._config).value.fog
        if fog.protocol == "none":
            raise ConfigError(str(self._config), "fog.protocol", "the gyro's protocol", "'none'")
        protocol = make_protocol(fog)
        readings, steps = _packets(protocol, self._read())
        valid = np.array([r.valid for r in readings], dtype=bool)
        if valid.sum() < 2:
            seen = ", ".join(f"{n} {value}" for n, value in protocol.counters.items())
            raise ConfigError(str(self.path), "fog.protocol", f"valid packets of {fog.protocol}", seen)
        value = np.array([r.value * (fog.rate_hz if r.is_angle else 1.0) for r in readings])
        value *= -1.0 if fog.positive == "clockwise" else 1.0
        temperature_c = np.array([r.temperature_c for r in readings])
        origin = Origin("fog", f"bytes, {fog.protocol}", f"packet count at fog.rate_hz, {fog.rate_hz:g} Hz")
        told = ", ".join(f"{n} {count}" for n, count in protocol.counters.items() if count)
        by = "what is left of them" if protocol.sequence_modulus is None else "their count"
        lost = int((steps - 1).sum())
        origin.notes.append(f"{told}; {lost} packets lost by {by}, {int((~valid).sum())} not valid")
        beats = np.cumsum(steps)
        if fog.protocol == "dsp3000" and fog.dsp3000.mode == "integrated":
            # Only these angles include the turn of lost lines: make a row for each, since a row covers one period.
            value, valid, temperature_c = (np.repeat(x, steps) for x in (value / steps, valid, temperature_c))
            beats = np.arange(1, beats[-1] + 1)
        time_ns = np.round(beats[valid] / fog.rate_hz * NS_PER_S).astype(np.int64)
        known = temperature_c[valid] if np.isfinite(temperature_c[valid]).all() else None
        return Gyro(time_ns, value[valid][:, None], ("",), None, known), origin


def _packets(protocol: FogProtocol, data: bytes) -> tuple[list[FogReading], npt.NDArray[np.int64]]:
    """Readings, and the number of periods since the previous one, shape (n,), 1 for the first.

    A packet's sequence number shows how many were lost before it, modulo its range; without one, the remains of
    damaged packets are counted.
    """
    readings, places = list[FogReading](), list[int]()
    size = 1 if protocol.sequence_modulus is None else CHUNK  # byte by byte: counters must be those at each reading
    for begin in tqdm(range(0, len(data), size), "bytes", disable=None, leave=False, delay=1.0):
        for reading in protocol.feed(data[begin : begin + size]):
            if readings and reading.is_copy_of(readings[-1]):
                continue
            damaged = sum(protocol.counters.get(name, 0) for name in DAMAGED)
            places.append(len(readings) + damaged if reading.sequence is None else reading.sequence)
            readings.append(reading)
    steps = np.ones(len(readings), dtype=np.int64)
    steps[1:] = np.diff(np.array(places, dtype=np.int64))
    if (modulus := protocol.sequence_modulus) is not None:
        steps[1:] = (steps[1:] - 1) % modulus + 1
    return readings, steps
