"""The decoded samples of a pipeline, kept for judging the wiring."""

from drd.config.keys import Robot
from drd.pipeline import Observer, Pipeline
from drd.samples import GyroSample, WheelSample
from drd.wiring.findings import Finding, Statement
from drd.wiring.judge import Geometry, judge


class Samples(Observer):
    """Keeps the samples of a pipeline that it observes, and counts the gyro's bytes."""

    def __init__(self) -> None:
        self.gyro_samples: list[GyroSample] = []
        self.wheel_samples: list[WheelSample] = []
        self.byte_count = 0

    def judge(self, pipeline: Pipeline, robot: Robot, said: Statement | None = None) -> list[Finding]:
        """Findings about the kept samples; `robot` is the pipeline's configuration."""
        geometry = Geometry(robot.tread_m, pipeline.encoders.resolution_m, pipeline.fog is not None)
        return judge(self.gyro_samples, self.wheel_samples, geometry, said)

    def fog_bytes(self, data: bytes, arrival_ns: int) -> None:  # noqa: ARG002  # the observer's form
        """Bytes from the gyro's serial line."""
        self.byte_count += len(data)

    def gyro(self, sample: GyroSample) -> None:
        """A gyro sample."""
        self.gyro_samples.append(sample)

    def wheels(self, sample: WheelSample) -> None:
        """A sample of both wheels."""
        self.wheel_samples.append(sample)
