"""`drd explain` as it is used: folders and MCAP files, with and without reference, intervals, bad input."""

import json
import math
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_drive import drive, recordings
from replay_folders import STANDING, write_perfect

from drd.config.schema import ConfigError
from drd_tools.evaluate.trajectory import read_reference
from drd_tools.explain.analysis import explain
from drd_tools.explain.command import main
from drd_tools.explain.interval import Interval
from drd_tools.explain.results import Explanation
from drd_tools.explain.source import open_source
from drd_tools.explain.tap import tapped_track
from drd_tools.explain.text import fits, lead
from drd_tools.limit import causes
from drd_tools.limit.causes import GROUPS
from drd_tools.recordings.folder import read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.result import Replayed

SHARED = Path(__file__).resolve().parents[3].parent / "shared"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A perfect drive, and a robot.yaml whose wheels are 0.4 % too large, which no gyro can tell."""
    made = write_perfect(
        tmp_path_factory.mktemp("explain") / "drive", gyro=True, bias_deg_s=0.05, legs=(*STANDING[:8], (0.0, 0.0, 3.0))
    )
    robot = made / "robot.yaml"
    text = robot.read_text().replace("radius_m: 0.1,", "radius_m: 0.1004,")
    text = text.replace("position_sigma_m: 0.0001", "position_sigma_m: 0.002")
    robot.write_text(text.replace("heading_sigma_deg: 0.001", "heading_sigma_deg: 0.05"))
    assert "0.1004" in robot.read_text()
    assert "0.002" in robot.read_text()
    return made


def results(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "results.json").read_text())
    return content


def copy_without_reference(folder: Path, target: Path) -> Path:
    shutil.copytree(folder, target)
    (target / "reference.csv").unlink()
    return target


def test_the_cause_of_a_wrong_radius_is_named(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(folder), "--output", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    actual = results(tmp_path / "out")["actual"]
    parts = {part["group"]: part for part in actual["parts"]}
    total_m = sum(part["position_m"] for part in actual["parts"])
    assert total_m == pytest.approx(np.hypot(actual["along_m"], actual["across_m"]), rel=1e-3)
    assert sum(p["heading_deg"] for p in actual["parts"]) == pytest.approx(actual["heading_deg"], abs=1e-4)
    assert max(parts, key=lambda name: parts[name]["position_m"]) == "wheel scales"
    assert parts["wheel scales"]["position_m"] > 0.5 * total_m
    assert "within the budget" in told
    assert "Most likely, wheel scales caused" in told
    for name in ("report.html", "budget.png", "parts.png"):
        assert (tmp_path / "out" / name).stat().st_size > 10_000


def test_saved_results_are_drawn_again_alike(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(folder), "--from", "20", "--to", "40", "--output", str(tmp_path)]) == 0
    told, picture = capsys.readouterr().out, (tmp_path / "budget.png").read_bytes()
    (tmp_path / "budget.png").unlink()
    assert main(["--draw", str(tmp_path)]) == 0
    assert capsys.readouterr().out == told
    assert (tmp_path / "budget.png").read_bytes() == picture


def test_times_since_1970_do_not_matter(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "late")
    for file in (tmp_path / "late").glob("*.csv"):
        header, *rows = file.read_text().splitlines()
        late = (f"{float(t) + 1.7e9:.6f},{rest}" for t, _, rest in (row.partition(",") for row in rows))
        file.write_text("\n".join((header, *late)) + "\n")
    assert main([str(tmp_path / "late"), "--output", str(tmp_path / "out")]) == 0
    found = results(tmp_path / "out")
    assert len(set(found["time_s"])) == len(found["time_s"]) > 100
    assert (found["time_s"][0], found["time_s"][-1]) == (found["from_s"], found["to_s"])


def test_the_budget_is_the_published_covariance(folder: Path, tmp_path: Path) -> None:
    source = open_source(copy_without_reference(folder, tmp_path / "alone"), None, None, None)
    explanation = explain(source, None, None, None)
    pose = source.replay().poses[-1]
    xx, _, _, yy, _, hh = pose.covariance
    assert explanation.total.position_m == pytest.approx(np.sqrt(xx + yy), rel=0.02)  # a step earlier
    assert explanation.total.heading_deg == pytest.approx(np.degrees(np.sqrt(hh)), rel=0.02)
    assert explanation.actual is None
    for share in ("position_share", "heading_share"):
        assert sum(getattr(line, share) for line in explanation.groups) == pytest.approx(1.0)
        assert sum(getattr(line, share) for line in explanation.causes) == pytest.approx(1.0)
    assert np.sum(explanation.position_m2[-1]) == pytest.approx(explanation.total.position_m**2, rel=1e-4)


def test_the_budget_is_the_published_covariance_in_motion(tmp_path: Path) -> None:
    made = write_perfect(tmp_path / "drive", gyro=True, bias_deg_s=0.05, legs=STANDING[:8])
    (made / "reference.csv").unlink()
    source = open_source(made, None, None, None)
    hh = source.replay().poses[-1].covariance[5]
    found = explain(source, None, None, None).total.heading_deg
    assert found == pytest.approx(np.degrees(np.sqrt(hh)), rel=0.02)


def test_an_interval_begins_with_no_error_of_the_pose_and_what_was_learned(folder: Path, tmp_path: Path) -> None:
    source = open_source(copy_without_reference(folder, tmp_path / "alone"), None, None, None)
    explanation = explain(source, 30.0, 40.0, None)
    assert (explanation.from_s, explanation.to_s) == (30.0, 40.0)
    whole = explain(source, None, 40.0, None)
    first = dict(zip(GROUPS, explanation.heading_deg2[0], strict=True))
    assert first["latency"] > 0.0  # of the two poses' own times
    assert sum(first.values()) == pytest.approx(first["latency"], rel=1e-9)
    assert explanation.total.heading_deg > 0.0
    assert explanation.way_m < whole.way_m


def test_the_replay_is_not_changed_by_being_explained(folder: Path) -> None:
    recording = read_recording(folder)
    interval = Interval(0, None, None)
    replayed = replay_folder(recording, new_track=partial(tapped_track, interval))
    assert replayed.digest() == replay_folder(recording).digest()
    assert len(interval.table()) > len(replayed.poses)


def test_holes_in_both_sensors_are_mirrored(folder: Path, tmp_path: Path) -> None:
    """Blind intervals, headings that are copied, a bias after a silence: in the estimator's own hands."""
    holes = tmp_path / "holes"
    shutil.copytree(folder, holes)
    for name, gaps in (("fog.csv", [(20.0, 25.0), (34.0, 36.0)]), ("encoders.csv", [(30.0, 31.5), (35.0, 37.0)])):
        lines = (holes / name).read_text().splitlines()
        kept = [s for s in lines[1:] if not any(low < float(s.split(",")[0]) < high for low, high in gaps)]
        (holes / name).write_text("\n".join([lines[0], *kept]) + "\n")
    interval = Interval(0, None, None)
    replay_folder(read_recording(holes), new_track=partial(tapped_track, interval))
    assert interval.clock is not None
    P = interval.clock.kf.P
    sigma = np.sqrt(np.maximum(np.diag(P), 1e-30))  # a robot that does not skid has no sideways slip
    assert np.abs((interval.budget.P.sum(axis=0) - P) / np.outer(sigma, sigma)).max() < 1e-6
    for cause in (causes.NOT_SEEN, causes.BIAS_SILENCE):
        assert interval.budget.P[cause].max() > 0.0


