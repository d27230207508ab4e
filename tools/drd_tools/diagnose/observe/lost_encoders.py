"""Rows of lost encoders, which repeat the last reading, or zeros, while the robot moves, and impossible speeds."""

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d

from drd.arrays import Array, cumulative
from drd.batch.logs import EncoderLog
from drd.units import RAD_PER_DEG
from drd_tools.calibrate.wheels.drive import MOST_LAG_S
from drd_tools.diagnose.observe.events import runs
from drd_tools.diagnose.observe.evidence import datasheet_noise
from drd_tools.diagnose.observe.lost_reference import LAGS_S, LEAST_M
from drd_tools.diagnose.observe.lost_rows import FEWEST_ALIKE, LEAP, MOST_LOST, is_rare, isolated, notes
from drd_tools.recordings.folder import Recording, at_rows

Span = tuple[float, float]

LEAST_S: Final = 0.5  # of repeats: drives hold what they report for as long
SIGMAS: Final = 10.0  # of the reference's noise: seven of a difference
WITHIN_S: Final = 2.0  # a slower motion may be the drift of a reference at rest
LEAST_RAD: Final = 10.0 * RAD_PER_DEG  # of a turn: more than a gyro's bias adds, with wheels at rest
FEWEST_STEPS: Final = 20  # of a counter: fewer do not show its usual step
# Times nearly the largest step of a counter: a wheel does not do that in a row, unless it missed half a second.
CATCH_UP: Final = 4.0


def without_lost_encoders(recording: Recording) -> Recording:
    """Leave out the rows of lost encoders, and note it. (68)

    A reader that has lost them repeats what it read last, or zeros. One counter that stands still and goes on from
    there is a stopped counter, an effect; one that has counted meanwhile was not read.
    """
    log = recording.wheels
    if log is None:
        return recording
    is_lost = np.zeros(len(log.time_s), np.bool_)
    for first, last in _counters(recording, log) if log.left_counts is not None else _speeds(recording, log):
        is_lost[first : last + 1] = True
    is_leap = np.zeros(len(log.time_s), np.bool_)
    for speed in (log.left_rad_s, log.right_rad_s):
        if speed is not None:
            is_leap |= isolated(speed)
    if not (is_lost | is_leap).any() or is_lost.mean() > MOST_LOST:
        return recording
    spans_s = [(float(log.time_s[first]), float(log.time_s[end - 1])) for first, end in runs(is_lost)]
    told = notes("encoders.csv", spans_s, log.time_s[is_leap])
    kept = replace(log, **at_rows(log, ~(is_lost | is_leap)))
    return replace(recording, wheels=kept, notes=(*recording.notes, *told))


def _counters(recording: Recording, log: EncoderLog) -> list[tuple[int, int]]:
    """First and last lost row of each run of repeated counts."""
    found = []
    both = np.ones(len(log.time_s) - 1, np.bool_)
    for counts in (log.left_counts, log.right_counts):
        assert counts is not None
        steps = np.abs(np.diff(counts))
        both &= steps == 0.0
        if np.count_nonzero(steps) < FEWEST_STEPS:
            continue
        usual = float(np.percentile(steps[steps > 0.0], 95.0))
        for first, last in runs(steps == 0.0):
            before, after = (float(steps[i]) if 0 <= i < len(steps) else 0.0 for i in (first - 1, last))
            begin_s, end_s = float(log.time_s[first]), float(log.time_s[last])
            if min(before, after) > LEAP * usual:
                found.append((first, last))
            elif after > CATCH_UP * usual and end_s - begin_s > LEAST_S and _moving_s(recording, begin_s, end_s):
                found.append((first + 1, last))
    return found + _at_rest(recording, log.time_s, both)


def _speeds(recording: Recording, log: EncoderLog) -> list[tuple[int, int]]:
    """First and last lost row of each run of repeated speeds."""
    found = []
    both = np.ones(len(log.time_s) - 1, np.bool_)
    for speed in (log.left_rad_s, log.right_rad_s):
        assert speed is not None
        both &= (speed[1:] == 0.0) & (speed[:-1] == 0.0)
        repeats = (np.diff(speed) == 0.0) & (speed[1:] != 0.0)
        long = [(first, last) for first, last in runs(repeats) if last - first + 1 >= FEWEST_ALIKE]
        found += [(first + 1, last) for first, last in long] if is_rare(repeats, long) else []
    return found + _at_rest(recording, log.time_s, both)


def _at_rest(recording: Recording, time_s: Array, steps: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last row of the wheels at rest, in these `steps` (n - 1,) without travel, while the body moves."""
    found = []
    for first, last in runs(steps):
        begin_s, end_s = float(time_s[first]), float(time_s[last])
        if end_s - begin_s > LEAST_S and (span_s := _moving_s(recording, begin_s, end_s)) is not None:
            inside = (time_s > max(span_s[0], begin_s)) & (time_s <= min(span_s[1], end_s))
            found += [(int(rows[0]), int(rows[-1])) for rows in [np.flatnonzero(inside)] if len(rows)]
    return found


def _moving_s(recording: Recording, begin_s: float, end_s: float) -> Span | None:
    """The part of a span of time in which the reference, whatever its lag, or without one the gyro moves; else None."""
    reference, fog, sheet = recording.reference, recording.fog, datasheet_noise(recording.nominal)
    if reference is not None and _rows(reference.time_s, begin_s, end_s).sum() >= FEWEST_ALIKE:
        unseen_m = 2.0 * sheet.count_m  # by wheels whose counts do not change
        limit_m = max(LEAST_M, SIGMAS * sheet.position_m) + unseen_m
        limit_rad = max(LEAST_RAD, SIGMAS * sheet.heading_rad) + unseen_m / recording.nominal.tread_m
        pose = np.column_stack([reference.x_m / limit_m, reference.y_m / limit_m, reference.heading_rad / limit_rad])
        found = [_beyond(reference.time_s, pose, begin_s + lag_s, end_s + lag_s) for lag_s in LAGS_S]
        moving = [span_s for span_s in found if span_s is not None]
        return (moving[0][0] - MOST_LAG_S, moving[-1][1]) if len(moving) == len(found) else None
    if fog is None:
        return None
    turned = cumulative(fog.rate_rad_s * np.diff(fog.time_s, prepend=fog.time_s[0]))[1:]
    return _beyond(fog.time_s, turned[:, None] / LEAST_RAD, begin_s, end_s)


def _beyond(time_s: Array, pose: Array, begin_s: float, end_s: float) -> Span | None:
    """When a pose (n, k), in units of its limits, moves by more than these within WITHIN_S, not counting one jump; None
    if it does not.
    """
    inside = _rows(time_s, begin_s, end_s)
    times_s, at = time_s[inside], pose[inside]
    if len(at) < 2:
        return None
    before = np.searchsorted(times_s, times_s - WITHIN_S)
    steps, together = np.abs(np.diff(at, axis=0, prepend=at[:1])), int((np.arange(len(at)) - before).max()) + 1
    largest = maximum_filter1d(steps, 2 * together + 1, axis=0)
    moving = np.flatnonzero((np.abs(at - at[before]) - largest > 1.0).any(axis=1))
    return (float(times_s[before[moving[0]]]), float(times_s[moving[-1]])) if len(moving) else None


def _rows(time_s: Array, begin_s: float, end_s: float) -> npt.NDArray[np.bool_]:
    inside: npt.NDArray[np.bool_] = (time_s >= begin_s) & (time_s <= end_s)
    return inside
