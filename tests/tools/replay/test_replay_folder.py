"""Replay of recording folders: the path of an errorless drive, the same bits again."""

import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from replay_folders import long_drive, short_drive, true_end, write_perfect

from drd.arrays import Array
from drd.batch.logs import EncoderLog, FogLog
from drd.batch.samples import FIRST_NS, gyro_samples, metres_per_count, stamps_ns, wheel_samples
from drd.config.schema import ConfigError
from drd.encoders.counter import Counter, Outcome
from drd.encoders.pairing import Pairing
from drd.samples import Side, Validity
from drd.units import NS_PER_S
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.nominal import configuration
from drd_tools.replay.reference import end_error
from drd_tools.replay.result import table


@pytest.fixture(scope="module")
def with_gyro(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return long_drive(tmp_path_factory.mktemp("gyro"))


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return short_drive(tmp_path_factory.mktemp("short"))


@pytest.mark.parametrize("gyro", [True, False])
@pytest.mark.parametrize("as_speeds", [True, False])
def test_an_errorless_drive_gives_the_true_path(tmp_path: Path, gyro: bool, as_speeds: bool) -> None:
    folder = write_perfect(tmp_path / "drive", gyro=gyro, as_speeds=as_speeds)
    recording = read_recording(folder)
    replayed = replay_folder(recording)
    rows = table(replayed)
    x_m, y_m, heading_rad = true_end(folder)
    assert rows[0, :4].tolist() == [0.0, 0.0, 0.0, 0.0]
    assert rows[-1, 1:3] == pytest.approx([x_m, y_m], abs=0.003)
    assert math.remainder(rows[-1, 3] - heading_rad, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-3)
    assert len(replayed.poses) == replayed.samples["wheels"] == len(recording.encoders.time_s) - 1
    assert replayed.samples["gyro"] == (0 if recording.fog is None else len(recording.fog.time_s))
    error = end_error(replayed, recording)
    assert error is not None
    assert error.position_m < 0.003


def test_the_bias_is_measured_in_the_standstill_that_robot_yaml_states(with_gyro: Recording) -> None:
    replayed = replay_folder(with_gyro)
    assert replayed.counters["estimator"]["bias_measured"] == 1
    error = end_error(replayed, with_gyro)
    assert error is not None
    assert abs(error.heading_rad) < 1e-3
    moving = replace(with_gyro, nominal=replace(with_gyro.nominal, standstill_at_start_s=0.0))
    assert replay_folder(moving).counters["estimator"]["bias_measured"] == 0


def test_the_same_recording_gives_the_same_bits_in_other_processes(short: Recording) -> None:
    code = (
        "from pathlib import Path; from drd_tools.recordings.folder import read_recording;"
        "from drd_tools.replay.folder_source import replay_folder;"
        f"print(replay_folder(read_recording(Path({str(short.folder)!r}))).digest())"
    )
    found = {replay_folder(short).digest(), replay_folder(short).digest()}
    for seed in ("1", "77"):
        process = subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        )
        found.add(process.stdout.strip())
    assert len(found) == 1


def test_one_count_more_gives_another_digest(short: Recording) -> None:
    left = short.encoders.left_counts
    assert left is not None
    changed = left.copy()
    changed[-1] += 1
    assert replay_folder(short).digest() != replay_folder(_with_left(short, changed)).digest()


def _with_left(recording: Recording, left: Array) -> Recording:
    return replace(recording, wheels=replace(recording.encoders, left_counts=left))


@settings(deadline=None, max_examples=15)
@given(shift_s=st.integers(-1_000_000, 1_000_000))
def test_the_clock_on_which_the_recording_began_does_not_matter(short: Recording, shift_s: int) -> None:
    assert short.fog is not None
    shifted = replace(
        short,
        wheels=replace(short.encoders, time_s=short.encoders.time_s + shift_s),
        fog=replace(short.fog, time_s=short.fog.time_s + shift_s),
    )
    replayed = replay_folder(shifted)
    assert replayed.digest() == replay_folder(short).digest()
    assert table(replayed)[0, 0] == pytest.approx(shift_s, abs=1e-6)


def test_stamps_of_an_epoch_keep_what_a_double_holds() -> None:
    assert stamps_ns(np.array([1.7e9 + 0.5, -0.25]), 5).tolist() == [1_700_000_000_500_000_005, -249_999_995]