def test_a_reference_of_start_and_end_alone(folder: Path, tmp_path: Path) -> None:
    sparse = tmp_path / "sparse"
    shutil.copytree(folder, sparse)
    lines = (sparse / "reference.csv").read_text().splitlines()
    (sparse / "reference.csv").write_text("\n".join([lines[0], lines[1], lines[-1]]) + "\n")
    whole, two = (
        explain(open_source(path, None, None, None), None, None, read_reference(path)).actual
        for path in (folder, sparse)
    )
    assert whole is not None
    assert two is not None
    assert two.poses == 1
    assert (two.along_m, two.across_m) == pytest.approx((whole.along_m, whole.across_m), abs=1e-3)
    assert two.heading_deg == pytest.approx(whole.heading_deg, abs=0.05)


def test_a_reference_that_does_not_say_how_good_it_is_is_used_at_the_end_only(folder: Path, tmp_path: Path) -> None:
    poses = tmp_path / "poses.csv"
    shutil.copy(folder / "reference.csv", poses)
    alone = copy_without_reference(folder, tmp_path / "alone")
    assert main([str(alone), "--reference", str(poses), "--output", str(tmp_path / "a")]) == 0
    assert results(tmp_path / "a")["actual"]["poses"] == 1
    source = open_source(alone, None, None, None)
    b, c = (explain(source, None, None, read_reference(path, 0.002, 0.05)).actual for path in (poses, folder))
    assert b is not None
    assert c is not None
    assert b.poses > 1
    assert b.parts == c.parts


