"""Reading a log at standstill: what is bridged, cut and refused."""

from pathlib import Path

import numpy as np
import pytest
from gyro_noise_data import static_log, write_log
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD, RAD_PER_DEG
from drd_tools.calibrate.noise.allan import allan_curve
from drd_tools.calibrate.noise.static_log import StaticLog, check_standstill, even, motion, read_static_log


def columns(log: StaticLog) -> tuple[np.ndarray, np.ndarray]:
    return log.time_s.copy(), log.rate_rad_s * DEG_PER_RAD


def evened(time_s: np.ndarray, rate_deg_s: np.ndarray) -> StaticLog:
    return even("log.csv", "", time_s, rate_deg_s, None)


def test_a_file_and_a_recordings_folder_read_alike(tmp_path: Path) -> None:
    made = static_log(200.0)
    temperature = np.full(len(made.rate_rad_s), 25.5)
    file = write_log(tmp_path / "fog.csv", made, temperature)
    for path in (file, tmp_path):
        log = read_static_log(path)
        assert log.interval_s == pytest.approx(0.1)
        assert log.duration_s == pytest.approx(200.0)
        assert log.rate_rad_s == pytest.approx(made.rate_rad_s, abs=1e-10)
        assert log.temperature_c == pytest.approx(temperature)
        assert len(log.sha256) == 64
        assert log.notes == ()


def test_empty_temperatures_are_bridged_and_none_at_all_is_none(tmp_path: Path) -> None:
    time_s, rate = columns(static_log(120.0))
    rows = [
        f"{t:.2f},{r:.8f},{25 + t / 100 if i % 10 == 0 else ''}"
        for i, (t, r) in enumerate(zip(time_s, rate, strict=True))
    ]
    file = tmp_path / "log.csv"
    file.write_text("time_s,rate_deg_s,temperature_c\n" + "\n".join(rows))
    temperature = read_static_log(file).temperature_c
    assert temperature is not None
    assert temperature[:1000] == pytest.approx(25 + time_s[:1000] / 100, abs=1e-6)
    file.write_text("time_s,rate_deg_s,temperature_c\n" + "\n".join(row.rsplit(",", 1)[0] + "," for row in rows))
    assert read_static_log(file).temperature_c is None


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "expected the header time_s,rate_deg_s,temperature_c or time_s,rate_deg_s"),
        ("time_s,rate_rad_s\n0,1\n", "(1 rad/s is 57.29578 deg/s)"),
        ("t,rate_deg_s\n0,1\n", "expected time_s,rate_deg_s"),
        ("time_s,rate_deg_s\n", "at least 2 rows of numbers, got 0"),
        ("time_s,rate_deg_s\n0,0.1\n0.1,abc\n", ":3: rate_deg_s: expected a finite number, got 'abc'"),
        ("time_s,rate_deg_s\n0,0.1\n0.1\n", ":3: rate_deg_s: expected a finite number, got ''"),
        ("time_s,rate_deg_s\n0,0.1\n0.1,nan\n", ":3: rate_deg_s: expected a finite number, got 'nan'"),
        ("time_s,rate_deg_s\n0,0.1\n0.2,0.1\n0.1,0.1\n", ":4: time_s: expected a time after 0.2, got 0.1"),
        ("time_s,rate_deg_s\n0,0.1\n0,0.1\n0,0.1\n", "time_s: expected rising times"),
        ("time_s,rate_deg_s\n0,0.1\n0.1,0.1\n0.2,0.2\n", "a standstill of at least 100 s, better an hour, got 0.3 s"),
    ],
)
def test_files_that_cannot_be_used(tmp_path: Path, text: str, complaint: str) -> None:
    file = tmp_path / "log.csv"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_static_log(file)
    assert complaint in str(caught.value)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_or_not_text(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        read_static_log(tmp_path / "none.csv")
    (tmp_path / "fog.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(ConfigError, match="a readable UTF-8 text file"):
        read_static_log(tmp_path)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.02), st.booleans())
@settings(deadline=None, max_examples=20)
def test_jitter_of_the_time_stamps_changes_nothing(seed: int, jitter_s: float, bundled: bool) -> None:
    time_s, rate = columns(static_log(200.0, 20.0, seed=2))
    late = np.random.default_rng(seed).uniform(0.0, jitter_s, len(time_s))
    stamped = np.sort(time_s + late)
    if bundled:
        stamped = np.ceil(stamped / 0.128) * 0.128
    log = evened(stamped, rate)
    assert len(log.rate_rad_s) == len(rate)
    assert log.rate_rad_s * DEG_PER_RAD == pytest.approx(rate)
    assert log.interval_s == pytest.approx(0.05, rel=2e-3)
    assert log.notes == ()


