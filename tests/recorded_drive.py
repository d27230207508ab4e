"""A recorded drive through a pipeline without ports or clock, for tests."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from bench.robot import Circle

from drd.config.keys import Config
from drd.config.schema import Loaded, loads
from drd.pipeline import Pipeline
from drd.recording.recorder import Recorder
from drd.samples import Pose

CONFIG = """\
robot: {{name: my robot/1, wheel_radius_m: 0.11, tread_m: 0.6}}
fog: {{protocol: ecore, port: /nowhere/fog}}
encoders: {{layout: cia406, interface: slcan, channel: /nowhere/can,
  counts_per_revolution: 20000, modulus_counts: 65536}}
calibration: {{file: {calibration}}}
estimation: {{static_bias: {{duration_s: 2, minimum_s: 0.5}}}}
recording: {{enabled: true, folder: {folder}, {recording}}}
"""
CALIBRATION = """\
format: drd-gyro-calibration/1
error_deg_s: {a0: [0.1, 0.002, 0], a1: [0.003, 0, 0], a2: [0, 0, 0], a3: [1.0e-7, 0, 0]}
rate_range_deg_s: [-90, 90]
temperature_range_c: [-10, 50]
residual_deg_s: 0.003
provenance: {who: a test}
"""


@dataclass
class Drive:
    """The recorder, and the live pipeline's output."""

    loaded: Loaded[Config]
    base: Path
    poses: list[Pose] = field(default_factory=list)

    def start(self) -> Recorder:
        """A new recorder and a pipeline that hands everything to it."""
        self.recorder = Recorder(self.loaded, self.base)
        self.pipeline = Pipeline(self.loaded.value, self.base, self._on_pose, [self.recorder])
        self.recorder.start()
        return self.recorder

    def run(self, seconds: float, between: Callable[[int], None] | None = None) -> None:
        """Drive circles, with ticks, a lost port and commands; call `between` after each tick with its count."""
        arrivals = Circle(self.loaded.value).arrivals(seconds)
        due_ns, ticks = 0, itertools.count(1)
        for t_ns, data in arrivals:
            while due_ns <= t_ns:
                count = next(ticks)
                self.pipeline.tick(due_ns)
                self._disturb(count, due_ns)
                due_ns += 50_000_000
                if between is not None:
                    between(count)
            if isinstance(data, bytes):
                self.pipeline.on_fog_bytes(data[: len(data) // 2], t_ns)
                self.pipeline.on_fog_bytes(data[len(data) // 2 :], t_ns + 1_000)
            else:
                self.pipeline.on_frames(data)

    def _disturb(self, tick: int, now_ns: int) -> None:
        if tick == 100:
            self.pipeline.port_state("fog.port", "lost /dev/fog: unplugged", now_ns)
        elif tick == 110:
            self.pipeline.port_state("fog.port", None, now_ns)
        elif tick == 150:
            self.pipeline.set_pose(now_ns, 1.0 / 3.0, -math.pi, 0.1, 0.2, 0.0)
        elif tick == 160:
            self.pipeline.calibrate_bias(now_ns)
        elif tick == 250:
            self.pipeline.reset(now_ns)

    def _on_pose(self, pose: Pose, _: int) -> None:
        self.poses.append(pose)
        self.recorder.pose(pose, pose.t_ns + 1_700_000_000_000_000_000)


def drive(folder: Path, recording: str = "flush_s: 0.1", calibration: bool = True) -> Drive:
    """Make a drive. `recording`: more keys of that section. The configuration is in `folder`, recordings in records."""
    (folder / "calibration.yaml").write_text(CALIBRATION)
    file = folder / "robot.yaml"
    file.write_text(
        CONFIG.format(
            folder=folder / "records", recording=recording, calibration="calibration.yaml" if calibration else "null"
        )
    )
    return Drive(loads(file.read_text(), Config, str(file)), folder)


def recordings(folder: Path) -> list[Path]:
    """All parts, in order."""
    return sorted((folder / "records").glob("*.mcap"))
