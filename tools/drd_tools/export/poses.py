"""Poses to export: those that were published in a recording, or those of a replay."""

from collections.abc import Sequence
from itertools import chain, pairwise
from operator import attrgetter
from pathlib import Path
from typing import Final, NamedTuple

from drd.batch.run import latest
from drd.config.keys import Config, Output
from drd.config.schema import ConfigError, loads
from drd.output.cdr import Diagnostic
from drd.output.diagnostics import diagnostics
from drd.recording.in_force import IN_FORCE
from drd.recording.topics import POSE
from drd.samples import Pose
from drd.units import S_PER_NS
from drd_tools.recordings.folder import read_recording
from drd_tools.recordings.mcap_file import McapFile, nanoseconds, open_run
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.mcap_source import recorded_pose, replay_mcap
from drd_tools.replay.result import Replayed

HEALTH: Final = "/health"
AHEAD_S: Final = 1.0  # least step of the wall clock to report; smaller ones are normal clock adjustments


class Stamped(NamedTuple):
    """A pose and its time in ns: on the wall clock, or the folder's own."""

    stamp_ns: int
    pose: Pose


class Exported(NamedTuple):
    """Poses in order, one for each time, and the health with its times; `zero_ns`: `pose.t_ns` at time_s = 0.

    `output` has the frames' names. `notes`: where the poses come from, and what the reader should know.
    """

    poses: list[Stamped]
    health: list[tuple[int, list[Diagnostic]]]
    output: Output
    zero_ns: int
    notes: list[str]


def read_poses(path: Path) -> Exported:
    """Read the poses of a recording of the daemon or a recording folder. Raises ConfigError."""
    if path.suffix == ".mcap" and not path.is_dir():
        return _of_daemon(path)
    replayed = replay_folder(read_recording(path))
    notes = ["poses of a replay, as `drd replay` gives them: the folder holds none", *replayed.notes]
    return _of_replay(replayed, 0, notes)


def _of_daemon(file: Path) -> Exported:
    run = open_run(file)
    poses, health = _recorded(run.parts)
    if not poses:
        note = "poses of a replay, as `drd replay` gives them: the recording holds none"
        replayed = replay_mcap(file)
        return _of_replay(replayed, run.wall_ns, [note, *replayed.notes])
    notes = ["poses as they were published", *run.notes()]
    if any(b.stamp_ns <= a.stamp_ns for a, b in pairwise(poses)):
        notes.append("the wall clock was set on the way: times count on from the start instead, of poses only")
        poses = [Stamped(run.wall_ns + pose.t_ns - run.started_ns, pose) for _, pose in poses]
        health = []
    zeros_ns = [stamp_ns - pose.t_ns for stamp_ns, pose in poses]
    ahead_s = max((b - a for a, b in pairwise(zeros_ns)), default=0) * S_PER_NS
    if ahead_s > AHEAD_S:
        text = f"the wall clock went ahead by {ahead_s:.1f} s at once (set on the way, or the machine slept)"
        notes.append(f"{text}: times have that gap")
    text = run.parts[-1].attachments[IN_FORCE].decode("utf-8", "replace")
    output = loads(text, Config, f"{file}, {IN_FORCE}").value.output
    return Exported(poses, health, output, run.started_ns, notes)


def _recorded(parts: Sequence[McapFile]) -> tuple[list[Stamped], list[tuple[int, list[Diagnostic]]]]:
    """Read poses and health. Raises ConfigError if drd did not write them."""
    poses: list[Stamped] = []
    health: list[tuple[int, list[Diagnostic]]] = []
    for message in chain.from_iterable(part.messages(POSE, HEALTH) for part in parts):
        try:
            value = message.value()
            stamp_ns = nanoseconds(value["wall_ns"])
            if message.topic == POSE:
                poses.append(Stamped(stamp_ns, recorded_pose(value)))
            else:
                health.append((stamp_ns, diagnostics(value)))
        except (KeyError, OverflowError, TypeError, ValueError) as error:
            where = f"{parts[-1].path}, {message.topic}, number {message.number}"
            raise ConfigError(where, "", "what drd writes there", repr(error)) from error
    return latest(poses, attrgetter("pose.t_ns")), health


def _of_replay(replayed: Replayed, wall_ns: int, notes: list[str]) -> Exported:
    zero_ns = replayed.zero_ns
    poses = [Stamped(wall_ns + pose.t_ns - zero_ns, pose) for pose in latest(replayed.poses)]
    return Exported(poses, [], replayed.config.output, zero_ns, notes)
