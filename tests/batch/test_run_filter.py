"""The filter for arrays: the poses of the replay, errors that name the column, and what it does not need."""

import math
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from replay_folders import short_drive

import drd
from drd.arrays import Array
from drd.batch.logs import EncoderLog, FogLog
from drd.batch.run import run
from drd.batch.samples import FIRST_NS, gyro_samples, wheel_samples
from drd.effects.model import load_model
from drd.estimation.calibration import load_calibration
from drd_tools.recordings.folder import Recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.nominal import with_model
from drd_tools.replay.result import Replayed, table

ROOT = Path(__file__).parents[2]
Frame = dict[str, Any]
ROBOT = drd.Robot(
    name="simulated",
    wheel_radius_m=0.1,
    tread_m=0.5,
    counts_per_revolution=4000,
    gyro_rate_hz=10,
    gyro_range_deg_s=100,
    encoders_rate_hz=20,
    slip_noise_m_per_sqrt_m=1e-6,
    reference_position_sigma_m=1e-4,
    reference_heading_sigma_deg=1e-3,
    standstill_at_start_s=12,
)
CALIBRATION = """format: drd-gyro-calibration/1
error_deg_s: {a0: [0.1, 0, 0], a1: [0.01, 0, 0], a2: [0, 0, 0], a3: [0, 0, 0]}
rate_range_deg_s: [-80, 80]
temperature_range_c: [-10, 40]
residual_deg_s: 0.001
provenance: {source: test}
"""
MODEL = "tread_m: 0.6\neffects: [{effect: gyro_scale_error, parameters: {k: 0.02}}]\n"


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return short_drive(tmp_path_factory.mktemp("short"))


@pytest.fixture(scope="module")
def frames(short: Recording) -> tuple[Frame, Frame]:
    """Gyro and wheels as their files have them."""
    found = []
    for name in ("fog.csv", "encoders.csv"):
        header, *lines = (short.folder / name).read_text().splitlines()
        found.append(dict(zip(header.split(","), np.loadtxt(lines, delimiter=",").T, strict=True)))
    gyro, wheels = found
    return gyro, wheels


def rows(poses: drd.Poses) -> np.ndarray[Any, np.dtype[np.float64]]:
    """As the replay's table has them."""
    row, column = np.triu_indices(3)
    trust = poses.covariance_m_rad[:, row, column], poses.position_bound_m, poses.validity == "valid"
    return np.column_stack([poses.time_s, poses.x_m, poses.y_m, poses.heading_rad, *trust])


def is_replayed(poses: drd.Poses, replayed: Replayed) -> bool:
    """To the bit; the replay's table has the start, too."""
    return np.array_equal(rows(poses), table(replayed)[1:])


def test_the_poses_are_those_of_the_replay(short: Recording, frames: tuple[Frame, Frame]) -> None:
    gyro, wheels = frames
    assert short.nominal == ROBOT
    poses, replayed = drd.run_filter(gyro, wheels, ROBOT), replay_folder(short)
    assert is_replayed(poses, replayed)
    assert poses.position_bound_m.tolist() == [p.position_bound_m for p in replayed.poses]
    assert poses.validity.tolist() == [p.validity.value for p in replayed.poses]
    assert (poses.covariance_m_rad == poses.covariance_m_rad.transpose(0, 2, 1)).all()
    assert list(poses.notes) == replayed.notes


def test_data_frames_and_lists_do_as_well(short: Recording, frames: tuple[Frame, Frame]) -> None:
    replayed = replay_folder(short)
    gyro, wheels = ({name: column.tolist() for name, column in frame.items()} for frame in frames)
    assert is_replayed(drd.run_filter(gyro, wheels, ROBOT), replayed)
    pandas = pytest.importorskip("pandas")
    gyro, wheels = (pandas.DataFrame(frame)[10:-10] for frame in frames)  # its index does not begin at 0
    assert len(drd.run_filter(gyro, wheels, ROBOT).x_m) == len(wheels) - 1


def test_temperature_and_gyro_may_lack(frames: tuple[Frame, Frame]) -> None:
    gyro, wheels = {k: v for k, v in frames[0].items() if k != "temperature_c"}, frames[1]
    assert len(drd.run_filter(gyro, wheels, ROBOT).x_m) == len(wheels["time_s"]) - 1
    alone = drd.run_filter(None, wheels, ROBOT)
    assert alone.covariance_m_rad[-1, 2, 2] > drd.run_filter(gyro, wheels, ROBOT).covariance_m_rad[-1, 2, 2]


