"""The worth of a prior: the first minutes of a drive that it has not seen, with it and without."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import numpy as np

from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD
from drd_tools.evaluate.replayed import poses_of
from drd_tools.fleet.prior import Expected, write_prior
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.nominal import with_model

SPANS_S: Final = (60.0, 120.0)


class Errors(NamedTuple):
    """Root mean square errors of the first `span_s` of a drive that begins on the reference."""

    span_s: float
    position_m: float
    heading_deg: float


def compare(folder: Path, expected: list[Expected], robot: str) -> tuple[list[Errors], list[Errors]]:
    """Errors of a recording by robot.yaml alone, and with the prior. Raises ConfigError."""
    recording = read_recording(folder)
    with TemporaryDirectory() as scratch:
        model, config = write_prior(expected, robot, Path(scratch))
        return errors(recording, None), errors(with_model(recording, model), config)


def errors(recording: Recording, config: Path | None) -> list[Errors]:
    """Errors of the daemon's estimator in the first minutes. Raises ConfigError where there is no reference."""
    log = recording.reference
    if log is None:
        raise ConfigError(str(recording.folder), "reference.csv", "a reference, to judge by", "none")
    poses = poses_of(replay_folder(recording, config), recording.name)
    begin_s = max(float(poses.time_s[0]), float(log.time_s[0]))
    at = log.time_s[(log.time_s >= begin_s) & (log.time_s <= poses.time_s[-1])]
    true = np.column_stack([np.interp(at, log.time_s, a) for a in (log.x_m, log.y_m, log.heading_rad)])
    mine = np.column_stack([np.interp(at, poses.time_s, poses.pose[:, i]) for i in range(3)])
    turned = true[0, 2] - mine[0, 2]
    c, s = np.cos(turned), np.sin(turned)
    moved = (mine - mine[0])[:, :2] @ np.array([[c, s], [-s, c]])
    off_m = np.hypot(*(moved - (true - true[0])[:, :2]).T)
    off_rad = np.angle(np.exp(1j * ((mine - mine[0])[:, 2] - (true - true[0])[:, 2])))
    found = []
    for span_s in SPANS_S:
        inside = at <= begin_s + span_s
        rms_m, rms_rad = (float(np.sqrt(np.mean(e[inside] ** 2))) for e in (off_m, off_rad))
        found.append(Errors(span_s, rms_m, rms_rad * DEG_PER_RAD))
    return found
