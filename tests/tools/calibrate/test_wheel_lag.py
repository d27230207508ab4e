"""The lag of the wheels: a known one is found, and what cannot tell it says so."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from replay_folders import write_perfect
from wheel_recordings import STRAIGHT, TOUR, Leg

from drd.batch.logs import EncoderLog
from drd_tools.calibrate.wheels.lag import Lag, find_lag, held_s
from drd_tools.calibrate.wheels.turns import EARLIEST_S, LATEST_S
from drd_tools.recordings.folder import Recording, read_recording

SHARED = Path(__file__).resolve().parents[3].parent / "shared/recordings"


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return read_recording(write_perfect(tmp_path_factory.mktemp("tour") / "drive", gyro=True, legs=TOUR))


def late(recording: Recording, lag_s: float, noise_rad_s: float = 0.0, seed: int = 0) -> Recording:
    """The wheels' rows come later by `lag_s`, and the gyro has a bias and noise."""
    assert recording.fog is not None
    noise = np.random.default_rng(seed).normal(0.01, max(noise_rad_s, 1e-9), len(recording.fog.time_s))
    wheels = replace(recording.encoders, time_s=recording.encoders.time_s + lag_s)
    return replace(recording, wheels=wheels, fog=replace(recording.fog, rate_rad_s=recording.fog.rate_rad_s + noise))


def found(*recordings: Recording) -> Lag:
    lag = find_lag(recordings)
    assert lag is not None
    return lag


@settings(deadline=None, max_examples=15)
@given(lag_s=st.floats(-0.4, 0.9), against=st.sampled_from(["gyro", "reference"]))
def test_a_known_lag_is_found(tour: Recording, lag_s: float, against: str) -> None:
    recording = late(tour, lag_s)
    lag = found(recording if against == "gyro" else replace(recording, fog=None))
    assert lag.against == against
    assert lag.determined
    assert lag.lag_s == pytest.approx(lag_s, abs=0.003)
    assert math.isnan(lag.spread_s)


def test_sigma_covers_the_error_over_many_drives(tour: Recording) -> None:
    z = []
    for seed in range(30):
        lag = found(late(tour, 0.2, 0.05, seed))
        z.append((lag.lag_s - 0.2) / lag.sigma_s)
    # 30 drives: the rms of a true z lies in 0.67 to 1.35 with 99 %; few blocks make it a little worse.
    assert 0.5 < float(np.sqrt(np.mean(np.square(z)))) < 1.6


def test_drives_that_differ_have_a_spread(tour: Recording) -> None:
    lags_s = (0.1, 0.14, 0.18, 0.22, 0.26)
    alike = found(*(late(tour, 0.18, 0.02, k) for k in range(5)))
    apart = found(*(late(tour, lag_s, 0.02, k) for k, lag_s in enumerate(lags_s)))
    assert alike.spread_s < 0.01
    assert apart.spread_s == pytest.approx(np.std(lags_s, ddof=1), rel=0.3)
    assert apart.sigma_s > 2.0 * alike.sigma_s
    assert apart.next_s > apart.spread_s


def test_a_reference_that_is_differently_late_does_not_move_the_wheels(tour: Recording) -> None:
    drives = [late(tour, lag_s, 0.02, k) for k, lag_s in enumerate((0.0, 0.1, 0.2))]
    by_gyro, by_reference = found(*drives), found(*(replace(drive, fog=None) for drive in drives))
    assert by_gyro.applies
    assert by_reference.determined
    assert not by_reference.applies
    assert found(*(replace(late(tour, 0.1, 0.0, k), fog=None) for k in range(3))).applies


def test_jumps_of_the_reference_do_little_harm(tour: Recording) -> None:
    assert tour.reference is not None
    heading = tour.reference.heading_rad.copy()
    heading[np.random.default_rng(3).integers(0, len(heading), 20)] += 0.3
    jumping = replace(late(tour, 0.15), fog=None, reference=replace(tour.reference, heading_rad=heading))
    assert found(jumping).lag_s == pytest.approx(0.15, abs=0.02)


def test_speeds_that_are_held_are_told(tour: Recording) -> None:
    """The lag then is that of the middle of the hold."""
    angles = tour.wheel_angles_rad()
    time_s = tour.encoders.time_s
    each = 5
    speeds = []
    for angle in angles:
        wobble = 1.0 + 1e-3 * np.sin(np.arange(len(time_s)))  # no two values alike
        speed = wobble * np.gradient(angle, time_s)
        speeds.append(np.repeat(speed[::each], each)[: len(time_s)])
    held = replace(tour, wheels=EncoderLog(time_s, None, None, *speeds))
    lag = found(held)
    period_s = each * 0.05
    assert lag.hold_s == pytest.approx(period_s)
    # A value stands for the interval that ends with its row, so that the newest is half a row old.
    assert lag.lag_s == pytest.approx(0.5 * period_s - 0.05, abs=0.03)


def test_a_straight_drive_does_not_tell_it(tmp_path: Path) -> None:
    legs: tuple[Leg, ...] = STRAIGHT
    straight = read_recording(write_perfect(tmp_path / "drive", gyro=True, legs=legs))
    assert not found(late(straight, 0.2, 0.01)).determined


def test_a_sparse_reference_does_not_tell_it(tour: Recording) -> None:
    log = tour.reference
    assert log is not None
    rows = slice(None, None, 20)
    columns = {name: getattr(log, name)[rows] for name in ("time_s", "x_m", "y_m", "heading_rad")}
    assert find_lag([replace(tour, fog=None, reference=replace(log, **columns))]) is None


def test_a_gyro_of_the_other_sign_does_not_tell_it(tour: Recording) -> None:
    assert tour.fog is not None
    assert not found(replace(tour, fog=replace(tour.fog, rate_rad_s=-tour.fog.rate_rad_s))).determined


def test_a_lag_beyond_what_is_looked_at_is_not_determined(tour: Recording) -> None:
    for lag_s in (EARLIEST_S - 0.3, LATEST_S + 0.3):
        assert not found(late(tour, lag_s)).determined


@pytest.mark.recordings
def test_the_real_robots_wheels_are_as_late_as_others_found() -> None:
    folders = sorted(SHARED.glob("warthog_*"))
    if not folders:
        pytest.skip("the shared recordings are not here")
    lag = found(*map(read_recording, folders))
    assert lag.against == "gyro"
    assert 0.14 < lag.lag_s < 0.19
    assert lag.sigma_s < 0.01
    assert all(0.14 < of < 0.19 for of in lag.each.values())
    assert lag.hold_s == pytest.approx(0.25, abs=0.01)  # it refreshes its speeds at 4 Hz


@pytest.mark.parametrize(("rows", "hold_s"), [(1, 0.0), (4, 0.2)])
def test_a_counter_that_is_read_every_so_many_rows_is_held(tour: Recording, rows: int, hold_s: float) -> None:
    time_s = np.arange(0.0, 20.0, 0.05)
    turned = np.round(400.0 * np.clip(time_s[(np.arange(400) // rows) * rows] - 5.0, 0.0, 10.0))
    wheels = EncoderLog(time_s, turned, 0.5 * turned, None, None)
    assert held_s(replace(tour, wheels=wheels)) == pytest.approx(hold_s)


@pytest.mark.parametrize("per_row", [0.3, 2.3, 40.0])
def test_a_counter_of_few_counts_is_not_held(tour: Recording, per_row: float) -> None:
    time_s = np.arange(0.0, 20.0, 0.05)
    turned = np.floor(per_row * np.arange(400))
    assert held_s(replace(tour, wheels=EncoderLog(time_s, turned, turned, None, None))) == 0.0