@pytest.mark.parametrize(
    ("which", "change", "expected"),
    [
        ("wheels", lambda t: t * 1e9 + 1e18, r"encoders.csv: time_s: expected seconds, at most 4e\+09"),
        ("wheels", lambda t: np.where(t < 2.0, t, t + 1e6), r"encoders.csv: time_s: .* rows at most 86400 s apart"),
        (
            "wheels",
            lambda t: t * 1e3,
            r"encoders.csv: time_s: expected seconds, .* 10 s apart, got rows usually 50 apart",
        ),
        ("fog", lambda t: t * 1e3, r"fog.csv: time_s: expected seconds, .* 10 s apart, got rows usually 100 apart"),
        ("fog", lambda t: t + 1.7e9, r"fog.csv: time_s: .* overlap encoders.csv's, 0 to 5 s, got 17000000"),
        ("fog", lambda t: t - 100.0, r"fog.csv: time_s: expected times that overlap"),
    ],
)
def test_times_that_do_not_belong_together_are_refused(
    short: Recording, which: str, change: Callable[[Array], Array], expected: str
) -> None:
    log = getattr(short, which)
    with pytest.raises(ConfigError, match=expected):
        replay_folder(replace(short, **{which: replace(log, time_s=change(log.time_s))}))


@settings(deadline=None, max_examples=10)
@given(late_ms=st.integers(0, 140), which=st.sampled_from(["wheels", "fog"]))
def test_late_rows_and_their_stated_latency_are_rows_in_time(
    short: Recording, tmp_path_factory: pytest.TempPathFactory, late_ms: int, which: str
) -> None:
    log = getattr(short, which)
    late = replace(short, **{which: replace(log, time_s=log.time_s + late_ms / 1000.0)})
    file = tmp_path_factory.mktemp("late") / "part.yaml"
    section = {"wheels": "encoders", "fog": "fog"}[which]
    file.write_text(f"{section}: {{latency_s: {late_ms / 1000.0}}}\n")
    mended, prompt = replay_folder(late, file), replay_folder(short)
    assert table(mended) == pytest.approx(table(prompt), abs=1e-6)
    if late_ms > 20:  # half a millimetre of the way
        assert table(replay_folder(late))[-1] != pytest.approx(table(prompt)[-1], abs=1e-6)


def test_a_latency_that_the_daemon_took_off_is_not_taken_off_again(short: Recording, tmp_path: Path) -> None:
    believed = configuration(short)
    before = replace(believed, encoders=replace(believed.encoders, latency_s=0.05))
    recorded = replace(short, config=before)
    file = tmp_path / "part.yaml"
    times_s = {}
    for latency_s in (0.0, 0.05, 0.12):
        file.write_text(f"encoders: {{latency_s: {latency_s}}}\n")
        times_s[latency_s] = table(replay_folder(recorded, file))[0, 0]
    assert times_s == pytest.approx({0.0: 0.05, 0.05: 0.0, 0.12: -0.07})
    assert table(replay_folder(recorded))[0, 0] == 0.0


def test_after_a_gap_the_table_has_one_pose_a_time(with_gyro: Recording) -> None:
    log = with_gyro.encoders
    assert log.left_counts is not None
    assert log.right_counts is not None
    keep = (log.time_s < 30.0) | (log.time_s > 30.29)  # it ends where a gyro sample ends
    cut = EncoderLog(log.time_s[keep], log.left_counts[keep], log.right_counts[keep], None, None)
    replayed = replay_folder(replace(with_gyro, wheels=cut))
    stamps_ns = [p.t_ns for p in replayed.poses]
    twice = {t for t in stamps_ns if stamps_ns.count(t) > 1}
    assert twice, "the drive does not have what this is about"
    rows = table(replayed)
    assert (np.diff(rows[:, 0]) > 0.0).all()
    last = {p.t_ns: (p.x_m, p.y_m, p.heading_rad) for p in replayed.poses}  # of one time: the newest knowledge
    assert rows[1:, 1:4].tolist() == [list(pose) for pose in last.values()]


# ---- samples -------------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=60)
@given(
    st.lists(
        st.tuples(
            st.floats(0.001, 0.3).map(lambda s: round(s, 6)) | st.just(0.8),
            st.integers(-400, 400) | st.just(10**7),
            st.integers(-400, 400),
        ),
        min_size=1,
        max_size=40,
    )
)
def test_rows_of_counts_become_what_the_daemons_counters_and_pairing_make(
    short: Recording, steps: list[tuple[float, int, int]]
) -> None:
    config = configuration(short)
    times, left, right = (np.concatenate([[0.0], np.cumsum(column)]) for column in zip(*steps, strict=True))
    samples, began_ns, counters = wheel_samples(EncoderLog(times, left, right, None, None), config, FIRST_NS)
    unit = metres_per_count(config)
    pairing = Pairing(0.04, config.encoders.gap_s, 1.0 / config.encoders.rate_hz)
    sides = {
        side: Counter(None, config.robot.max_speed_m_s / unit[0], 1.0 / config.encoders.rate_hz, config.encoders.gap_s)
        for side in Side
    }
    expected = []
    for t_ns, *counts in zip(stamps_ns(times, FIRST_NS).tolist(), left.tolist(), right.tolist(), strict=True):
        for side, count in zip(Side, counts, strict=True):
            outcome = sides[side].add(t_ns, count)
            moved, told = outcome is Outcome.MOVED, outcome is Outcome.GAP
            sample = pairing.add(side, t_ns, sides[side].total * unit[0], moved=moved, told=told)
        if sample is not None:
            expected.append(sample)
    assert [s.t_ns for s in samples] == [s.t_ns for s in expected]
    for ours, theirs in zip(samples, expected, strict=True):
        assert ours[1:] == pytest.approx(theirs[1:], abs=1e-9)
    assert counters["gaps"] + counters["jumps"] == pairing.counters["new_starts"]
    if samples:
        assert began_ns == samples[0].t_ns - round(samples[0].interval_s * NS_PER_S)


