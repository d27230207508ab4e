"""A recording's poses as numbers, with a model of its effects or without."""

from pathlib import Path

import numpy as np

from drd.arrays import Array
from drd_tools.recordings.folder import Recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.nominal import with_model
from drd_tools.replay.result import COLUMNS, table


def poses(recording: Recording, model: Path | None = None) -> Array:
    """The poses (n, columns), from the sensors alone; none without wheels. Raises ConfigError."""
    if recording.wheels is None:
        return np.zeros((0, len(COLUMNS)))
    return table(replay_folder(recording if model is None else with_model(recording, model)))
