"""The file of the monitor's knowledge of a robot: written and read exactly, checked, and kept over restarts."""

import dataclasses
import hashlib
import logging
from itertools import pairwise
from typing import Any, Final

import msgspec
from msgspec import structs

from drd.config.keys import Config
from drd.estimation.basis import Basis
from drd.estimation.calibration import Calibration
from drd.monitor.memory import Day, Memory, remember
from drd.state.sealed import StateError, sealed, unsealed
from drd.state.store import Store, state_file

log = logging.getLogger(__name__)

VERSION: Final = 1


def encoded(memory: Memory) -> bytes:
    """The file's bytes."""
    return sealed("memory", VERSION, msgspec.json.encode(memory) + b"\n")


def decoded(data: bytes) -> Memory:
    """The inverse of `encoded`. Raises StateError; nothing else escapes."""
    body = unsealed("memory", VERSION, data)
    try:
        found = msgspec.json.decode(body, type=Memory)
    except (ValueError, RecursionError) as error:
        raise StateError(str(error)[:200]) from error
    if any(b.wall_ns < a.wall_ns for a, b in pairwise(found.days)):
        raise StateError("its days are not in order of time")
    return found


def digest_of(basis: Basis) -> str:
    """Digest of all that the constants are relative to: with another meaning of the readings, none applies."""
    latencies = [basis.lag[f"{sensor}.latency_s"] for sensor in ("encoders", "fog")]
    return hashlib.sha256(repr((basis.wheels, basis.gyro, latencies)).encode()).hexdigest()


def first_digest_of(config: Config, calibration: Calibration | None) -> str:
    """The digest used in the first files, of sizes, calibration and latencies only."""
    robot, encoders, fog = config.robot, config.encoders, config.fog
    parts = (
        robot.wheel_radius_m, robot.left_scale, robot.right_scale, robot.tread_m, encoders.counts_per_revolution,
        encoders.latency_s, fog.latency_s, None if calibration is None else dataclasses.asdict(calibration),
    )  # fmt: skip
    return hashlib.sha256(repr(parts).encode()).hexdigest()


class MemoryKeeper:
    """Keeps a robot's memory in a file beside its state. An unusable file is put aside, and counted."""

    def __init__(self, config: Config):
        file = state_file(config)
        self._store = Store(file.with_suffix(".memory"), encoded, decoded) if file is not None else None
        self._before: Memory | None = None
        self._memory: Memory | None = None

    def begin(self) -> None:
        """Read the file. Call once, before anything else."""
        if self._store is None:
            return
        try:
            self._memory = self._store.load()
        except StateError as error:
            log.warning("monitor: nothing is remembered: %s", error)
        self._store.start()

    def memory(self, basis: str, first: str = "") -> Memory | None:
        """Constants with which the next drive begins; None if nothing is kept. `first`: see first_digest_of."""
        if self._store is None:
            return None
        if self._memory is not None and self._memory.basis == first:
            self._memory = structs.replace(self._memory, basis=basis)
        if self._memory is None or self._memory.basis != basis:
            self._memory = Memory(basis)
        self._before = self._memory
        return self._before

    def put(self, day: Day) -> None:
        """Remember the drive so far, replacing what was put of it before."""
        if self._store is None or self._before is None:
            return
        memory = remember(self._before, day)
        if memory != self._memory:
            self._memory = memory
            self._store.put(memory)

    def close(self, deadline_s: float) -> bool:
        """Write what is waiting; False if the disk did not take it in time."""
        return self._store is None or self._store.close(deadline_s)

    def health(self) -> dict[str, Any] | None:
        """Days, file, trouble and counters; None where nothing is kept."""
        if self._store is None:
            return None
        return {"days": len(self._memory.days) if self._memory is not None else 0, **self._store.health()}
