"""Events: effects found by logic before any regression."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drd_tools.diagnose.selected import Selected


@dataclass(frozen=True)
class Event:
    """A selected effect found by logic: `windows` (s), `nats` of evidence, and a text on what was `seen`."""

    selected: Selected
    windows: tuple[tuple[float, float], ...]
    nats: float
    seen: str


def runs(flags: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and past-the-end index of each run of True."""
    edge = np.diff(np.concatenate([[False], flags, [False]]).astype(int))
    return list(zip(np.flatnonzero(edge == 1).tolist(), np.flatnonzero(edge == -1).tolist(), strict=True))
