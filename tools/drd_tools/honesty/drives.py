"""Real drives: the shared recordings of two robots."""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from drd.config.keys import Config
from drd_tools.calibrate.wheels.drive import Mounting
from drd_tools.evaluate.trajectory import Reference, reference_of
from drd_tools.honesty import configurations as c
from drd_tools.honesty.baselines import baselines
from drd_tools.honesty.figures import Estimated, Figures, Yardstick, figures_of
from drd_tools.honesty.results import Judged
from drd_tools.recordings.folder import Recording, read_recording

# Next to the checkout; never part of it.
SHARED: Final = Path(__file__).resolve().parents[4] / "shared" / "recordings"
# Each fifth of a robot's drives is judged with wheels calibrated on the other four; with five drives, on all others.
FOLDS: Final = 5


@dataclass(frozen=True)
class Robot:
    """A robot's drives, by prefixes of their folders' names, one for each group.

    `allowed_m`, `moving_m_s`: see `Yardstick`. `each_alone`: a group is a single drive.
    """

    kinds: tuple[str, ...]
    allowed_m: float
    moving_m_s: float
    each_alone: bool = False


ROBOTS: Final = {
    # Lidar ICP: jumps and a lever arm of some centimetres; at rest its rows show up to 0.1 m/s.
    "warthog": Robot(("warthog_",), 0.07, 0.1, each_alone=True),
    # Motion capture, better than a millimetre, but its first row turns the whole path: 0.1 deg over 2 m.
    "optiodom": Robot(("optiodom_circular", "optiodom_square", "optiodom_ivanjko"), 0.005, 0.03),
}


def drives_of(robot: str, shared: Path = SHARED) -> list[Path]:
    """List the robot's recording folders in the order of their kinds; none without the shared recordings."""
    return [folder for kind in ROBOTS[robot].kinds for folder in sorted(shared.glob(f"{kind}*")) if folder.is_dir()]


def judge_fold(robot: str, fold: int, shared: Path = SHARED) -> list[Judged]:
    """Judge each drive of the fold, with wheels calibrated on all drives of the robot outside it."""
    folders = drives_of(robot, shared)
    judged, others = folders[fold::FOLDS], [f for i, f in enumerate(folders) if i % FOLDS != fold]
    with tempfile.TemporaryDirectory() as place:
        recordings = [read_recording(folder) for folder in others]
        found = c.calibrate(recordings, Path(place) / "wheels.yaml") if recordings else None
        return [_judge(ROBOTS[robot], read_recording(folder), found) for folder in judged]


def _judge(robot: Robot, recording: Recording, found: c.Calibration | None) -> Judged:
    reference = reference_of(recording)
    if found is not None:
        reference = at_centre(reference, found.mounting)
    yardstick = Yardstick(reference, False, robot.allowed_m, robot.moving_m_s)
    group = recording.name if robot.each_alone else next(filter(recording.name.startswith, robot.kinds))
    wheels = None if found is None else found.file
    return Judged("real", group, recording.name, all_figures(recording, wheels, yardstick))


def at_centre(reference: Reference, mounting: Mounting) -> Reference:
    """Transform the reference to the robot's centre and heading."""
    x_m, y_m, heading = reference.pose.T
    heading = heading - mounting.heading_rad
    cos, sin = np.cos(heading), np.sin(heading)
    ahead_m, left_m = mounting.forward_m, mounting.left_m
    pose = np.column_stack([x_m - cos * ahead_m + sin * left_m, y_m - sin * ahead_m - cos * left_m, heading])
    return replace(reference, pose=pose)


def all_figures(
    recording: Recording, wheels: Path | None, yardstick: Yardstick, drawn: Config | None = None
) -> dict[str, Figures]:
    """Figures of every configuration and baseline that the recording allows.

    `wheels`: a calibration on other drives; `drawn`: distributions from which a simulated robot was drawn.
    """
    found = {c.DEFAULT: c.estimated(recording)}
    if wheels is not None:
        found[c.CALIBRATED] = c.estimated(recording, wheels)
    found[c.PAPER] = c.estimated(c.with_paper_profile(recording))
    found |= {name: Estimated(poses) for name, poses in baselines(recording).items()}
    figures = {name: figures_of(one, yardstick) for name, one in found.items()}
    return figures | c.limits(recording, drawn)