def test_speeds_give_the_path_that_counts_give(frames: tuple[Frame, Frame]) -> None:
    gyro, wheels = frames
    step_s = np.diff(wheels["time_s"], prepend=-1.0)
    speeds: dict[str, Any] = {"time_s": wheels["time_s"]}
    for side in ("left", "right"):
        turned_rad = np.diff(wheels[f"{side}_counts"], prepend=0.0) * 2.0 * math.pi / 4000
        speeds[f"{side}_rad_s"] = turned_rad / step_s
    counted, driven = (drd.run_filter(gyro, columns, ROBOT) for columns in (wheels, speeds))
    assert driven.x_m[-1] == pytest.approx(counted.x_m[-1], abs=1e-4)
    assert driven.heading_rad[-1] == pytest.approx(counted.heading_rad[-1], abs=1e-4)


def test_calibration_and_model_are_files_or_what_they_hold(
    short: Recording, frames: tuple[Frame, Frame], tmp_path: Path
) -> None:
    gyro, wheels = frames
    calibration, model = tmp_path / "gyro.yaml", tmp_path / "model.yaml"
    calibration.write_text(CALIBRATION)
    model.write_text(MODEL)
    replayed = replay_folder(with_model(short, model), None, calibration)
    loaded = load_calibration(calibration), load_model(model)
    for c, m in ((calibration, model), (str(calibration), str(model)), loaded):
        assert is_replayed(drd.run_filter(gyro, wheels, ROBOT, calibration=c, model=m), replayed)
    assert not is_replayed(drd.run_filter(gyro, wheels, ROBOT), replayed)


@pytest.mark.parametrize(
    ("part", "column", "value", "expected"),
    [
        ("gyro", "rate_deg_s", None, r"gyro: rate_deg_s: expected a column of numbers, got none"),
        (
            "gyro",
            "rate_deg_s",
            [1.0, 2.0],
            r"gyro: rate_deg_s: expected \d+ numbers, as many as time_s has, .*\(2,",
        ),
        ("gyro", "rate_deg_s", "fast", r"gyro: rate_deg_s: expected a column of numbers, got could not convert"),
        ("gyro", "temperature_c", math.nan, r"gyro: temperature_c: expected finite numbers, got nan at index 3"),
        ("gyro", "time_s", 0.0, r"gyro: time_s: expected rising times, got 0 at index 3"),
        ("gyro", "time_s", 1e6, r"gyro: time_s: expected rising times, got .* at index 4"),
        ("wheels", "time_s", 0.0, r"wheels: time_s: expected rising times, got 0 at index 3"),
        ("wheels", "left_counts", 0.5, r"wheels: left_counts: expected a whole number of counts, got 0.5 at index 3"),
        ("wheels", "left_counts", None, r"wheels: left_counts: expected a column of numbers, got none"),
        ("wheels", "right_counts", [[1.0]], r"wheels: right_counts: expected \d+ numbers.*got .*shape \(1, 1\)"),
    ],
)
def test_what_is_wrong_is_said_with_its_column(
    frames: tuple[Frame, Frame], part: str, column: str, value: Any, expected: str
) -> None:
    given = {
        name: {k: v.tolist() for k, v in frame.items()} for name, frame in zip(("gyro", "wheels"), frames, strict=True)
    }
    if value is None:
        del given[part][column]
    elif isinstance(value, list):
        given[part][column] = value
    else:
        given[part][column][3] = value
    with pytest.raises(drd.ConfigError, match=expected):
        drd.run_filter(given["gyro"], given["wheels"], ROBOT)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda t: (1e3 * t).astype("timedelta64[ms]"), r"time_s: expected a column of numbers, got timedelta64\[ms\]"),
        (lambda t: (1e3 * t).astype("datetime64[ms]"), r"time_s: expected a column of numbers, got datetime64\[ms\]"),
        (lambda t: np.ma.masked_less(t, t[3]), r"time_s: expected finite numbers, got nan at index 0"),
    ],
)
def test_columns_whose_numbers_mean_something_else_are_refused(
    frames: tuple[Frame, Frame], change: Callable[[Array], Any], expected: str
) -> None:
    gyro, wheels = (frame | {"time_s": change(frame["time_s"])} for frame in frames)
    with pytest.raises(drd.ConfigError, match=expected):
        drd.run_filter(gyro, wheels, ROBOT)


def test_logs_that_have_nothing_in_common_or_are_too_short_are_refused(frames: tuple[Frame, Frame]) -> None:
    gyro, wheels = frames
    with pytest.raises(drd.ConfigError, match=r"gyro: time_s: expected times that overlap wheels's, 0 to 5 s"):
        drd.run_filter({**gyro, "time_s": gyro["time_s"] + 100.0}, wheels, ROBOT)
    with pytest.raises(drd.ConfigError, match=r"wheels: time_s: expected an array of 2 numbers or more, got .*\(1,\)"):
        drd.run_filter(gyro, {k: v[:1] for k, v in wheels.items()}, ROBOT)


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"wheel_radius_m": -0.1}, r"robot: wheel_radius_m: expected a number in m from 0.001 to 5, got -0.1"),
        ({"tread_m": "wide"}, r"robot: tread_m: expected a number in m from 0.01 to 50, got 'wide'"),
        ({"tread_m": math.nan}, r"robot: tread_m: expected a number, since there are wheels, got NaN"),
        ({"counts_per_revolution": None}, r"robot: counts_per_revolution: expected a number, since wheels has counts"),
        ({"drive": "tracks"}, r"robot: drive: expected one of auto, differential, skid, got 'tracks'"),
    ],
)
def test_a_robot_that_cannot_be_is_refused(frames: tuple[Frame, Frame], changed: dict[str, Any], expected: str) -> None:
    sizes: dict[str, Any] = {"wheel_radius_m": 0.1, "tread_m": 0.5, "counts_per_revolution": 4000, **changed}
    with pytest.raises(drd.ConfigError, match=expected):
        drd.run_filter(*frames, drd.Robot(**sizes))


