"""Perfect sensors of a driving robot, as samples for the estimator's tests."""

import math
from collections.abc import Iterable, Iterator

from drd.config.keys import Config
from drd.config.schema import loads
from drd.estimation.calibration import Calibration
from drd.estimation.estimator import Estimator
from drd.samples import GyroSample, Pose, WheelSample

S = 1_000_000_000
T0 = 1000 * S
ROBOT = "robot: {wheel_radius_m: 0.1, tread_m: 0.5}\n"
NO_BIAS = ROBOT + "estimation: {static_bias: {duration_s: 0}}\n"
# A robot without anything to be determined first.
KNOWN = """\
robot: {wheel_radius_m: 0.1, tread_m: 0.5, drive: differential}
estimation: {static_bias: {duration_s: 0}, initial: {wheel_lag_s: 0}}
"""
Sample = GyroSample | WheelSample


def make(text: str = NO_BIAS, calibration: Calibration | None = None, resolution_m: float = 1e-4) -> Estimator:
    config = loads(text, Config).value
    return Estimator(config, calibration, resolution_m, publish_on=config.output.publish_on)


def turn(t_s: float) -> float:
    return 0.4 * math.sin(0.8 * t_s)


def drive(
    seconds: float, speed_m_s: float = 1.0, stand_s: float = 0.0, bias_rad_s: float = 0.0, start_s: float = 0.0,
    tread_m: float = 0.5,
) -> Iterator[tuple[float, Sample]]:  # fmt: skip
    """Perfect sensors of a robot that stands and then drives a slalom: (arrival time, sample)."""

    def heading(t_s: float) -> float:
        return 0.5 * (1.0 - math.cos(0.8 * (t_s - stand_s))) if t_s > stand_s else 0.0

    for step in range(1, round(seconds * 20) + 1):
        end_s = start_s + step / 20
        before_s = end_s - 0.05
        dpsi = heading(end_s - start_s) - heading(before_s - start_s)
        u = speed_m_s * 0.05 if before_s - start_s >= stand_s - 1e-9 else 0.0
        half = 0.5 * tread_m * dpsi
        yield end_s, WheelSample(T0 + round(end_s * S), 0.05, u - half, u + half, 0.0)
        if step % 2 == 0:
            rate = (heading(end_s - start_s) - heading(end_s - 0.1 - start_s)) / 0.1 + bias_rad_s
            yield end_s, GyroSample(T0 + round(end_s * S), 0.1, rate, 25.0)


def feed(e: Estimator, samples: Iterable[tuple[float, Sample]]) -> list[Pose]:
    poses = []
    for _, sample in samples:
        pose = e.add_gyro(sample) if isinstance(sample, GyroSample) else e.add_wheels(sample)
        if pose is not None:
            poses.append(pose)
    return poses


def final(poses: list[Pose]) -> tuple[float, float, float]:
    return poses[-1].x_m, poses[-1].y_m, poses[-1].heading_rad
