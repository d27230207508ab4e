"""Rows of a lost gyro, which repeat the last reading, or zeros, and single impossible readings."""

from dataclasses import replace
from typing import Final

import numpy as np

from drd.batch.logs import FogLog
from drd_tools.diagnose.observe.audit import ALIKE_SHARE
from drd_tools.diagnose.observe.events import runs
from drd_tools.diagnose.observe.lost_rows import FEWEST_ALIKE, MOST_LOST, is_rare, isolated, notes
from drd_tools.recordings.folder import Recording, at_rows

OUT_OF_BAND: Final = 3.0  # times the smallest reading: the wheels' yaw rate, with any tread, if no dead band reads zero


def without_lost_gyro(recording: Recording) -> Recording:
    """Leave out a gyro's rows that repeat one reading, if there are wheels, and impossible ones, and note it. (68)

    A reader that has lost the gyro repeats its last reading, or zeros. Neither is a dead band, which hides slow turns
    only, nor clipping, at the largest rate.
    """
    fog = recording.fog
    if fog is None:
        return recording
    is_leap = isolated(fog.rate_rad_s)
    frozen = _frozen(recording, fog) if recording.wheels is not None else []
    is_lost = is_leap.copy()
    for first, last in frozen:
        is_lost[first + 1 : last + 1] = True
    if not is_lost.any() or is_lost.mean() > MOST_LOST:
        return recording
    spans_s = [(float(fog.time_s[first]), float(fog.time_s[last])) for first, last in frozen]
    told = notes("fog.csv", spans_s, fog.time_s[is_leap])
    return replace(recording, fog=replace(fog, **at_rows(fog, ~is_lost)), notes=(*recording.notes, *told))


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
