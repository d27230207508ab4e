"""Poses of a recording, replayed with its nominal model."""

from pathlib import Path

from drd.config.schema import ConfigError
from drd_tools.evaluate.trajectory import Poses, poses_of_rows
from drd_tools.recordings.folder import read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.result import Replayed, table


def replay_poses(folder: Path) -> Poses:
    """Replay the recording with the daemon's own estimator. Raises ConfigError."""
    recording = read_recording(folder)
    poses = poses_of(replay_folder(recording), recording.name)
    if len(poses.time_s) < 2:
        raise ConfigError(str(folder), "", "a recording that gives at least 2 poses", str(len(poses.time_s)))
    return poses


def poses_of(replayed: Replayed, name: str) -> Poses:
    """Start and all poses with their covariances and bounds."""
    return poses_of_rows(name, table(replayed), replayed.digest())
