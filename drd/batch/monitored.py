"""The monitor run over whole logs, with the findings that it would have made live, to the bit."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drd.batch.logs import EncoderLog, FogLog
from drd.batch.samples import check_times, gyro_samples, wheel_samples, zero_of
from drd.config.keys import Config
from drd.config.schema import ConfigError
from drd.monitor.constants import Constants
from drd.monitor.findings import Finding
from drd.monitor.monitor import Monitor
from drd.samples import GyroSample


@dataclass(frozen=True)
class Monitored:
    """`findings` at the end; `zero_ns`: the findings' time at which the logs' `time_s` is 0."""

    findings: list[Finding]
    zero_ns: int
    monitor: Monitor


def monitor_logs(
    fog: FogLog | None,
    encoders: EncoderLog,
    config: Config,
    watch: Callable[[Monitor], object] = lambda _: None,
    known: Constants | None = None,
) -> Monitored:
    """Monitor the samples that the daemon would have made of two logs. `watch` is called after each sample.

    `known`: the robot's constants from earlier drives, if any.

    Raises ConfigError where there is no gyro, or the logs do not overlap.
    """
    if fog is None:
        raise ConfigError("gyro", "", "a gyro: the monitor compares it with the wheels", "none")
    check_times(fog, encoders)
    zero_ns = zero_of(fog, encoders)
    wheels, _, _ = wheel_samples(encoders, config, zero_ns)
    gyro, _ = gyro_samples(fog, config, zero_ns)
    monitor = Monitor(config, known)
    samples: list[Any] = sorted([*gyro, *wheels], key=lambda s: s[0])  # stable
    for sample in samples:
        if isinstance(sample, GyroSample):
            monitor.gyro(sample)
        else:
            monitor.wheels(sample)
        watch(monitor)
    return Monitored(monitor.findings(), zero_ns, monitor)
