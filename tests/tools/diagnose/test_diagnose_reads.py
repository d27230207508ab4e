"""Logs that repeat what was read of a counter: its reads are taken for what they are."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_drives import SLALOM, recorded, selected

from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.observe.constants import observe
from drd_tools.diagnose.observe.reads import as_read
from drd_tools.diagnose.validate.held_out import prepared
from drd_tools.recordings.folder import Recording


def repeated(recording: Recording, every_s: float) -> Recording:
    """The recording as a log has it that reads its counters every so often, and repeats what it has read."""
    log = recording.encoders
    assert log.left_counts is not None
    assert log.right_counts is not None
    rows = np.searchsorted(log.time_s, np.floor(log.time_s / every_s + 1e-6) * every_s - 1e-6)
    left, right = log.left_counts[rows], log.right_counts[rows]
    return replace(recording, wheels=replace(log, left_counts=left, right_counts=right))


@pytest.mark.parametrize("has_gyro", [True, False])
def test_counters_that_are_read_five_times_a_second_name_nothing(has_gyro: bool) -> None:
    recording = repeated(recorded(SLALOM, 3), 0.2)
    assert analyse(recording if has_gyro else replace(recording, fog=None)).conclusion.causes == []


def test_counts_between_reads_are_those_that_a_faster_counter_has() -> None:
    recording = recorded(SLALOM, 3)
    made, log = as_read(repeated(recording, 0.2)).encoders, recording.encoders
    for between, true in ((made.left_counts, log.left_counts), (made.right_counts, log.right_counts)):
        assert between is not None
        assert true is not None
        assert np.abs(between - true)[:-4].max() < 0.05 * np.diff(true[::4]).max()


def test_a_counter_that_is_read_at_each_row_stays_as_it_is() -> None:
    recording = recorded(SLALOM, 3)
    assert as_read(recording) is recording


def test_a_counter_that_stops_between_its_reads_is_found() -> None:
    dropout = selected("encoder_dropout", side="right", t0=60.0, t1=62.0)
    (event,) = observe(repeated(recorded(SLALOM, 3, dropout), 0.2))[1].events
    assert event.windows[0] == pytest.approx((60.0, 62.0), abs=0.3)


def test_a_held_out_recording_is_read_alike() -> None:
    recording = repeated(recorded(SLALOM, 3), 0.2)
    held_out, (measured, audited) = prepared(recording), observe(recording)
    assert np.array_equal(held_out.audited.evidence.left_m, audited.evidence.left_m)
    # The daemon has the rows as they are, and so have the figures before and after.
    assert held_out.measured.recording.wheels is recording.wheels is measured.recording.wheels
