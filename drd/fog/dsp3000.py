"""KVH DSP-3000, asynchronous ASCII: lines "(-)xxx.xxxxxx y CR LF", value and valid flag.

Source: KVH manual 54-0215 Rev. C p. 12; a real line, with its leading spaces, is in ros-drivers/kvh_drivers,
test/dsp3000_parser_utest.cpp. There is no checksum, so anything but that form is refused.
"""

import re
from math import nan, remainder
from typing import Final

from drd.config.keys import Fog
from drd.samples import FogReading
from drd.units import RAD_PER_DEG

# Required end of a line. Exactly six decimals, so that a lost digit is noticed. Two blanks, or the line's beginning,
# before the value: it is complete, whatever stands further ahead.
LINE_END: Final = re.compile(rb"(?:^ ?|  )(-?[0-9]{1,3}\.[0-9]{6}) {1,20}([01])\r\Z")
# More than can match, so that the kept end of a longer line cannot pass for its beginning.
KEPT_BYTES: Final = 40
FULL_TURN_DEG: Final = 360.0


class Dsp3000Parser:
    """One reading a line, in the configured mode.

    A line with two blanks before its value is found after any bytes. One with fewer is found only after a line feed,
    or at the start if it begins with a space or a sign: otherwise a value whose first digits were cut off, or that
    garbage ran into, cannot be distinguished from a complete one.
    """

    sequence_modulus: int | None = None

    def __init__(self, fog: Fog):
        self.counters = dict.fromkeys(("frames", "malformed_lines", "bad_flag"), 0)
        self._is_angle = fog.dsp3000.mode != "rate"
        self._integrated = fog.dsp3000.mode == "integrated"
        self._line = b""
        self._cut = True
        self._last_deg: float | None = None

    def feed(self, data: bytes) -> list[FogReading]:
        """Take the next bytes; return the readings that they complete."""
        *lines, rest = (self._line + data).split(b"\n")
        self._line = rest[-KEPT_BYTES:]
        return [reading for line in lines if (reading := self._decode(line[-KEPT_BYTES:])) is not None]

    def reset(self) -> None:
        """Forget an unfinished line and, in integrated mode, the last angle."""
        self._line, self._cut, self._last_deg = b"", True, None

    def _decode(self, line: bytes) -> FogReading | None:
        match = LINE_END.search(line)
        may_be_cut, self._cut = self._cut, False
        if match is None or (may_be_cut and match.start(1) == 0 and line[:1].isdigit()):
            self.counters["malformed_lines"] += 1
            return None
        # Garbage before a good line counts as a separate line.
        self.counters["malformed_lines"] += bool(line[: match.start()].strip(b" "))
        self.counters["frames"] += 1
        valid = match[2] == b"1"
        self.counters["bad_flag"] += not valid
        value_deg = float(match[1])
        if self._integrated:
            value_deg, valid = self._increment_deg(value_deg, valid)
        return FogReading(value_deg * RAD_PER_DEG if valid else 0.0, self._is_angle, None, nan, valid)

    def _increment_deg(self, angle_deg: float, valid: bool) -> tuple[float, bool]:
        """Turn since the previous valid line, modulo a full turn, and whether there was such a line."""
        last_deg, self._last_deg = self._last_deg, angle_deg if valid else None
        if last_deg is None or not valid:
            return 0.0, False
        return remainder(angle_deg - last_deg, FULL_TURN_DEG), True
