"""Interface of all FOG protocols: bytes in, readings and counters out."""

from typing import Protocol

from drd.samples import FogReading


class FogProtocol(Protocol):
    """Parser of one gyro's byte stream; any chunking, never raises on bytes, keeps at most one unfinished frame.

    Each intact packet gives one reading, in order. A packet without a usable value gives one with `valid` False and
    value 0, because its arrival still shows the sensor's beat and that it was not lost.
    `sequence_modulus`: count at which the packets' own counter starts again at 0; None: they have none.
    `counters`: `frames` is the number of intact packets, of which the sensor declared `bad_flag` invalid.
    """

    sequence_modulus: int | None
    counters: dict[str, int]

    def feed(self, data: bytes) -> list[FogReading]:
        """Take the next bytes; return the readings that they complete."""

    def reset(self) -> None:
        """Forget the past: the port was opened again."""