def test_few_lost_samples_are_bridged_and_do_not_change_the_deviation() -> None:
    time_s, rate = columns(static_log(1000.0))
    kept = np.ones(len(rate), bool)
    kept[[500, 501, 3000, 7000]] = False
    log = evened(time_s[kept], rate[kept])
    assert log.notes == ("4 lost samples (0.04%) were bridged with straight lines.",)
    assert len(log.rate_rad_s) == len(rate)
    assert log.interval_s == pytest.approx(0.1)
    expected = allan_curve(rate * RAD_PER_DEG, 0.1).deviation
    assert allan_curve(log.rate_rad_s, 0.1).deviation == pytest.approx(expected, rel=0.01)


def test_at_a_long_hole_the_longest_interval_is_taken() -> None:
    time_s, rate = columns(static_log(1000.0))
    kept = (time_s < 300.0) | (time_s > 310.0)
    log = evened(time_s[kept], rate[kept])
    assert log.duration_s == pytest.approx(690.0, abs=0.2)
    assert log.begins_s == pytest.approx(310.0, abs=0.2)
    assert "1 holes in the log" in log.notes[0]


def test_many_holes_leave_too_little() -> None:
    time_s, rate = columns(static_log(1000.0))
    kept = np.arange(len(rate)) % 50 < 45
    with pytest.raises(ConfigError, match="a standstill of at least 100 s"):
        evened(time_s[kept], rate[kept])


@pytest.mark.parametrize(("size_deg_s", "seconds"), [(0.5, 1.5), (20.0, 10.0), (-0.1, 30.0)])
def test_motion_is_refused_with_its_time(size_deg_s: float, seconds: float) -> None:
    log = static_log(600.0)
    log.rate_rad_s[(log.time_s >= 200.0) & (log.time_s < 200.0 + seconds)] += size_deg_s * RAD_PER_DEG
    found = motion(log)
    assert found is not None
    assert found[0] == pytest.approx(200.0, abs=1.5)
    with pytest.raises(ConfigError, match=r"a standstill throughout, got a rate of .* deg/s at (199|200|201)"):
        check_standstill(log)


def test_a_robot_that_drives_all_the_time_is_refused() -> None:
    log = static_log(600.0)
    log.rate_rad_s[:] += 20.0 * RAD_PER_DEG * np.sin(log.time_s / 3.0) * (np.sin(log.time_s / 40.0) > -0.8)
    with pytest.raises(ConfigError, match="standstill"):
        check_standstill(log)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kind", ["white", "flicker", "random walk", "warm-up", "quantised", "precise"])
def test_noise_and_warm_up_are_no_motion(kind: str, seed: int) -> None:
    deg_h = RAD_PER_DEG / 3600.0
    log = {
        "white": lambda: static_log(1800.0, seed=seed),
        "flicker": lambda: static_log(1800.0, seed=seed, B=5 * deg_h),
        "random walk": lambda: static_log(1800.0, seed=seed, K=30 * deg_h / 60),
        "warm-up": lambda: static_log(1800.0, seed=seed),
        "quantised": lambda: static_log(1800.0, seed=seed, N=1e-7),
        "precise": lambda: static_log(300.0, 100.0, seed=seed, N=0.012 * RAD_PER_DEG / 60, K=0.1 * deg_h / 60),
    }[kind]()
    if kind == "warm-up":
        log.rate_rad_s[:] += 50 * deg_h * np.exp(-log.time_s / 60.0)
    if kind == "quantised":
        log.rate_rad_s[:] = np.round(log.rate_rad_s / (0.003 * RAD_PER_DEG)) * 0.003 * RAD_PER_DEG
        log.rate_rad_s[::7] += 0.003 * RAD_PER_DEG
    check_standstill(log)


def test_a_constant_rate_and_a_turning_gyro_are_refused() -> None:
    log = static_log(200.0)
    log.rate_rad_s[:] = 0.0
    with pytest.raises(ConfigError, match="a rate that varies, got 0 in all rows"):
        check_standstill(log)
    with pytest.raises(ConfigError, match="it turns, or the unit is wrong"):
        check_standstill(static_log(200.0, bias_deg_h=2 * 3600.0))


def test_after_leaves_out_the_beginning() -> None:
    log = static_log(200.0)
    rest = log.after(50.0)
    assert rest.duration_s == pytest.approx(150.0)
    assert rest.begins_s == pytest.approx(50.0)
    assert rest.rate_rad_s == pytest.approx(log.rate_rad_s[500:])