def test_numbers_of_numpy_are_numbers_and_what_is_stated_is_in_force() -> None:
    robot = drd.Robot(wheel_radius_m=np.float64(0.1), tread_m=np.float64(0.5), drive="skid", max_speed_m_s=2.0)
    config = robot.config()
    assert (config.robot.wheel_radius_m, config.robot.drive, config.robot.max_speed_m_s) == (0.1, "skid", 2.0)
    assert (config.fog.protocol, robot.config(has_gyro=False).fog.protocol) == ("ecore", "none")
    assert drd.Robot(wheel_radius_m=0.1, tread_m=0.5).config().robot.max_speed_m_s == 10.0


def test_the_estimator_takes_samples_as_they_come(frames: tuple[Frame, Frame]) -> None:
    gyro, wheels = frames
    config = ROBOT.config()
    log = EncoderLog(wheels["time_s"], wheels["left_counts"], wheels["right_counts"], None, None)
    fog = FogLog(gyro["time_s"], np.radians(gyro["rate_deg_s"]), None)
    samples = gyro_samples(fog, config, FIRST_NS)[0], wheel_samples(log, config, FIRST_NS)[0]
    poses = run(drd.Estimator(config), *samples)
    assert poses[-1].x_m == pytest.approx(drd.run_filter(gyro, wheels, ROBOT).x_m[-1], abs=1e-3)


# ---- what it does not need -----------------------------------------------------------------------------------------

BLOCKED = f"""
import runpy, sys
for name in ("zenoh", "can", "serial", "scipy", "matplotlib", "mcap", "tqdm", "threadpoolctl", "pandas", "drd_tools"):
    sys.modules[name] = None
import drd
assert not {{"numpy", "yaml", "msgspec"}} & sys.modules.keys(), "import drd is light"
assert set(drd.__all__) <= set(dir(drd))
for name in drd.__all__:
    getattr(drd, name)
runpy.run_path({str(ROOT / "tools/examples/filter_arrays.py")!r})
"""


def test_the_example_needs_numpy_yaml_and_msgspec_only() -> None:
    done = subprocess.run(
        [sys.executable, "-c", BLOCKED],
        capture_output=True,
        text=True,
        env={"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    end, true, bound = (line.split() for line in done.stdout.splitlines())
    error_m = math.hypot(*(float(end[k].rstrip(",")) - float(true[k + 1].rstrip(",")) for k in (2, 5)))
    assert 0.0 < error_m < float(bound[1])


@pytest.mark.parametrize(("modulus", "fastest_m_s"), [(4096, None), (4096, 100.0)])
def test_counters_that_start_again_are_told(
    frames: tuple[Frame, Frame], modulus: int, fastest_m_s: float | None
) -> None:
    gyro, wheels = frames
    robot = replace(ROBOT, max_speed_m_s=fastest_m_s)
    wrapped = wheels | {name: wheels[name] % modulus for name in ("left_counts", "right_counts")}
    assert drd.run_filter(gyro, wheels, robot).notes == ()
    notes = drd.run_filter(gyro, wrapped, robot).notes
    assert [n for n in notes if re.match(r"wheels: left_counts steps by more than half of its range \(rows: \d+\)", n)]
    left_out = [n for n in notes if re.match(r"wheels: rows in which one is faster than 10 m/s were left out", n)]
    # As a jump only where it is faster than the robot can be: 4096 counts of 4000 in 0.05 s are 12.9 m/s.
    assert len(left_out) == (fastest_m_s is None)


def test_what_is_left_out_is_told(frames: tuple[Frame, Frame]) -> None:
    gyro, wheels = frames
    kept = np.abs(wheels["time_s"] - np.median(wheels["time_s"])) > 2.0
    peak = gyro["rate_deg_s"].copy()
    peak[7] = 400.0
    notes = drd.run_filter(gyro | {"rate_deg_s": peak}, {k: v[kept] for k, v in wheels.items()}, ROBOT).notes
    assert notes[:2] == (
        "wheels: the travel in gaps of more than 0.5 s was left out (1).",
        "gyro: rows beyond its range of 100 deg/s were left out (1).",
    )


def test_what_drd_does_not_have_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        drd.Nothing  # type: ignore[attr-defined]  # noqa: B018
