"""Preparation of a recording: times counted from its start, and long ones split into parts of up to 20 minutes."""

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np

from drd.batch.run import zero_for_terms
from drd_tools.diagnose.observe.evidence import Evidence
from drd_tools.diagnose.observe.grids import MOST_STEPS, STEP_S
from drd_tools.recordings.folder import Recording, at_rows

PART: Final = "-part-"
LOGS: Final = ("fog", "wheels", "reference")
FULL: Final = 0.99  # of MOST_STEPS: rows are not perfectly even
FEWEST_ROWS: Final = 20  # of each sensor: parts with fewer are left out
CUT_S: Final = 60.0  # a shorter end that is left out is not reported


def from_its_start(recording: Recording) -> Recording:
    """The recording with times as a model counts them: from the first row, if that is far from 0 (`batch.run`)."""
    begin_s = zero_for_terms(first_s(recording))
    if not begin_s:
        return recording
    logs = {name: getattr(recording, name) for name in LOGS}
    shifted: Any = {n: log and replace(log, time_s=log.time_s - begin_s) for n, log in logs.items()}
    note = f"times count from its first row, at {begin_s:.12g} s"
    return replace(recording, notes=(*recording.notes, note), **shifted)


def parts(recording: Recording) -> list[Recording]:
    """The recording itself, or its parts of equal length, in order, without those of hardly any rows.

    Parts keep the times of the whole. Only the first has the standstill at the start.
    """
    logs = [log for log in (recording.fog, recording.wheels) if log is not None and len(log.time_s)]
    if not logs:
        return [recording]
    begin_s, end_s = max(float(log.time_s[0]) for log in logs), min(float(log.time_s[-1]) for log in logs)
    count = math.ceil((end_s - begin_s) / _longest_s(recording))
    if count < 2:
        return [recording]
    edges = np.linspace(begin_s, end_s, count + 1)
    edges[0], edges[-1] = -np.inf, np.inf
    digits, zero_s = len(str(count)), zero_for_terms(first_s(recording))
    made = []
    for k in range(count):
        nominal = recording.nominal if k == 0 else replace(recording.nominal, standstill_at_start_s=0.0)
        logs_of_part = {name: between(getattr(recording, name), edges[k], edges[k + 1]) for name in LOGS}
        folder = recording.folder / f"{recording.name}{PART}{k + 1:0{digits}}-of-{count}"
        part = replace(recording, folder=folder, nominal=nominal, zero_s=zero_s, **logs_of_part)
        sensors = [(recording.fog, part.fog), (recording.wheels, part.wheels)]
        if all(log is not None and len(log.time_s) >= FEWEST_ROWS for whole, log in sensors if whole is not None):
            made.append(part)
    return made


def between(log: Any, begin_s: float, end_s: float) -> Any:
    """The rows of a log within a time interval; None if there are none."""
    if log is None:
        return None
    inside = (log.time_s >= begin_s) & (log.time_s < end_s)
    if not inside.any():
        return None
    return replace(log, **at_rows(log, inside))


def first_s(recording: Recording) -> float:
    """Time of the first row of gyro and wheels; 0 if there is none."""
    logs = [log.time_s for log in (recording.fog, recording.wheels) if log is not None and len(log.time_s)]
    return min((float(time_s[0]) for time_s in logs), default=0.0)


def with_whole(name: str) -> str:
    """Name of a recording; for a part, the names of the whole and of the part, separated by a comma."""
    whole, _, is_part = name.rpartition(PART)
    return f"{whole}, {name}" if is_part and whole else name


def cut_off(recording: Recording, e: Evidence) -> str | None:
    """Sentence on a recording too long to be analysed completely; else None."""
    ends_s = [float(log.time_s[-1]) for log in (recording.fog, recording.wheels) if log is not None]
    end_s, begin_s = min(ends_s), float(e.edges_s[0])
    if end_s - e.time_s[-1] < CUT_S:
        return None
    seen_min, whole_min = (e.time_s[-1] - begin_s) / 60.0, (end_s - begin_s) / 60.0
    return f"only the first {seen_min:.0f} of {whole_min:.0f} minutes were analysed"


def _longest_s(recording: Recording) -> float:
    """Duration of MOST_STEPS steps of `grids`."""
    if recording.fog is None or len(recording.fog.time_s) < 2:
        return FULL * MOST_STEPS * STEP_S
    typical_s = float(np.median(np.diff(recording.fog.time_s)))
    return FULL * MOST_STEPS * typical_s * max(1, math.floor(STEP_S / typical_s + 1e-9))
