"""The emulated robot of `drd demo` in simulated time: the samples that the daemon would give its monitor."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from drd.config.file import load_config
from drd.config.keys import Config
from drd.pipeline import Observer, Pipeline
from drd.samples import CanFrame, GyroSample, WheelSample
from drd_tools.emulate import encoder_frames, fog_packets
from drd_tools.emulate.sensors import SensorErrors, Sensors
from drd_tools.shipped import shipped_config
from drd_tools.simulate.missions import demo_drive
from drd_tools.simulate.truth import make_truth

# Mean transport jitter of packets and frames.
JITTER_S = 0.0005
BEFORE_S = 1000.0


class Kept(Observer):
    """Keeps the samples."""

    def __init__(self) -> None:
        self.samples: list[GyroSample | WheelSample] = []

    def gyro(self, sample: GyroSample) -> None:
        self.samples.append(sample)

    def wheels(self, sample: WheelSample) -> None:
        self.samples.append(sample)


def demo_config() -> Config:
    return load_config(shipped_config("demo.yaml")).value


def emulated(
    seed: int, seconds: float, slip: Callable[[float], tuple[float, float]] = lambda _: (0.0, 0.0)
) -> list[GyroSample | WheelSample]:
    """Samples of a demo's drive. `slip(t_s)`: share of extra counts, left and right."""
    config, errors, kept = demo_config(), SensorErrors(), Kept()
    drive = demo_drive(seconds, stand_s=config.estimation.static_bias.duration_s + 2.5)
    sensors = Sensors(make_truth(drive), config.robot, errors, seed)
    fog = fog_packets.make_encoder(config.fog)
    wheels = encoder_frames.WheelFrameEncoder(config.encoders, config.robot, Path())
    pipeline = Pipeline(config, Path("/"), lambda *_: None, [kept])
    gyro_s = 1.0 / (config.fog.rate_hz * (1.0 + errors.clock_error_percent / 100.0))
    wheels_s = 1.0 / config.encoders.rate_hz
    due = [(k * gyro_s, "gyro") for k in range(1, int(seconds / gyro_s))]
    due += [(k * wheels_s, "wheels") for k in range(1, int(seconds / wheels_s))]
    random, at_ns = np.random.default_rng([seed, 9]), 0
    for t_s, kind in sorted(due):
        at_ns = max(at_ns + 1, round((BEFORE_S + t_s + float(random.exponential(JITTER_S))) * 1e9))
        pipeline.tick(at_ns)
        if kind == "gyro":
            rate = sensors.rate_rad_s(t_s - gyro_s, t_s)
            pipeline.on_fog_bytes(fog.encode(rate, gyro_s, sensors.temperature_c(t_s)), at_ns)
        else:
            frames = wheels.encode(*sensors.travel_m(t_s, *slip(t_s)))
            pipeline.on_frames([CanFrame(at_ns, f.arbitration_id, f.is_extended_id, bytes(f.data)) for f in frames])
    return kept.samples
