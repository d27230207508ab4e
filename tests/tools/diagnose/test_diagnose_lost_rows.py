"""Lost sensors that repeat a row, or write zeros: those rows are no robot at rest, no slip, and no dead band."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_drives import SLALOM, recorded

from drd.arrays import Array
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.observe.events import runs
from drd_tools.diagnose.observe.lost_gyro import without_lost_gyro
from drd_tools.diagnose.observe.lost_reference import without_lost_reference
from drd_tools.diagnose.observe.lost_rows import FEWEST_ALIKE
from drd_tools.recordings.folder import Recording, ReferenceLog

LOST_S = (60.0, 65.0)


def reference_of(recording: Recording) -> ReferenceLog:
    assert recording.reference is not None
    return recording.reference


def repeating(recording: Recording, values: tuple[float, float, float] | None = None) -> Recording:
    """With the pose of its first row, or other `values`, in all rows within LOST_S."""
    r = reference_of(recording)
    rows = np.flatnonzero((r.time_s > LOST_S[0]) & (r.time_s < LOST_S[1]))
    pose = np.column_stack([r.x_m, r.y_m, r.heading_rad])
    pose[rows] = pose[rows[0]] if values is None else values
    return replace(recording, reference=ReferenceLog(r.time_s, *pose.T))


def at_rest_from_60_s() -> Recording:
    """A robot that stands from 60 s on, with a reference that says so to the last digit."""
    recording = recorded(SLALOM, 3)
    log, r = recording.encoders, reference_of(recording)
    assert log.left_counts is not None
    assert log.right_counts is not None
    until = np.searchsorted(log.time_s, LOST_S[0])

    def halted(time_s: Array, values: Array, last: int) -> Array:
        return np.where(time_s > time_s[last], values[last], values)

    left, right = (halted(log.time_s, counts, int(until)) for counts in (log.left_counts, log.right_counts))
    row = int(np.searchsorted(r.time_s, LOST_S[0]))
    still = ReferenceLog(r.time_s, *(halted(r.time_s, values, row) for values in (r.x_m, r.y_m, r.heading_rad)))
    return replace(recording, wheels=replace(log, left_counts=left, right_counts=right), reference=still)


@pytest.mark.parametrize(("values", "is_first_true"), [(None, True), ((0.0, 0.0, 0.0), False), ((0, 0, 9), False)])
def test_rows_of_a_lost_reference_are_left_out(values: tuple[float, float, float] | None, is_first_true: bool) -> None:
    recording = recorded(SLALOM, 3)
    before = reference_of(recording)
    made, held_s = without_lost_reference(repeating(recording, values))
    is_inside = (before.time_s > LOST_S[0]) & (before.time_s < LOST_S[1])
    is_inside[np.flatnonzero(is_inside)[0]] ^= is_first_true
    assert np.array_equal(reference_of(made).time_s, before.time_s[~is_inside])
    assert np.allclose(reference_of(made).heading_rad, before.heading_rad[~is_inside])
    assert held_s == pytest.approx(LOST_S[1] - LOST_S[0], abs=0.25)


def test_a_reference_that_is_lost_to_the_end_or_from_the_start_is_cut() -> None:
    r = reference_of(recording := recorded(SLALOM, 3))
    late = replace(recording, reference=ReferenceLog(*(a[r.time_s > 3.0] for a in (r.time_s, r.x_m, r.y_m, r.heading_rad))))  # fmt: skip  # noqa: E501
    for which, begins in ((slice(700, None), False), (slice(0, 80), True)):
        lost = reference_of(late)
        pose = np.column_stack([lost.x_m, lost.y_m, lost.heading_rad])
        pose[which] = (50.0, 50.0, 0.0) if begins else pose[700]
        made, _ = without_lost_reference(replace(late, reference=ReferenceLog(lost.time_s, *pose.T)))
        kept = slice(80, None) if begins else slice(None, 701)
        assert np.array_equal(reference_of(made).time_s, lost.time_s[kept])


def test_a_pose_that_repeats_at_rest_is_true_also_if_it_is_late() -> None:
    standing = at_rest_from_60_s()
    r = reference_of(standing)
    for lag_s in (0.0, 0.4):
        late = replace(standing, reference=replace(r, time_s=r.time_s + lag_s))
        assert without_lost_reference(late)[0] is late
    # Zeros in between are not.
    made, held_s = without_lost_reference(repeating(replace(standing, reference=r), (0.0, 0.0, 0.0)))
    assert held_s > 4.0
    assert np.hypot(reference_of(made).x_m, reference_of(made).y_m)[-50:].min() > 1.0


def test_a_recording_without_repeats_stays_as_it_is() -> None:
    recording = recorded(SLALOM, 3)
    assert without_lost_reference(recording)[0] is recording


@pytest.mark.parametrize("has_gyro", [True, False])
@pytest.mark.parametrize("values", [None, (0.0, 0.0, 0.0)])
def test_a_lost_reference_names_nothing_and_is_told(has_gyro: bool, values: tuple[float, float, float] | None) -> None:
    recording = repeating(recorded(SLALOM, 3), values)
    analysis = analyse(recording if has_gyro else replace(recording, fog=None))
    assert analysis.conclusion.causes == []
    assert analysis.reference["held"].value == pytest.approx(5.0, abs=0.25)


def frozen(recording: Recording, reading_rad_s: float | None) -> Recording:
    """With the gyro's first reading within LOST_S, or another, in all of its rows there."""
    assert recording.fog is not None
    fog, rate = recording.fog, recording.fog.rate_rad_s.copy()
    rows = np.flatnonzero((fog.time_s > LOST_S[0]) & (fog.time_s < LOST_S[1]))
    rate[rows] = rate[rows[0]] if reading_rad_s is None else reading_rad_s
    return replace(recording, fog=replace(fog, rate_rad_s=rate))


