"""The neutral recording folder: what is read, and the error that each kind of bad input gets."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.config.schema import ConfigError
from drd_tools.recordings.folder import read_recording

SHARED = Path(__file__).resolve().parents[3].parent / "shared"
ROBOT = """# A comment at the top.
name: bot
wheel: {radius_m: 0.1, counts_per_revolution: 1000}
tread_m: 0.5
fog: {rate_hz: 10, angle_random_walk_deg_per_sqrt_h: 0.08}
encoders: {rate_hz: 20, slip_noise_m_per_sqrt_m: 0.002}
reference: {position_sigma_m: 0.01, heading_sigma_deg: 0.1}
standstill_at_start_s: 10
"""
COUNTS = "time_s,left_counts,right_counts\n0,0,100\n1,500,1100\n"
SPEEDS = "time_s,left_rad_s,right_rad_s\n0,9,9\n1,1,2\n3,3,4\n"
POSES = "time_s,x_m,y_m,heading_deg\n0,0,0,170\n1,1,0,-170\n"


def folder(path: Path, **files: str) -> Path:
    texts = {
        "robot.yaml": ROBOT,
        "encoders.csv": COUNTS,
        **{name.replace("_", "."): text for name, text in files.items()},
    }
    for name, text in texts.items():
        (path / name).write_text(text)
    return path


def test_a_whole_folder_is_read(tmp_path: Path) -> None:
    fog = "time_s,rate_deg_s,temperature_c\n0.1,180,20\n0.2,-90,21\n"
    recording = read_recording(folder(tmp_path, fog_csv=fog, reference_csv=POSES))
    assert recording.name == tmp_path.name
    assert recording.nominal.tread_m == 0.5
    assert recording.nominal.standstill_at_start_s == 10.0
    assert recording.fog is not None
    assert recording.fog.rate_rad_s == pytest.approx([math.pi, -math.pi / 2])
    assert recording.fog.temperature_c is not None
    assert recording.fog.temperature_c.tolist() == [20.0, 21.0]
    assert recording.reference is not None
    assert np.degrees(recording.reference.heading_rad) == pytest.approx([170.0, 190.0])
    assert sorted(recording.sha256) == ["encoders.csv", "fog.csv", "reference.csv", "robot.yaml"]


def test_gyro_reference_and_temperature_are_optional(tmp_path: Path) -> None:
    assert read_recording(folder(tmp_path)).fog is None
    recording = read_recording(folder(tmp_path, fog_csv="time_s,rate_deg_s\n0.1,1\n"))
    assert recording.reference is None
    assert recording.fog is not None
    assert recording.fog.temperature_c is None


def test_without_encoders_the_wheels_may_be_null(tmp_path: Path) -> None:
    tmp_path.joinpath("robot.yaml").write_text("wheel: {radius_m: null}\ntread_m: null\nfog: {rate_hz: 10}\n")
    tmp_path.joinpath("fog.csv").write_text("time_s,rate_deg_s\n0.1,1\n")
    nominal = read_recording(tmp_path).nominal
    assert math.isnan(nominal.wheel_radius_m)
    assert math.isnan(nominal.tread_m)
    assert nominal.gyro_rate_hz == 10.0


def test_counts_become_wheel_angles_from_the_first_row(tmp_path: Path) -> None:
    left_rad, right_rad = read_recording(folder(tmp_path)).wheel_angles_rad()
    assert left_rad == pytest.approx([0.0, math.pi])
    assert right_rad == pytest.approx([0.0, 2.0 * math.pi])


def test_speeds_hold_over_the_interval_that_ends_with_their_row(tmp_path: Path) -> None:
    robot = ROBOT.replace("counts_per_revolution: 1000", "counts_per_revolution: null")
    recording = read_recording(folder(tmp_path, robot_yaml=robot, encoders_csv=SPEEDS))
    left_rad, right_rad = recording.wheel_angles_rad()
    assert left_rad.tolist() == [0.0, 1.0, 7.0]
    assert right_rad.tolist() == [0.0, 2.0, 10.0]


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(-170.0, 170.0), min_size=2, max_size=20))
def test_headings_wrapped_or_not_are_the_same(tmp_path_factory: pytest.TempPathFactory, steps: list[float]) -> None:
    whole = np.cumsum(steps)
    tables = []
    for heading in (whole, (whole + 180.0) % 360.0 - 180.0):
        rows = "".join(f"{k},0,0,{value:.6f}\n" for k, value in enumerate(heading))
        path = folder(tmp_path_factory.mktemp("r"), reference_csv="time_s,x_m,y_m,heading_deg\n" + rows)
        reference = read_recording(path).reference
        assert reference is not None
        tables.append(np.diff(reference.heading_rad))
    assert tables[0] == pytest.approx(tables[1], abs=1e-6)


def test_sparse_headings_beyond_a_turn_keep_their_turns(tmp_path: Path) -> None:
    reference = read_recording(
        folder(tmp_path, reference_csv="time_s,x_m,y_m,heading_deg\n0,0,0,0\n60,0,0,720\n")
    ).reference
    assert reference is not None
    assert reference.heading_rad[-1] == pytest.approx(4.0 * math.pi)


def test_spreadsheet_marks_and_empty_lines_do_no_harm(tmp_path: Path) -> None:
    text = "\ufeff# exported\r\ntime_s, left_counts, right_counts\r\n\r\n0,0,0\r\n1,2.0,3\r\n"
    log = read_recording(folder(tmp_path, encoders_csv=text)).encoders
    assert log.left_counts is not None
    assert log.left_counts.tolist() == [0.0, 2.0]


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("robot_yaml", "tread_m: 0.5\n", r"robot.yaml: wheel.radius_m: expected a number in m .*the key is required"),
        (
            "robot_yaml",
            ROBOT.replace("0.5", "null"),
            r"robot.yaml: tread_m: expected a number in m .*the key is required",
        ),
        ("robot_yaml", ROBOT.replace("tread_m", "track_m"), r"robot.yaml:4: track_m: expected one of .*unknown key"),
        ("robot_yaml", ROBOT.replace("0.5", "wide"), r"robot.yaml:4: tread_m: expected a number in m .*got 'wide'"),
        ("robot_yaml", ROBOT.replace("1000", "null"), r"robot.yaml:3: wheel.counts_per_revolution: expected a number"),
        ("robot_yaml", "{", r"robot.yaml:\d: .*expected YAML"),
        ("encoders_csv", "", r"encoders.csv: .*expected the header time_s,left_counts.*got an empty file"),
        ("encoders_csv", "t,l,r\n0,0,0\n", r"encoders.csv:1: header: expected time_s,left_counts.*got 't,l,r'"),
        ("encoders_csv", COUNTS.replace("500", "many"), r"encoders.csv:3: left_counts: .*finite number, got 'many'"),
        ("encoders_csv", COUNTS.replace("500", ""), r"encoders.csv:3: left_counts: .*finite number, got ''"),
        ("encoders_csv", COUNTS.replace("500", "inf"), r"encoders.csv:3: left_counts: .*finite number, got 'inf'"),
        (
            "encoders_csv",
            COUNTS.replace("500", "0.5"),
            r"encoders.csv:3: left_counts: .*whole number of counts, got 0.5",
        ),
        ("encoders_csv", COUNTS.replace("1,500", "1;500"), r"encoders.csv:3: .*expected 3 columns, got 2"),
        ("encoders_csv", COUNTS + "1,5,5\n", r"encoders.csv:4: time_s: expected a time after 1, got 1"),
        ("encoders_csv", COUNTS[:-11], r"encoders.csv: .*at least 2 rows of numbers, got 1"),
        ("fog_csv", "time_s,rate_rad_s\n0,0\n", r"fog.csv:1: header: expected time_s,rate_deg_s or "),
        ("fog_csv", "time_s,rate_deg_s\n0,1,2\n", r"fog.csv:2: .*expected 2 columns, got 3"),
        (
            "reference_csv",
            POSES.replace("1,1,0", "-1,1,0"),
            r"reference.csv:3: time_s: expected a time after 0, got -1",
        ),
    ],
)
def test_bad_input_names_file_line_and_column(tmp_path: Path, name: str, text: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        read_recording(folder(tmp_path, **{name: text}))


def test_a_folder_without_its_files_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected a recording folder, got nothing there"):
        read_recording(tmp_path / "none")
    with pytest.raises(ConfigError, match=r"robot.yaml: expected this file in the folder, got none"):
        read_recording(tmp_path)
    (folder(tmp_path) / "encoders.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"encoders.csv: .*expected a readable UTF-8 text file"):
        read_recording(tmp_path)


@pytest.mark.recordings
def test_every_shared_recording_is_read() -> None:
    folders = [file.parent for file in SHARED.glob("*/*/robot.yaml")]
    if not folders:
        pytest.skip("the shared recordings are not here")
    recordings = [read_recording(path) for path in folders]
    for recording in recordings:
        left_rad, right_rad = recording.wheel_angles_rad()
        assert len(left_rad) == len(right_rad) == len(recording.encoders.time_s)
        assert (recording.reference is not None) == (recording.folder / "reference.csv").exists()
    assert {recording.encoders.left_counts is None for recording in recordings} == {False, True}
