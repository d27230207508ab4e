"""Long recordings are looked at in parts, and what they say is put together."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import recorded, selected
from diagnosis_runs import diagnosed, written

from drd.cli import main
from drd.effects.catalogue import catalogue
from drd.effects.model import Amount, Term
from drd_tools.diagnose.files import load
from drd_tools.diagnose.observe import parts as parts_module
from drd_tools.diagnose.observe.parts import parts
from drd_tools.recordings.folder import Recording
from drd_tools.replay.folder_source import replay_folder

SCALE = selected("gyro_scale_error", k=0.01)
DRIVE = ("warehouse", 180.0)


@pytest.fixture
def ninety_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """The longest part, in place of 20 minutes."""
    monkeypatch.setattr(parts_module, "MOST_STEPS", 920)


def long() -> Recording:
    return recorded(DRIVE, 3, SCALE)


def test_twenty_minutes_are_one_part() -> None:
    recording = long()
    assert parts(recording) == [recording]


@pytest.mark.usefixtures("ninety_seconds")
def test_parts_have_each_row_once_and_their_times() -> None:
    recording = long()
    made = parts(recording)
    assert len(made) == 2
    assert len({part.name for part in made}) == 2
    for name in ("fog", "wheels", "reference"):
        times = np.concatenate([getattr(part, name).time_s for part in made])
        assert np.array_equal(times, getattr(recording, name).time_s)
    assert [part.nominal.standstill_at_start_s > 0.0 for part in made] == [True, False]
    counts = [part.encoders.left_counts for part in made]
    assert counts[0] is not None
    assert counts[1] is not None
    assert counts[1][0] >= counts[0][-1]


@pytest.mark.usefixtures("ninety_seconds")
def test_a_part_without_a_fix_has_no_reference_and_one_without_rows_is_left_out() -> None:
    recording = long()
    log, fog = recording.reference, recording.fog
    assert log is not None
    assert fog is not None
    early = log.time_s < 60.0
    few = replace(
        log, time_s=log.time_s[early], x_m=log.x_m[early], y_m=log.y_m[early], heading_rad=log.heading_rad[early]
    )
    first, second = parts(replace(recording, reference=few))
    assert first.reference is not None
    assert second.reference is None
    kept = np.flatnonzero((fog.time_s < 80.0) | (fog.time_s > fog.time_s[-1] - 1.0))
    assert fog.temperature_c is not None
    holed = replace(
        fog, time_s=fog.time_s[kept], rate_rad_s=fog.rate_rad_s[kept], temperature_c=fog.temperature_c[kept]
    )
    assert len(parts(replace(recording, fog=holed))) == 1


@pytest.mark.usefixtures("ninety_seconds")
def test_the_whole_is_put_together(tmp_path: Path) -> None:
    written(tmp_path / "run", SCALE, reference="full", drive=DRIVE, seed=3)
    assert main(["diagnose", str(tmp_path / "run"), "--output", str(tmp_path / "out")]) == 0
    whole = json.loads((tmp_path / "out/diagnosis.json").read_text())
    assert whole["recording"] == "run"
    assert "gyro_scale_error" in {n for f in whole["findings"] for n in (f["effect"], *f["also_fits"])}
    assert "cut" not in whole
    each = [json.loads(f.read_text()) for f in sorted((tmp_path / "out").glob("*/diagnosis.json"))]
    assert len(each) == 2
    assert (tmp_path / "out/report.html").exists()


@pytest.mark.usefixtures("ninety_seconds")
def test_the_whole_is_drawn_with_the_model_of_all_parts(tmp_path: Path) -> None:
    written(tmp_path / "run", SCALE, reference="full", drive=DRIVE, seed=3)
    assert main(["diagnose", str(tmp_path / "run"), "--output", str(tmp_path / "out"), "--jobs", "1"]) == 0
    result, series = load(tmp_path / "out")
    assert "gyro_scale_error" in {f.effect for f in result.findings}
    after = result.fit.train.after
    assert result.unexplained.end_error_m == max(after[f"{d.name}: end_error_m"] or 0.0 for d in series.recordings)
    for drive in series.recordings:
        assert drive.path.corrected is not None
        assert drive.path.corrected.x_m[-1] != drive.path.nominal.x_m[-1]


def test_times_since_1970_are_counted_from_the_first_row(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As a replay with the model counts them, which takes the slip off; its moment is none of the file's own clock."""
    folder = written(tmp_path / "run", selected("surface_slip", t0=50.0, t1=60.0, left=0.2, right=0.0))
    for name in ("fog", "encoders", "reference"):
        header, *rows = (folder / f"{name}.csv").read_text().splitlines()
        cells = [row.split(",", 1) for row in rows]
        later = [f"{float(time_s) + 1.7e9:.6f},{rest}" for time_s, rest in cells]
        (folder / f"{name}.csv").write_text("\n".join([header, *later]) + "\n")
    diagnosis = diagnosed(folder, tmp_path / "out")
    (slip,) = diagnosis["findings"]
    assert slip["effect"] == "surface_slip"
    first_s = float(cells[0][0])
    assert slip["parameters"]["t0"]["value"] == pytest.approx(50.0, abs=1.0 + first_s)
    assert "times count from its first row, at 1700000000 s" in capsys.readouterr().out
    rejected = []
    for model in ([], ["--model", str(tmp_path / "out" / "model.yaml")]):
        assert main(["replay", str(folder), *model, "--output", str(tmp_path / "poses.csv")]) == 0
        rejected.append(json.loads((tmp_path / "poses.json").read_text())["counters"]["estimator"].get("rejected", 0))
    assert rejected[1] < 0.2 * rejected[0]


@pytest.mark.usefixtures("ninety_seconds")
def test_a_moment_in_a_later_part_counts_as_in_the_whole() -> None:
    recording = recorded(DRIVE, 3, selected("gyro_bias_step", b=0.02, t0=130.0))
    _, second = parts(recording)
    step = Term(catalogue()["gyro_bias_step"], {"b": Amount(np.degrees(0.02)), "t0": Amount(130.0)})
    ends_rad = {}
    for terms in ((), (step,)):
        poses = replay_folder(replace(second, terms=terms)).poses
        ends_rad[len(terms)] = abs(poses[-1].heading_rad - poses[0].heading_rad)
    reference = second.reference
    assert reference is not None
    turned = abs(reference.heading_rad[-1] - reference.heading_rad[0])
    assert abs(ends_rad[1] - turned) < 0.2 * abs(ends_rad[0] - turned)
