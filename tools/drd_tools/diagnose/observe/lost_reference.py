"""Rows of a lost reference, which repeat the last pose, or zeros, while the robot moves, and single poses elsewhere."""

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array, cumulative
from drd_tools import robust
from drd_tools.calibrate.wheels.drive import MOST_LAG_S
from drd_tools.diagnose.observe.comparable import MOST_M_S
from drd_tools.diagnose.observe.events import runs
from drd_tools.diagnose.observe.evidence import datasheet_noise
from drd_tools.diagnose.observe.lost_rows import MOST_LOST
from drd_tools.recordings.folder import Recording, ReferenceLog, at_rows, wrapped

LEAST_M: Final = 0.05  # of travel: a reference of a few digits, or one that rounds to a grid, repeats less
LEAST_SIGMAS: Final = 5.0  # of the reference's noise: poses of a moving robot do not repeat to the last digit
FAR: Final = 3.0  # times the wheels' travel: with a stopped counter, which halves it, and radii half as large again
LAGS_S: Final = np.linspace(0.0, MOST_LAG_S, 5)  # of the reference: what it says at rest, it says late


def without_lost_reference(recording: Recording) -> tuple[Recording, float]:
    """Leave out the rows of a lost reference; also the time that they cover, s. Without wheels, none is known. (71)

    A tracker that has lost the robot repeats its last pose, or writes zeros. Taken for a robot at rest, that is slip.
    """
    reference = recording.reference
    if reference is None or recording.wheels is None:
        return recording, 0.0
    pose = np.column_stack([reference.x_m, reference.y_m, reference.heading_rad])
    repeats = (np.diff(pose, axis=0) == 0.0).all(axis=1)
    is_lost, travel = np.zeros(len(pose), np.bool_), _Travel(recording, reference)
    is_lost[1:-1] = travel.is_far[:-1] & travel.is_far[1:]  # single poses
    for first, last in runs(repeats):
        is_lost[first : last + 1] = travel.lost(first, last)
    if not is_lost.any() or is_lost.mean() > MOST_LOST:
        return recording, 0.0
    held_s = float(np.diff(reference.time_s, prepend=reference.time_s[0])[is_lost].sum())
    kept = np.flatnonzero(~is_lost)
    columns = at_rows(reference, kept) | {"heading_rad": _continuous(reference.heading_rad, kept)}
    return replace(recording, reference=replace(reference, **columns)), held_s


def _continuous(heading_rad: Array, kept: npt.NDArray[np.intp]) -> Array:
    """Headings of the rows `kept`, without the whole turns that lost rows of another heading between them added."""
    before, turned = kept[:-1], np.diff(heading_rad[kept])
    is_torn = (np.diff(kept) > 1) & (heading_rad[before + 1] != heading_rad[before])
    turned[is_torn] = wrapped(turned[is_torn])
    headings: Array = heading_rad[kept[0]] + cumulative(turned)
    return headings


class _Travel:
    """The wheels' travel between rows of the reference, for any of its possible lags."""

    def __init__(self, recording: Recording, reference: ReferenceLog):
        angles_rad = np.array(recording.wheel_angles_rad())
        path_m = cumulative(recording.nominal.wheel_radius_m * np.abs(np.diff(angles_rad)).mean(axis=0))
        late_s = reference.time_s[:, None] - LAGS_S
        self._path_m = np.interp(late_s, recording.encoders.time_s, path_m)
        at_m = np.column_stack([reference.x_m, reference.y_m])
        # The stated noise may be too small.
        sizes_m = datasheet_noise(recording.nominal).position_m, *map(robust.scatter, at_m.T)
        self._limit_m = max(LEAST_M, LEAST_SIGMAS * max(sizes_m))
        # In a gap of the wheels, any travel is possible.
        gaps_s = cumulative(recording.wheel_gaps() * np.diff(recording.encoders.time_s))
        unseen_m = MOST_M_S * np.interp(late_s, recording.encoders.time_s, gaps_s)
        between_m = np.diff(self._path_m + unseen_m, axis=0).max(axis=1)
        # Whether the reference moves further from each row to the next than the wheels drive.
        self.is_far = np.hypot(*np.diff(at_m, axis=0).T) > FAR * between_m + self._limit_m

    def lost(self, first: int, last: int) -> npt.NDArray[np.bool_] | bool:
        """Which rows of a repeated pose are lost, of `first` to `last`; the first is none if the robot was there."""
        is_far_before = first == 0 or bool(self.is_far[first - 1])
        is_far_after = last == len(self.is_far) or bool(self.is_far[last])
        if (self._path_m[last] - self._path_m[first]).min() > self._limit_m:
            is_there = not (is_far_before if first else is_far_after)
            return np.arange(last - first + 1) >= is_there
        return is_far_before and is_far_after
