"""`drd evaluate` as a user runs it: what it prints, what it writes, and its errors."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pose_files import dead_reckoned, drive, write_poses
from wheel_recordings import TOUR, Truth, write_drive

from drd.cli import main
from drd_tools.evaluate.results import Evaluation
from drd_tools.report.saved import FILE

PNG = b"\x89PNG"


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    try:
        code = main(["evaluate", *map(str, arguments)])
    except SystemExit as left:
        code = int(left.code or 0)
    out, err = capsys.readouterr()
    return code, " ".join(out.split()), " ".join(err.split())


def files(tmp_path: Path, seed: int = 1) -> tuple[Path, Path]:
    estimate, reference = dead_reckoned(np.random.default_rng(seed), rows=400)
    poses = write_poses(tmp_path / f"poses{seed}.csv", estimate.time_s, estimate.pose, estimate.covariance)
    return poses, write_poses(tmp_path / f"reference{seed}.csv", reference.time_s, reference.pose)


def test_poses_give_figures_files_and_the_same_again_later(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses, reference = files(tmp_path)
    output = tmp_path / "out/one"
    code, out, _ = run(capsys, poses, "--reference", reference, "--reference-sigma", 0.01, 0.2, "--output", output)
    assert code == 0
    for words in ("Alignment: start", "Error at the end", "Return position error: none", "Drift (KITTI)", "NEES"):
        assert words in out
    assert "No temperature: reference1 has no fog.csv" in out
    saved = json.loads((output / FILE).read_text())
    assert saved["format"] == "drd-evaluation/1"
    names = {"results.json", "report.html", "path.png", "error.png", "drivers.png"}
    assert {file.name for file in output.iterdir()} == names
    pictures = {name: (output / name).read_bytes() for name in names if name.endswith("png")}
    assert all(content.startswith(PNG) for content in pictures.values())
    assert (output / "report.html").read_text().count("data:image/png") == 3
    for name in names - {FILE}:
        (output / name).unlink()
    code, again, _ = run(capsys, "--draw", output)
    assert (code, again) == (0, out)
    assert {name: (output / name).read_bytes() for name in pictures} == pictures


def test_results_survive_saving(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses, reference = files(tmp_path)
    assert run(capsys, poses, "--reference", reference, "--output", tmp_path)[0] == 0
    first = Evaluation.load(tmp_path)
    first.save(tmp_path)
    second = Evaluation.load(tmp_path)
    assert first.runs[0].end == second.runs[0].end
    assert np.array_equal(first.runs[0].series.error, second.runs[0].series.error)
    assert first.runs[0].series.sigma is not None
    assert first.runs[0].windows.temperature_c is None


def test_times_since_1970_and_utm_coordinates_survive_saving(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reference = drive()
    time_s, pose = reference.time_s + 1.7e9, reference.pose + np.array([4e5, 5e6, 0.0])
    poses = write_poses(tmp_path / "poses.csv", time_s, pose)
    assert run(capsys, poses, "--reference", poses, "--output", tmp_path / "out")[0] == 0
    series = Evaluation.load(tmp_path / "out").runs[0].series
    assert np.abs(series.time_s - time_s).max() < 1e-4
    assert np.abs(series.reference_m - pose[:, :2]).max() < 1e-4
    early = write_poses(tmp_path / "early.csv", reference.time_s, reference.pose)
    _, _, err = run(capsys, early, "--reference", poses, "--output", tmp_path / "out")
    assert "(poses 0 to 120 s, reference 1700000000 to 1700000120 s)" in err


def test_several_poses_and_a_comparison(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pairs = [files(tmp_path, seed) for seed in (1, 2)]
    poses, references = zip(*pairs, strict=True)
    code, out, _ = run(capsys, *poses, "--reference", *references, "--output", tmp_path / "a")
    assert code == 0
    assert "2 runs, alignment start" in out
    assert "all runs together" in out
    assert run(capsys, *poses, "--reference", *references, "--align", "se2", "--output", tmp_path / "b")[0] == 0
    code, out, _ = run(capsys, "--compare", tmp_path / "a", tmp_path / "b", "--output", tmp_path / "both")
    assert code == 0
    assert "2 of 2 references were used by more than one run." in out
    assert "alignments differ (se2, start)" in out
    assert "Medians" in out
    assert len(list((tmp_path / "both").glob("*_compare_*.png"))) == 4
    assert (tmp_path / "both/compare.html").read_text().count("data:image/png") == 4


def test_a_comparison_says_where_it_is_not_like_with_like(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses, reference = files(tmp_path)
    ways = {
        "short": ("--align", "first-metres", 3),
        "long": ("--align", "first-metres", 30),
        "late": ("--align", "first-metres", 3, "--reference-lag", 0.3),
        "unsure": ("--align", "first-metres", 3, "--reference-sigma", 0.5, 5),
    }
    for name, options in ways.items():
        assert run(capsys, poses, "--reference", reference, *options, "--output", tmp_path / name)[0] == 0
    said = {
        "long": "alignments differ (first-metres 3, first-metres 30)",
        "late": "the reference's times were taken 0.00 to 0.30 s earlier",
        "unsure": "the reference's standard deviations differ",
    }
    for name in said:
        _, out, _ = run(capsys, "--compare", tmp_path / "short", tmp_path / name, "--output", tmp_path / "both")
        assert [other for other, text in said.items() if text in out] == [name]


def test_a_recording_is_replayed_with_its_nominal_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_drive(tmp_path / "tour", TOUR, Truth(left=1.01, right=1.01), 1)
    assert run(capsys, folder, "--output", tmp_path / "out")[0] == 0
    found = Evaluation.load(tmp_path / "out").runs[0]
    assert found.name == found.reference == "tour"
    assert found.drift is not None
    assert found.drift.percent == pytest.approx(1.0, abs=0.3)  # wheels 1 % larger than robot.yaml says
    assert found.series.sigma is not None


def test_what_a_sparse_reference_cannot_show_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses, _ = files(tmp_path)
    truth = drive(40.0)
    ends = replace(truth, time_s=truth.time_s[[0, -1]], pose=truth.pose[[0, -1]])
    reference = write_poses(tmp_path / "ends.csv", ends.time_s, ends.pose)
    code, out, _ = run(capsys, poses, "--reference", reference, "--output", tmp_path / "out")
    assert code == 0
    assert "Drift (KITTI): not determined; no segment has both ends near rows" in out
    assert "2 rows do not determine its uncertainty" in out
    assert "rate and speed: not determined: the reference is sparse" in out
    assert not (tmp_path / "out/drivers.png").exists()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("x_m", "x"), "poses1.csv:1: header: expected time_s,x_m,y_m,heading_deg"),
        (("\n0.1,", "\nnan,"), "poses1.csv:3: time_s: expected a finite number, got 'nan'"),
        (("\n0.1,", "\n0.3,"), "poses1.csv:4: time_s: expected a time after 0.3"),
    ],
)
def test_bad_poses(tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], expected: str) -> None:
    poses, reference = files(tmp_path)
    poses.write_text(poses.read_text().replace(*change, 1))
    code, _, err = run(capsys, poses, "--reference", reference, "--output", tmp_path / "out")
    assert code == 2
    assert expected in err
    assert not (tmp_path / "out").exists()


def test_a_covariance_that_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses, reference = files(tmp_path)
    lines = poses.read_text().splitlines()
    cells = lines[5].split(",")
    cells[4] = "-1"
    poses.write_text("\n".join([*lines[:5], ",".join(cells), *lines[6:]]) + "\n")
    code, _, err = run(capsys, poses, "--reference", reference, "--output", tmp_path / "out")
    assert code == 2
    assert re.search(r"poses1.csv:6: xx_m2 to hh_rad2: expected a covariance, got", err)


def test_bad_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses, reference = files(tmp_path)
    output = ("--output", tmp_path / "out")
    cases: list[tuple[tuple[object, ...], str]] = [
        (output, "give POSES.csv or RECORDING"),
        ((poses, "--reference", reference), "one of the arguments --output --draw is required"),
        ((poses, *output), "poses need --reference"),
        ((poses, poses, poses, "--reference", reference, reference, *output), "one for each of 3 inputs, got 2"),
        ((poses, "--reference", reference, "--align", "sim3", *output), "--align: expected none, start"),
        ((poses, "--reference", reference, "--align", "first-metres", *output), "--align: expected none, start"),
        ((poses, "--reference", reference, "--align", "first-metres", "-1", *output), "--align"),
        ((poses, "--reference", reference, "--max-gap", "0", *output), "--max-gap"),
        ((poses, "--reference", tmp_path / "none.csv", *output), "none.csv"),
        (("--draw", tmp_path), "results of an earlier `drd evaluate`"),
        (("--compare", tmp_path, tmp_path, *output), "different folders"),
    ]
    for arguments, expected in cases:
        code, _, err = run(capsys, *arguments)
        assert code == 2, arguments
        assert expected in err


def test_results_of_another_kind_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for text, place in (
        ("", f"{FILE}: expected JSON"),
        ("[]", f"{FILE}: format: expected drd-evaluation/1"),
        ('{"format": "drd-paper/1"}', f"{FILE}: format: expected drd-evaluation/1"),
        ('{"format": "drd-evaluation/1", "runs": [{}]}', f"{FILE}: runs[0]."),
    ):
        (tmp_path / FILE).write_text(text)
        code, _, err = run(capsys, "--draw", tmp_path)
        assert code == 2
        assert place in err