@pytest.mark.parametrize(("lag_s", "replays"), [(0.0, 1), (0.1, 1), (math.nan, 2)])
def test_only_to_take_off_a_lag_that_has_to_be_found_first_it_replays_twice(
    folder: Path, lag_s: float, replays: int
) -> None:
    source, asked = open_source(folder, None, None, None), []

    def replay(**how: Any) -> Replayed:
        asked.append(how)
        return source.replay(**how)

    actual = explain(replace(source, replay=replay), None, None, read_reference(folder), lag_s).actual
    assert len(asked) == replays
    assert actual is not None
    assert (actual.lag_taken_s, actual.lag_left_s) == (0.1 if lag_s == 0.1 else 0.0, 0.0)


def test_an_error_beyond_the_budget_is_not_shared_out(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drifting = tmp_path / "drifting"
    shutil.copytree(folder, drifting)
    rows = np.loadtxt(drifting / "fog.csv", delimiter=",", skiprows=1)
    rows[(rows[:, 0] > 20.0) & (rows[:, 0] < 21.0), 1] += 60.0  # deg/s
    np.savetxt(drifting / "fog.csv", rows, "%.9g", ",", header="time_s,rate_deg_s", comments="")
    assert main([str(drifting)]) == 0
    told = capsys.readouterr().out
    assert "drd diagnose" in told
    assert "beyond the gate" in told
    assert "Most likely" not in told


def test_mcap_with_commands_and_a_lost_port(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = drive(tmp_path)
    made.start()
    made.run(20.0)
    made.recorder.close(5.0)
    file = recordings(tmp_path)[0]
    assert main([str(file), "--output", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "relative to the pose that was set at" in told
    assert len(told.split("from outside at ")[1].split(" s.")[0].split(", ")) == 2
    assert "repeated to the bit" in told
    found = results(tmp_path / "out")
    groups = {line["group"]: line for line in found["groups"]}
    assert groups["calibration"]["heading_deg"] > 0.0
    assert groups["gyro scale"]["heading_deg"] == 0.0  # with a calibration it is not estimated


def test_no_gyro(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(write_perfect(tmp_path / "drive", gyro=False)), "--output", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    nothing = "gyro noise, gyro bias, gyro scale, calibration, wheel lag, sideways slip, start pose"
    assert f"No contribution: {nothing}" in told
    assert "If the gyro were" not in told
    e = Explanation.load(tmp_path / "out")
    for line in (line for line in e.groups if line.position_m):
        groups = [replace(g, position_share=float(g is line), heading_share=float(g is line)) for g in e.groups]
        [advice] = [s for s in lead(replace(e, groups=groups)) if s.startswith("To reduce ")]
        assert advice.startswith(f"To reduce {line.group}: ")
        assert not {"gyro", "serial"} & set(re.findall(r"\w+", advice))


def test_a_robot_that_stands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_perfect(tmp_path / "drive", gyro=False, legs=((0.0, 0.0, 5.0),))
    assert main([str(folder), "--output", str(tmp_path / "out")]) == 0
    assert "The robot has not moved." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["--from", "40", "--to", "30"], "--from, --to"),
        (["--from", "5000"], "a time within"),
        (["--reference", "nowhere.csv"], "nowhere.csv"),
        (["--calibration", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_bad_input_is_refused_with_its_place(folder: Path, given: list[str], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        main([str(folder), *given])


@pytest.mark.parametrize(
    "given", [[], ["a", "--draw", "b"], ["x", "--from", "nan"], ["x", "--reference-sigma", "-1", "0"]]
)
def test_bad_usage(given: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(given)
    assert stopped.value.code == 2
    assert "usage: drd explain" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["", "[]", '{"format": "other"}', '{"format": "drd-explanation/1"}'])
def test_saved_results_that_are_none_are_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "results.json").write_text(content)
    with pytest.raises(ConfigError, match=r"results\.json"):
        main(["--draw", str(tmp_path)])


@pytest.mark.recordings
def test_a_trial_whose_cause_the_filter_estimates() -> None:
    """A tread that is 7 % wrong: the budget covers what the filter leaves of it."""
    folder = SHARED / "trials" / "case_016"
    if not folder.exists():
        pytest.skip("the shared recordings are not here")
    actual = explain(open_source(folder, None, None, None), None, 150.0, read_reference(folder)).actual
    assert actual is not None
    assert fits(actual)
