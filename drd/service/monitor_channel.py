"""Messages between the daemon and its monitor's process: a set-up, then samples one way, reports the other."""

import struct
from typing import Final

from msgspec import Struct

from drd.config.keys import Config
from drd.estimation.applied import Constant
from drd.estimation.calibration import Calibration
from drd.monitor.constants import Constants
from drd.monitor.findings import Finding, NotObservable, Suspicion
from drd.monitor.memory import Day, Memory

# One record: kind, time, four numbers. For a gyro sample: interval, rate, temperature, nothing; for a wheel sample:
# interval, left, right, lost; for a pose that was set: x, y, sigma, nothing. GAP: samples were dropped before the next
# one. CLOCK: the wall clock was set; the time is that of the wall clock when the samples' clock is 0.
RECORD: Final = struct.Struct("=Bq4d")
GAP, GYRO, WHEELS, FIX, CLOCK = range(5)
# A batch is one packet, which the socket takes entirely or not at all: a tenth of a second of a 1000 Hz gyro.
BATCH_RECORDS: Final = 128
LARGEST_PACKET_BYTES: Final = 1 << 16
# Python's arguments for the process. -P: do not import modules from the working directory.
ARGUMENTS: Final = ("-P", "-m", "drd.service.monitor_process")


class Setup(Struct, frozen=True):
    """The first packet, from which the monitor is built. `memory`: from earlier drives with the same `basis`.

    `wall_zero_ns`: the wall clock when the samples' clock is 0; `began_ns`: the samples' clock now.
    """

    config: Config
    calibration: Calibration | None
    basis: str = ""
    memory: Memory | None = None
    wall_zero_ns: int = 0
    began_ns: int = 0


class Report(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A report of the process: after each block of samples and, if possible, on why it ends (`error`).

    `day`: the constants of the drive so far, `known`: those that it began with,
    `began_ns`: the time of its first sample. `wanted`: constants that the estimator may adopt, see Applying.
    `notes`: requests that the system refused. `tread_wanders`: see Monitor.wanders.
    `cpu_s`, `memory_mb`: processor time so far, resident memory.
    """

    findings: list[Finding] = []
    suspected: Suspicion | None = None
    not_observable: list[NotObservable] = []
    is_judging: bool = True
    tread_wanders: float = 0.0
    samples: int = 0
    gaps: int = 0
    cpu_s: float = 0.0
    memory_mb: float = 0.0
    day: Day | None = None
    known: Constants | None = None
    began_ns: int | None = None
    wanted: dict[str, Constant | None] = {}
    notes: list[str] = []
    error: str | None = None