@pytest.mark.parametrize("reading_rad_s", [None, 0.0])
def test_a_gyro_that_repeats_a_reading_is_left_out_and_names_nothing(reading_rad_s: float | None) -> None:
    recording = recorded(SLALOM, 3)
    analysis = analyse(frozen(recording, reading_rad_s))
    assert analysis.conclusion.causes == []
    assert "fog.csv repeats one reading from 60.1 to 64.9 s: left out" in analysis.recording.notes
    # The daemon has the rows as they are, and so have the figures before and after.
    assert analysis.recording.fog is not None
    assert recording.fog is not None
    assert len(analysis.recording.fog.time_s) == len(recording.fog.time_s)


@pytest.mark.parametrize(
    "reading",
    [lambda rate: np.where(np.abs(rate) < 0.05, 0.0, rate), lambda rate: np.clip(rate, -0.3, 0.3)],
    ids=["a dead band", "clipping"],
)
def test_equal_readings_of_a_dead_band_or_at_the_limit_are_no_lost_gyro(reading: Callable[[Array], Array]) -> None:
    recording = recorded(("eights", 120.0), 3)
    assert recording.fog is not None
    rate = reading(recording.fog.rate_rad_s)
    assert max(last - first for first, last in runs(np.diff(rate) == 0.0)) >= FEWEST_ALIKE
    recording = replace(recording, fog=replace(recording.fog, rate_rad_s=rate))
    assert without_lost_gyro(recording) is recording


def test_equal_readings_of_a_coarse_gyro_are_no_lost_one() -> None:
    recording = frozen(recorded(SLALOM, 3), None)
    assert recording.fog is not None
    step = 0.05
    coarse = replace(recording.fog, rate_rad_s=np.round(recording.fog.rate_rad_s / step) * step)
    rounded = replace(recording, fog=coarse)
    assert without_lost_gyro(recording) is not recording
    assert without_lost_gyro(rounded) is rounded


def elsewhere(recording: Recording, *at_s: float) -> Recording:
    """With a pose 30 m off at each of these times."""
    r = reference_of(recording)
    x_m = r.x_m.copy()
    x_m[np.searchsorted(r.time_s, at_s)] += 30.0
    return replace(recording, reference=replace(r, x_m=x_m))


def test_single_poses_out_of_reach_are_left_out_and_jumps_and_noise_are_not() -> None:
    recording = recorded(SLALOM, 3)
    r = reference_of(recording)
    made, held_s = without_lost_reference(elsewhere(recording, 50.0, 70.0))
    assert np.setdiff1d(r.time_s, reference_of(made).time_s) == pytest.approx([50.0, 70.0], abs=0.1)
    assert held_s == pytest.approx(0.2)
    jumping = replace(recording, reference=replace(r, x_m=np.where(r.time_s > 50.0, r.x_m + 30.0, r.x_m)))
    assert without_lost_reference(jumping)[0] is jumping
    # Thirty times the stated noise: far from each other, but no further than usual.
    noise_m = np.random.default_rng(1).normal(0.0, 0.3, len(r.time_s))
    noisy = replace(recording, reference=replace(r, x_m=r.x_m + noise_m))
    assert len(reference_of(without_lost_reference(noisy)[0]).time_s) > 0.99 * len(r.time_s)


def test_poses_in_a_gap_of_the_wheels_are_in_reach() -> None:
    """They are a metre apart, where the wheels tell nothing."""
    recording = recorded(("field", 120.0), 3)
    log, r = recording.encoders, reference_of(recording)
    known = (log.time_s < LOST_S[0]) | (log.time_s > LOST_S[1])
    assert log.left_counts is not None
    assert log.right_counts is not None
    still = np.where(log.time_s > LOST_S[0], log.left_counts[np.searchsorted(log.time_s, LOST_S[0])], log.left_counts)
    gap = replace(log, time_s=log.time_s[known], left_counts=still[known], right_counts=log.right_counts[known])
    sparse = ReferenceLog(*(a[::10] for a in (r.time_s, r.x_m, r.y_m, r.heading_rad)))
    reset = replace(recording, wheels=gap, reference=sparse)
    assert without_lost_reference(reset)[0] is reset


def test_a_single_impossible_reading_is_left_out_and_noted() -> None:
    recording = recorded(SLALOM, 3)
    assert recording.fog is not None
    rate = recording.fog.rate_rad_s.copy()
    rate[600] = 20.0
    spiked = replace(recording, fog=replace(recording.fog, rate_rad_s=rate))
    made = without_lost_gyro(spiked)
    assert made.fog is not None
    assert np.setdiff1d(recording.fog.time_s, made.fog.time_s).tolist() == [recording.fog.time_s[600]]
    (note,) = made.notes
    assert "fog.csv has a row 20 times as large as any neighbour" in note
    assert analyse(spiked).conclusion.causes == []
    assert without_lost_gyro(recorded(("spins", 120.0), 3)).notes == ()
