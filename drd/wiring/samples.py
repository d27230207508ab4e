"""The decoded samples of a pipeline, kept for the judgement."""

from collections.abc import Sequence
from typing import Any

from drd.config.keys import Robot
from drd.pipeline import Pipeline
from drd.samples import CanFrame, GyroSample, WheelSample
from drd.wiring.findings import Finding, Statement
from drd.wiring.judge import Geometry, judge


class Samples:
    """An observer of a pipeline; hand it to `Pipeline` as its recorder."""

    def __init__(self) -> None:
        self.gyro_samples: list[GyroSample] = []
        self.wheel_samples: list[WheelSample] = []
        self.byte_count = 0

    def judge(self, pipeline: Pipeline, robot: Robot, said: Statement | None = None) -> list[Finding]:
        """Findings about what was kept; `robot` is the pipeline's configuration."""
        geometry = Geometry(robot.tread_m, pipeline.encoders.resolution_m, pipeline.fog is not None)
        return judge(self.gyro_samples, self.wheel_samples, geometry, said)

    def fog_bytes(self, data: bytes, arrival_ns: int) -> None:  # noqa: ARG002  # the observer's form
        """Bytes from the gyro's serial line."""
        self.byte_count += len(data)

    def frames(self, frames: Sequence[CanFrame]) -> None:
        """Nothing that the judgement needs."""

    def gyro(self, sample: GyroSample) -> None:
        """A gyro sample."""
        self.gyro_samples.append(sample)

    def wheels(self, sample: WheelSample) -> None:
        """A sample of both wheels."""
        self.wheel_samples.append(sample)

    def event(self, name: str, now_ns: int, **values: Any) -> None:
        """Nothing that the judgement needs."""