def test_counts_add_up_without_rounding(with_gyro: Recording) -> None:
    log, config = with_gyro.encoders, configuration(with_gyro)
    assert log.left_counts is not None
    samples, _, _ = wheel_samples(log, config, FIRST_NS)
    unit_m = metres_per_count(config)[0]
    counts = sum(round(s.left_m / unit_m) for s in samples)
    assert counts == log.left_counts[-1] - log.left_counts[0]
    assert all(s.left_m == round(s.left_m / unit_m) * unit_m for s in samples)


def test_speeds_hold_over_the_interval_that_ends_with_their_row(short: Recording) -> None:
    log = EncoderLog(np.array([0.0, 0.1, 0.3]), None, None, np.array([9.0, 1.0, 2.0]), np.array([9.0, 3.0, 4.0]))
    samples, began_ns, _ = wheel_samples(log, configuration(short), FIRST_NS)
    assert began_ns == FIRST_NS
    travel = [(s.interval_s, s.left_m, s.right_m) for s in samples]
    assert np.array(travel) == pytest.approx(np.array([(0.1, 0.01, 0.03), (0.2, 0.04, 0.08)]))


def test_missing_gyro_rows_leave_a_hole_and_rates_beyond_the_range_are_not_used(short: Recording) -> None:
    time_s = np.array([0.1, 0.2, 0.3, 0.9, 1.0, 1.1, 1.2])
    log = FogLog(time_s, np.radians([1.0, 2.0, 3.0, 4.0, 99.95, -6.0, 7.0]), None)
    samples, counters = gyro_samples(log, configuration(short), FIRST_NS)
    assert counters == {"holes": 1, "over_range": 1}
    assert [s.interval_s for s in samples] == pytest.approx([0.1] * 6)
    assert np.degrees([s.rate_rad_s for s in samples]) == pytest.approx([1.0, 2.0, 3.0, 4.0, -6.0, 7.0])
    assert all(math.isnan(s.temperature_c) for s in samples)


@pytest.mark.parametrize(("gyro", "rate_hz"), [(True, 10.0), (False, 20.0)])
def test_in_a_long_gap_of_the_wheels_poses_go_on_and_say_so(with_gyro: Recording, gyro: bool, rate_hz: float) -> None:
    """From the gyro's samples, or else from the ticks."""
    log = with_gyro.encoders
    assert log.left_counts is not None
    assert log.right_counts is not None
    keep = (log.time_s < 30.0) | (log.time_s > 33.0)
    cut = EncoderLog(log.time_s[keep], log.left_counts[keep], log.right_counts[keep], None, None)
    replayed = replay_folder(replace(with_gyro, wheels=cut, fog=with_gyro.fog if gyro else None))
    assert replayed.counters["encoders"] == {"gaps": 1, "jumps": 0}
    assert replayed.counters["estimator"]["wheel_gaps"] == 1
    silent = [p for p in replayed.poses if 31.0 < (p.t_ns - replayed.zero_ns) / NS_PER_S < 33.0]
    assert len(silent) == pytest.approx(2.0 * rate_hz, abs=1)
    assert all(p.validity is not Validity.VALID for p in silent)
    assert all("encoders" in {r.source for r in p.reasons} for p in silent)


def test_a_recording_at_one_row_a_second_gives_poses(tmp_path: Path) -> None:
    tmp_path.joinpath("robot.yaml").write_text("wheel: {radius_m: 0.1, counts_per_revolution: 1000}\ntread_m: 0.5\n")
    rows = "".join(f"{t},{100 * t},{100 * t}\n" for t in range(20))
    tmp_path.joinpath("encoders.csv").write_text("time_s,left_counts,right_counts\n" + rows)
    replayed = replay_folder(read_recording(tmp_path))
    assert replayed.poses[-1].x_m == pytest.approx(19 * 100 * 0.2 * math.pi / 1000)
    assert {p.validity for p in replayed.poses} == {Validity.VALID}
