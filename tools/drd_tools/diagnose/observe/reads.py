"""Counts of a log that repeats them: counts apply at the times at which they were read, with interpolation between."""

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.interpolate import PchipInterpolator

from drd.arrays import Array
from drd_tools.calibrate.wheels.lag import held_s
from drd_tools.recordings.folder import Recording

SAME_S: Final = 1e-3  # of a time: the digits of a log


def as_read(recording: Recording) -> Recording:
    """The recording with interpolated counts where they only repeat the last one, in a log faster than its source:
    unchanged, the wheels would seem to halt several times a second.
    """
    log = recording.wheels
    if log is None or log.left_counts is None or log.right_counts is None or not (hold_s := held_s(recording)):
        return recording
    time_s, counts = log.time_s, (log.left_counts, log.right_counts)
    is_read = np.append(True, np.any(np.diff(counts) != 0.0, axis=0))
    reads = np.flatnonzero(is_read)
    next_s = np.append(time_s[reads], np.inf)[np.searchsorted(reads, np.arange(len(time_s)))]
    # Repeats of a wheel at rest are true, up to the last read before it moves.
    is_known = is_read | (next_s - time_s > hold_s - SAME_S)

    def smooth(counted: Array) -> Array:
        # Monotone between knots: no overshoot where a wheel halts.
        return np.asarray(PchipInterpolator(time_s[is_known], counted[is_known])(time_s), float)

    left, right = map(smooth, counts)
    return replace(recording, wheels=replace(log, left_counts=left, right_counts=right))
