"""Rows of a lost gyro, which repeat the last reading, or zeros, and single impossible readings."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.batch.logs import FogLog
from drd_tools.diagnose.observe.audit import ALIKE_SHARE
from drd_tools.diagnose.observe.events import runs
from drd_tools.diagnose.observe.lost_reference import MOST_LOST
from drd_tools.recordings.folder import Recording

FEWEST_ALIKE: Final = 10  # readings
BY_CHANCE: Final = 1e-6  # expected runs of so many equal readings, at most: else the gyro's resolution is coarse
# Times its neighbours and nearly the largest value: a robot does not turn, or drive, so fast in one row alone.
LEAP: Final = 20.0
OUT_OF_BAND: Final = 3.0  # times the smallest reading: the wheels' yaw rate, with any tread, if no dead band reads zero


def without_lost_gyro(recording: Recording) -> Recording:
    """Leave out a gyro's rows that repeat one reading, if there are wheels, and impossible ones, and note it. (68)

    A reader that has lost the gyro repeats its last reading, or zeros. Neither is a dead band, which hides slow turns
    only, nor clipping, at the largest rate.
    """
    fog = recording.fog
    if fog is None:
        return recording
    is_lost = isolated(fog.rate_rad_s)
    notes = leaps("fog.csv", fog.time_s[is_lost])
    for first, last in _frozen(recording, fog) if recording.wheels is not None else ():
        is_lost[first + 1 : last + 1] = True
        begin_s, end_s = (float(fog.time_s[row]) for row in (first, last))
        notes.append(f"fog.csv repeats one reading from {begin_s:.1f} to {end_s:.1f} s: left out")
    if not notes or is_lost.mean() > MOST_LOST:
        return recording
    celsius = None if fog.temperature_c is None else fog.temperature_c[~is_lost]
    kept = replace(fog, time_s=fog.time_s[~is_lost], rate_rad_s=fog.rate_rad_s[~is_lost], temperature_c=celsius)
    return replace(recording, fog=kept, notes=(*recording.notes, *notes))


def _frozen(recording: Recording, fog: FogLog) -> list[tuple[int, int]]:
    """First and last row of each repeated reading."""
    rate, repeats = np.abs(fog.rate_rad_s), np.diff(fog.rate_rad_s) == 0.0
    found = [(first, last) for first, last in runs(repeats) if last - first + 1 >= FEWEST_ALIKE]
    if not found or not is_rare(repeats, found):
        return []
    left_rad, right_rad = recording.wheel_angles_rad()
    turned = np.cumsum(np.abs(np.diff(right_rad - left_rad, prepend=0.0)))
    turned *= recording.nominal.wheel_radius_m / recording.nominal.tread_m
    at_rad = np.interp(fog.time_s, recording.encoders.time_s, turned)
    smallest = float(np.percentile(rate[rate > 0.0], 1.0))

    def is_possible(first: int, last: int) -> bool:
        is_slow = at_rad[last] - at_rad[first] <= OUT_OF_BAND * smallest * (fog.time_s[last] - fog.time_s[first])
        return bool(rate[first] >= (1.0 - ALIKE_SHARE) * rate.max() or (rate[first] == 0.0 and is_slow))

    return [(first, last) for first, last in found if not is_possible(first, last)]


def isolated(values: Array) -> npt.NDArray[np.bool_]:
    """Which values (n,) are LEAP times as large as both neighbours and as the others of a moving robot."""
    size = np.abs(values)
    if np.count_nonzero(size) < FEWEST_ALIKE:
        return np.zeros(len(size), np.bool_)
    around = np.maximum(np.append(size[1:], 0.0), np.insert(size[:-1], 0, 0.0))
    leap: npt.NDArray[np.bool_] = size > LEAP * np.maximum(around, np.percentile(size[size > 0.0], 95.0))
    return leap


def leaps(file: str, at_s: Array) -> list[str]:
    """Note on rows of a file that leap, if any."""
    if not len(at_s):
        return []
    count = f"{len(at_s)} rows" if len(at_s) > 1 else "a row"
    return [f"{file} has {count} {LEAP:g} times as large as any neighbour, from {at_s[0]:.1f} s on: left out"]


def is_rare(repeats: npt.NDArray[np.bool_], found: Sequence[tuple[int, int]]) -> bool:
    """Whether FEWEST_ALIKE repeated rows (n,) in a row are no chance, given how many repeat outside the runs found."""
    is_single = np.ones(len(repeats), np.bool_)
    for first, last in found:
        is_single[first:last] = False
    share = float(repeats[is_single].mean()) if is_single.any() else 1.0
    return len(repeats) * share ** (FEWEST_ALIKE - 1) <= BY_CHANCE
