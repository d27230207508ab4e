"""What passes between the daemon and its monitor's process: a set-up, then samples one way, reports the other."""

import struct
from typing import Final

from msgspec import Struct

from drd.config.keys import Config
from drd.estimation.calibration import Calibration
from drd.monitor.findings import Finding, NotObservable

# One record: its kind, the time, four numbers. Of a gyro sample: interval, rate, temperature, nothing; of a wheel
# sample: interval, left, right, lost. GAP: samples were dropped before the next one.
RECORD: Final = struct.Struct("=Bq4d")
GAP, GYRO, WHEELS = range(3)
# A batch is one packet, which the socket takes whole or not at all. A tenth of a second of a 1000 Hz gyro.
BATCH_RECORDS: Final = 128
LARGEST_PACKET_BYTES: Final = 1 << 16


class Setup(Struct, frozen=True):
    """The first packet: what the monitor is made of."""

    config: Config
    calibration: Calibration | None


class Report(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What the process tells: after each block of samples, and why it ends (`error`) where it can.

    `notes`: what the system refused it. `cpu_s`, `memory_mb`: processor time so far, resident memory.
    """

    findings: list[Finding] = []
    not_observable: list[NotObservable] = []
    is_judging: bool = True
    samples: int = 0
    gaps: int = 0
    cpu_s: float = 0.0
    memory_mb: float = 0.0
    notes: list[str] = []
    error: str | None = None


def arguments() -> list[str]:
    """What starts the process: -P, since the folder that drd is started in is no place for modules."""
    return ["-P", "-m", "drd.service.monitor_process"]
