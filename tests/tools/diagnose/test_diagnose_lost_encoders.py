"""Encoders that were not read repeat a row, or zeros: that is no rest of the wheels while the body moves."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from diagnosis_drives import SLALOM, recorded, selected, simulated
from diagnosis_runs import SPEEDS

from drd.arrays import Array
from drd_tools.calibrate.wheels.drive import Drive, make_drive
from drd_tools.calibrate.wheels.fit import fit_wheels
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.observe.lost_encoders import without_lost_encoders
from drd_tools.recordings.folder import Recording

LOST_S = (60.0, 65.0)
Change = Callable[[Array, npt.NDArray[np.intp]], Array]


def held(values: Array, rows: npt.NDArray[np.intp]) -> Array:
    """The last reading is repeated, and the next is true again."""
    changed = values.copy()
    changed[rows] = values[rows[0] - 1]
    return changed


def zeros(values: Array, rows: npt.NDArray[np.intp]) -> Array:
    changed = values.copy()
    changed[rows] = 0.0
    return changed


def stopped(values: Array, rows: npt.NDArray[np.intp]) -> Array:
    """The counter does not count, and goes on from there."""
    changed = held(values, rows)
    changed[rows[-1] + 1 :] -= values[rows[-1]] - values[rows[0] - 1]
    return changed


def rows_of(recording: Recording) -> npt.NDArray[np.intp]:
    time_s = recording.encoders.time_s
    return np.flatnonzero((time_s > LOST_S[0]) & (time_s < LOST_S[1]))


def changed(recording: Recording, change: Change, sides: str = "both") -> Recording:
    """With a change of the counts, or speeds, of one side or both, within LOST_S."""
    log, rows = recording.encoders, rows_of(recording)
    names = ("left_counts", "right_counts") if log.left_counts is not None else ("left_rad_s", "right_rad_s")
    columns: dict[str, Any] = {name: change(getattr(log, name), rows) for name in names[: 1 if sides == "left" else 2]}
    return replace(recording, wheels=replace(log, **columns))


def left_out(recording: Recording) -> Array:
    """Times of the rows that are left out."""
    made = without_lost_encoders(recording)
    return np.setdiff1d(recording.encoders.time_s, made.encoders.time_s)


COUNTS = recorded(SLALOM, 3)
RATES = simulated(SLALOM, 3, nominal=SPEEDS).recording


@pytest.mark.parametrize(
    ("recording", "change", "sides"),
    [
        (COUNTS, held, "both"),
        (COUNTS, held, "left"),
        (COUNTS, zeros, "both"),
        (COUNTS, zeros, "left"),
        (COUNTS, stopped, "both"),
        (RATES, held, "both"),
        (RATES, held, "left"),
        (RATES, zeros, "both"),
    ],
)
def test_rows_of_lost_encoders_are_left_out_and_noted(recording: Recording, change: Change, sides: str) -> None:
    lost = changed(recording, change, sides)
    times_s = left_out(lost)
    inside = recording.encoders.time_s[rows_of(recording)]
    assert set(times_s) <= set(inside)
    assert len(times_s) >= len(inside) - 2
    (note,) = without_lost_encoders(lost).notes
    assert "encoders.csv repeats one reading from 60." in note


def test_a_counter_that_stops_and_wheels_at_rest_are_no_lost_encoders() -> None:
    one = changed(COUNTS, stopped, "left")
    assert without_lost_encoders(one) is one
    for recording in (COUNTS, RATES, recorded(("stand", 60.0), 3), recorded(("spins", 120.0), 3)):
        assert without_lost_encoders(recording) is recording


def at_rest(jump_m: float) -> Recording:
    """A robot that stands for the last minute, in which its reference jumps."""
    log, r = COUNTS.encoders, COUNTS.reference
    assert r is not None
    assert log.left_counts is not None
    assert log.right_counts is not None
    rest = int(np.searchsorted(log.time_s, 60.0))
    left, right = (np.minimum(np.arange(len(c)), rest) for c in (log.left_counts, log.right_counts))
    wheels = replace(log, left_counts=log.left_counts[left], right_counts=log.right_counts[right])
    still = np.minimum(np.arange(len(r.time_s)), int(np.searchsorted(r.time_s, 60.0)))
    noise_m = np.random.default_rng(1).normal(0.0, 0.01, len(r.time_s))
    x_m = r.x_m[still] + noise_m + np.where(r.time_s > 90.0, jump_m, 0.0)
    reference = replace(r, x_m=x_m, y_m=r.y_m[still], heading_rad=r.heading_rad[still])
    return replace(COUNTS, wheels=wheels, reference=reference, fog=None)


def test_a_reference_that_jumps_while_the_robot_stands_is_no_motion() -> None:
    standing = at_rest(3.0)
    assert without_lost_encoders(standing) is standing


def test_a_robot_that_hardly_ever_moves_has_no_lost_encoders() -> None:
    log = COUNTS.encoders
    steps = np.zeros(len(log.time_s))
    steps[200:230] = steps[900:930] = 50.0
    resting = replace(COUNTS, wheels=replace(log, left_counts=np.cumsum(steps), right_counts=np.cumsum(steps)))
    assert without_lost_encoders(replace(resting, reference=None, fog=None)).wheels is resting.wheels


def test_counts_of_a_coarse_encoder_repeat_while_it_creeps() -> None:
    """A count of 0.23 m: at 0.1 m/s it repeats for two seconds."""
    per_revolution = 3
    coarse = replace(COUNTS.nominal, counts_per_revolution=per_revolution)
    time_s = COUNTS.encoders.time_s
    counts = np.floor(0.1 * time_s / (2.0 * np.pi * coarse.wheel_radius_m) * per_revolution)
    r = COUNTS.reference
    assert r is not None
    still = np.zeros(len(r.time_s))
    along = replace(r, x_m=0.1 * r.time_s, y_m=still, heading_rad=still)
    wheels = replace(COUNTS.encoders, left_counts=counts, right_counts=counts)
    creeping = replace(COUNTS, nominal=coarse, wheels=wheels, reference=along, fog=None)
    assert without_lost_encoders(creeping) is creeping


def test_the_gyro_shows_that_wheels_without_a_reference_are_lost() -> None:
    lost = changed(replace(COUNTS, reference=None), stopped)
    assert len(left_out(lost)) > 40
    blind = replace(lost, fog=None)
    assert without_lost_encoders(blind) is blind


@pytest.mark.parametrize("has_gyro", [True, False])
@pytest.mark.parametrize(
    ("recording", "change"),
    [(COUNTS, held), (COUNTS, zeros), (COUNTS, stopped), (RATES, held), (RATES, zeros)],
)
def test_lost_encoders_name_nothing(recording: Recording, change: Change, has_gyro: bool) -> None:
    lost = changed(recording, change)
    analysis = analyse(lost if has_gyro else replace(lost, fog=None))
    assert analysis.conclusion.causes == []
    # The daemon has the rows as they are, and so have the figures before and after.
    assert analysis.recording.wheels is lost.wheels


def beside_a_gap(recording: Recording, begin_s: float, end_s: float) -> Drive:
    """The calibrator's drive, without the wheels' rows between these times."""
    log = recording.encoders
    known = (log.time_s <= begin_s) | (log.time_s >= end_s)
    assert log.left_rad_s is not None
    assert log.right_rad_s is not None
    gap = replace(log, time_s=log.time_s[known], left_rad_s=log.left_rad_s[known], right_rad_s=log.right_rad_s[known])
    return make_drive(replace(recording, wheels=gap))


def windows_s(drive: Drive) -> list[tuple[float, float]]:
    """First and last time of each window, by the reference."""
    rows, starts = drive.windows
    return [(drive.reference_s[own[0]], drive.reference_s[own[-1]]) for own in np.split(rows, starts[1:])]


def test_wheels_are_calibrated_beside_a_gap_of_their_speeds() -> None:
    recording = simulated(("field", 120.0), 3, selected("tread_error", k=0.3), nominal=SPEEDS).recording
    drive = beside_a_gap(recording, *LOST_S)
    for begins_s, ends_s in windows_s(drive):
        assert ends_s <= LOST_S[0] + 0.1 or begins_s >= LOST_S[1]
    fit = fit_wheels([drive])
    assert fit.wheels.tread_m / drive.nominal.tread_m == pytest.approx(1.3, abs=0.01)


@pytest.mark.parametrize("late_s", [0.0, 0.9])
def test_no_window_shows_a_gap_however_late_the_reference_is(late_s: float) -> None:
    assert RATES.reference is not None
    late = replace(RATES, reference=replace(RATES.reference, time_s=RATES.reference.time_s + late_s))
    for end_s in np.arange(62.0, 68.0, 0.2):
        for begins_s, ends_s in windows_s(beside_a_gap(late, end_s - 5.0, end_s)):
            assert ends_s <= end_s - 4.9 or begins_s >= end_s + late_s


def test_a_single_impossible_speed_is_left_out() -> None:
    log = RATES.encoders
    assert log.left_rad_s is not None
    spiked = log.left_rad_s.copy()
    spiked[1200] = 300.0
    lost = replace(RATES, wheels=replace(log, left_rad_s=spiked))
    assert left_out(lost).tolist() == [log.time_s[1200]]
    assert analyse(lost).conclusion.causes == []
