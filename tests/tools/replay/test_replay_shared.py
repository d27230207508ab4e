"""Every shared recording and trial can be replayed as it is, with its nominal model."""

import dataclasses
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.reference import end_error
from drd_tools.replay.result import table

SHARED = Path(__file__).resolve().parents[3].parent / "shared"
LONGEST_S = 90.0
# Of the way. Nominal models are wrong, some by as much as a skid-steer robot's tread; a sign or a unit would be 1.
WORST = 0.25
STANDS_M = 0.01  # within its first seconds a robot may stand


@pytest.mark.recordings
def test_every_shared_recording_and_trial_is_replayed() -> None:
    folders = [file.parent for file in sorted(SHARED.glob("*/*/robot.yaml"))]
    if not folders:
        pytest.skip("the shared recordings are not here")
    kinds = set()
    for folder in folders:
        recording = read_recording(folder)
        kinds.add((recording.fog is not None, recording.fog is not None and recording.fog.temperature_c is not None))
        recording = first_seconds(recording)
        replayed = replay_folder(recording)
        rows, error = table(replayed), end_error(replayed, recording)
        assert len(rows) >= len(recording.encoders.time_s), folder
        assert np.isfinite(rows).all(), folder
        assert (np.diff(rows[:, 0]) > 0.0).all(), folder
        assert rows[0, 1:].tolist() == [0.0] * 11, folder
        assert (error is None) == (recording.reference is None), folder
        assert error is None or error.position_m < max(WORST * error.reference_m, STANDS_M), folder
        assert replayed.counters["encoders"] == {"gaps": 0, "jumps": 0}, folder
    assert kinds == {(False, False), (True, False), (True, True)}


def first_seconds(recording: Recording) -> Recording:
    """The recording, cut short to save time."""
    end_s = recording.encoders.time_s[0] + LONGEST_S
    logs = {}
    for name in ("wheels", "fog", "reference"):
        log = getattr(recording, name)
        if log is not None:
            keep = log.time_s <= end_s
            columns = {f.name: getattr(log, f.name) for f in dataclasses.fields(log)}
            logs[name] = replace(log, **{key: c[keep] for key, c in columns.items() if c is not None})
    return replace(recording, **logs)
