"""AgileX robots (Scout, Tracer, protocol v2): frame 0x311 holds both odometers in mm, int32 big-endian, left first.

Source: agilexrobotics/ugv_sdk, protocol_v2 and the Scout user manual, table 3.14; sent every 20 ms.
"""

from struct import Struct
from typing import Final

from drd.encoders.layout import CounterRestart, Layout
from drd.samples import CanFrame, Side, WheelReading

ODOMETRY_ID: Final = 0x311
ODOMETRY: Final = Struct(">ii")
METRES_PER_COUNT: Final = 0.001


class Agilex(Layout):
    """Both wheels' odometers from one frame."""

    def __init__(self) -> None:
        self.can_ids = ((ODOMETRY_ID, False),)
        self.modulus_counts: int | None = 1 << 32
        self.counters = {"wrong_length": 0}

    def metres_per_count(self, radius_m: float) -> float:  # noqa: ARG002 - the robot knows its own radius
        """One millimetre, whatever the radius: the robot itself converts counts to travel."""
        return METRES_PER_COUNT

    def decode(self, frame: CanFrame) -> tuple[WheelReading | CounterRestart, ...]:
        """Both odometers."""
        if frame.can_id != ODOMETRY_ID or frame.extended:
            return ()
        if len(frame.data) != ODOMETRY.size:
            self.counters["wrong_length"] += 1
            return ()
        left_mm, right_mm = ODOMETRY.unpack(frame.data)
        return WheelReading(Side.LEFT, left_mm), WheelReading(Side.RIGHT, right_mm)
