"""One long run: laps with a fault each through the daemon's core, judged against the truth at every pose."""

import contextlib
import gc
import math
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from bench.cpu import BYTES_PER_MIB, usage
from tqdm import tqdm

from drd.config.keys import Config
from drd.config.schema import loads
from drd.pipeline import Observer, Pipeline
from drd.samples import Pose, Validity
from drd.units import RAD_PER_DEG, S_PER_NS
from soak.faults import FAULTS, Fault
from soak.ledger import Ledger, Row
from soak.monitor import Cost, Monitored
from soak.world import EPOCH_NS, LAP_S, STAND_S, STEP_S, Arrival, World, monotonic_ns

CONFIG: Final = """\
robot: {name: soak, wheel_radius_m: 0.11, tread_m: 0.6}
fog: {protocol: dsp17xx, latency_s: 0.008, rate_hz: 10}
encoders: {layout: cia406, counts_per_revolution: 20000, modulus_counts: 65536}
calibration: {file: calibration.yaml}
estimation: {gyro_scale: "yes", static_bias: {duration_s: 8, minimum_s: 5}}
"""
CALIBRATION: Final = """\
format: drd-gyro-calibration/1
error_deg_s: {a0: [0, 0, 0], a1: [0, 0, 0], a2: [0, 0, 0], a3: [0, 0, 0]}
rate_range_deg_s: [-120, 120]
temperature_range_c: [0, 60]
residual_deg_s: 0.001
provenance: {what: an ideal gyro, so that leaving the range can be seen}
"""
# Each lap begins as at a dock, so that no fault casts its shadow on the next one: the bias is measured, the filter
# starts anew, and a pose is set with these standard deviations.
DOCK_M: Final = 0.02
DOCK_RAD: Final = 0.3 * RAD_PER_DEG
DOCKED_S: Final = 1.0
MEASURED_S: Final = 11.0
# When in the lap its fault begins: the robot moves and turns.
ONSET_S: Final = (STAND_S + 5.0, STAND_S + 30.0)


@dataclass
class Found:
    """What was seen of one kind of fault, each time that it came. Times in s; inf: not before the lap's end.

    `beyond` of `valid` poses were farther from the truth than their bound, after the onset. `worst` and `worst_all`:
    largest error over bound, of the valid poses and of all.
    """

    fault: Fault
    detected_s: list[float] = field(default_factory=list)
    recovered_s: list[float] = field(default_factory=list)
    also: set[str] = field(default_factory=set)
    valid: int = 0
    beyond: int = 0
    worst: float = 0.0
    worst_all: float = 0.0


@dataclass
class Soak:
    """The whole run's result. Memory at the end of each round of all faults: MiB resident, and live blocks."""

    laps: int
    seconds: float = 0.0
    took_s: float = 0.0
    found: list[Found] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    resident_mib: list[float] = field(default_factory=list)
    blocks: list[int] = field(default_factory=list)
    early: set[str] = field(default_factory=set)
    valid: int = 0
    beyond: int = 0
    monitor: Cost | None = None  # None: there was none beside

    @property
    def drifted(self) -> list[Row]:
        """Counters that say something else than was handed over."""
        return [row for row in self.rows if row.counted != row.expected]


def soak(folder: Path, laps: int, seed: int, is_monitored: bool = False) -> Soak:
    """Drive so many laps, the faults in turn. `folder` takes the calibration file."""
    (folder / "calibration.yaml").write_text(CALIBRATION, encoding="utf-8")
    config = loads(CONFIG, Config).value
    if not is_monitored:
        return _Run(config, folder, laps, seed).run()
    with contextlib.closing(Monitored(config)) as monitored:
        result = _Run(config, folder, laps, seed, monitored).run()
    result.monitor = monitored.cost
    return result


