"""Several observers of the pipeline as one."""

from collections.abc import Sequence
from typing import Any

from drd.pipeline import Observer
from drd.samples import CanFrame, GyroSample, WheelSample


class Observers:
    """Tells each of them, in order."""

    def __init__(self, *observers: Observer):
        self._all = observers

    def fog_bytes(self, data: bytes, arrival_ns: int) -> None:
        """See Observer."""
        for observer in self._all:
            observer.fog_bytes(data, arrival_ns)

    def frames(self, frames: Sequence[CanFrame]) -> None:
        """See Observer."""
        for observer in self._all:
            observer.frames(frames)

    def gyro(self, sample: GyroSample) -> None:
        """See Observer."""
        for observer in self._all:
            observer.gyro(sample)

    def wheels(self, sample: WheelSample) -> None:
        """See Observer."""
        for observer in self._all:
            observer.wheels(sample)

    def event(self, name: str, now_ns: int, **values: Any) -> None:
        """See Observer."""
        for observer in self._all:
            observer.event(name, now_ns, **values)
