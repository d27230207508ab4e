"""Benefit of a prior: errors in the first minutes of a drive that it has not seen, with and without it."""

import math
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import numpy as np

from drd.units import DEG_PER_RAD
from drd_tools.evaluate.alignment import align
from drd_tools.evaluate.metrics import rms
from drd_tools.evaluate.replayed import poses_of
from drd_tools.evaluate.trajectory import associate, reference_of
from drd_tools.fleet.prior import Expected, write_prior
from drd_tools.recordings.folder import Recording, read_recording, wrapped
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.nominal import with_model

SPANS_S: Final = (60.0, 120.0)


class Errors(NamedTuple):
    """Root mean square errors over the first `span_s` of a drive that begins on the reference."""

    span_s: float
    position_m: float
    heading_deg: float


def compare(folder: Path, expected: list[Expected], robot: str) -> tuple[list[Errors], list[Errors]]:
    """Errors of a recording with robot.yaml alone, and with the prior. Raises ConfigError."""
    recording = read_recording(folder)
    with TemporaryDirectory() as scratch:
        model, config = write_prior(expected, robot, Path(scratch))
        return errors(recording, None), errors(with_model(recording, model), config)


def errors(recording: Recording, config: Path | None) -> list[Errors]:
    """Errors of the daemon's estimator in the first minutes. Raises ConfigError if there is no reference."""
    reference = reference_of(recording)
    poses = poses_of(replay_folder(recording, config), recording.name)
    pairs, _ = align(associate(poses, reference, math.inf), "start")
    off_m, off_rad = np.hypot(*pairs.error[:, :2].T), wrapped(pairs.error[:, 2])
    begin_s = max(float(poses.time_s[0]), float(reference.time_s[0]))
    found = []
    for span_s in SPANS_S:
        inside = pairs.time_s <= begin_s + span_s
        found.append(Errors(span_s, rms(off_m[inside]), rms(off_rad[inside]) * DEG_PER_RAD))
    return found