class _Run:
    """The pipeline in its world, and the judge of its poses."""

    def __init__(self, config: Config, folder: Path, laps: int, seed: int, *beside: Observer):
        self._world = World(config, laps, seed)
        self._ledger = Ledger(config)
        self._pipeline = Pipeline(config, folder, self._on_pose, (self._ledger, *beside))
        self._result = Soak(laps, found=[Found(fault) for fault in FAULTS])
        self._poses = 0
        self._judged: Found | None = None  # of this lap, from the fault's onset on

    def run(self) -> Soak:
        """All laps."""
        result, began_s = self._result, time.perf_counter()
        for lap in tqdm(range(result.laps), desc="soak", unit=" laps", disable=None, leave=False):
            self._lap(lap, result.found[lap % len(FAULTS)])
            if (lap + 1) % len(FAULTS) == 0:
                gc.collect()
                result.blocks.append(sys.getallocatedblocks())
                result.resident_mib.append(usage(os.getpid()).resident_bytes / BYTES_PER_MIB)
        result.seconds, result.took_s = self._world.now_s, time.perf_counter() - began_s
        result.rows = list(self._ledger.rows(self._pipeline.counters(), self._poses))
        return result

    # ---- one lap

    def _lap(self, lap: int, found: Found) -> None:
        random, fault = self._world.random, found.fault
        onset_s = round(float(random.uniform(*ONSET_S)) / STEP_S) * STEP_S
        self._judged = None
        self._steps(lap * LAP_S + DOCKED_S)
        self._pipeline.calibrate_bias(self._now_ns())
        self._steps(lap * LAP_S + MEASURED_S)
        self._dock()
        for _ in self._steps_to(lap * LAP_S + onset_s):
            if lap and self._world.now_s % LAP_S > STAND_S:
                self._result.early |= {reason.source for reason in self._pipeline.reasons.active()}
        self._judged = found
        before = self._named()
        self._begin(fault)
        detected_s = self._watch(found, before, fault.seconds)
        self._end(fault)
        recovered_s = self._await_recovery((lap + 1) * LAP_S)
        found.detected_s.append(detected_s)
        found.recovered_s.append(recovered_s)

    def _watch(self, found: Found, before: dict[str, int], seconds: float) -> float:
        """The fault's time; how long it took to be named. It may be named until a second after its end."""
        began_s, detected_s = self._world.now_s, math.inf
        for _ in self._steps_to(began_s + seconds):
            new = {name for name, count in self._named().items() if count > before.get(name, 0)}
            found.also |= new
            if math.isinf(detected_s) and new & set(found.fault.named):
                detected_s = self._world.now_s - began_s
        return detected_s

    def _await_recovery(self, end_s: float) -> float:
        began_s, recovered_s = self._world.now_s, math.inf
        for _ in self._steps_to(end_s):
            if self._pipeline.reasons.validity is not Validity.VALID:
                recovered_s = math.inf
            elif math.isinf(recovered_s):
                recovered_s = self._world.now_s - began_s
        return recovered_s

    def _named(self) -> dict[str, int]:
        """Reasons that stand, and the counters of inputs and estimator that name troubles."""
        names = {reason.source: 1 for reason in self._pipeline.reasons.active()}
        for part, counters in self._pipeline.counters().items():
            names |= {f"{part}.{name}": count for name, count in counters.items() if name not in USUAL}
        return names

    def _begin(self, fault: Fault) -> None:
        if fault.port is not None:
            self._read(self._world.under_way())
            source, text = fault.port
            self._pipeline.port_state(source, text, self._now_ns())
            if source == "fog.port":
                self._ledger.gyro_port_lost()
        self._world.begin(fault)

    def _end(self, fault: Fault) -> None:
        if fault.port is not None:
            self._pipeline.port_state(fault.port[0], None, self._now_ns())
        self._world.end()

    def _dock(self) -> None:
        """The true pose, with errors as large as is said."""
        truth, random = self._world.drive.at(self._world.now_s), self._world.random
        dx_m, dy_m, turned_rad = (float(z) for z in random.standard_normal(3) * (DOCK_M, DOCK_M, DOCK_RAD))
        x_m, y_m, heading_rad = truth.x_m + dx_m, truth.y_m + dy_m, truth.heading_rad + turned_rad
        self._pipeline.reset(self._now_ns())
        self._pipeline.set_pose(self._now_ns(), x_m, y_m, heading_rad, DOCK_M, DOCK_RAD)

    # ---- time

    def _now_ns(self) -> int:
        return monotonic_ns(self._world.now_s)

    def _steps(self, end_s: float) -> None:
        for _ in self._steps_to(end_s):
            pass

    def _steps_to(self, end_s: float) -> Iterator[None]:
        while self._world.now_s < end_s - STEP_S / 2:
            self._read(self._world.step())
            if not self._world.is_stalled:
                self._pipeline.tick(monotonic_ns(self._world.now_s))
            yield

    def _read(self, arrivals: Sequence[Arrival]) -> None:
        """Hand over what arrived; bytes at the time at which they are read, frames with the kernel's stamp."""
        for t_s, _, content in arrivals:
            if isinstance(content, bytes):
                self._ledger.gyro_bytes(content, self._world.packets)
                self._pipeline.on_fog_bytes(content, monotonic_ns(max(t_s, self._world.read_from_s)))
            else:
                self._ledger.frame(content)
                self._pipeline.on_frames([content])

    # ---- the judge

    def _on_pose(self, pose: Pose, _: int) -> None:
        self._poses += 1
        truth = self._world.drive.at((pose.t_ns - EPOCH_NS) * S_PER_NS)
        ratio = math.hypot(pose.x_m - truth.x_m, pose.y_m - truth.y_m) / pose.position_bound_m
        is_valid = pose.validity is Validity.VALID
        self._result.valid += is_valid
        self._result.beyond += is_valid and ratio > 1.0
        found = self._judged
        if found is None:
            return
        found.worst_all = max(found.worst_all, ratio)
        if is_valid:
            found.valid += 1
            found.beyond += ratio > 1.0
            found.worst = max(found.worst, ratio)


# Counters that rise while all is well.
USUAL: Final = frozenset(
    ("frames", "samples", "poses", "accepted", "left_wraps", "right_wraps", "unpaired", "bias_measured")
)


def rounds_for(hours: float) -> int:
    """Laps that fill so many hours, in whole rounds of all faults; one at least."""
    return max(1, round(hours * 3600.0 / LAP_S / len(FAULTS))) * len(FAULTS)
