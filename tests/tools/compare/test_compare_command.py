"""`drd compare` as it is used."""

import io
import json
import shutil
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from replay_folders import STANDING, write_perfect

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd_tools.compare.analysis import compare
from drd_tools.compare.command import main
from drd_tools.compare.results import Comparison
from drd_tools.compare.text import lead, sentence
from drd_tools.recordings.folder import read_recording
from drd_tools.replay.nominal import with_model

SHARED = Path(__file__).resolve().parents[3].parent / "shared"
SLOPPY = {"position_sigma_m: 0.0001": "position_sigma_m: 0.002", "heading_sigma_deg: 0.001": "heading_sigma_deg: 0.05"}


def edit(folder: Path, changes: dict[str, str]) -> None:
    robot = folder / "robot.yaml"
    text = robot.read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    robot.write_text(text)


@pytest.fixture(scope="module")
def wide(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive with a standstill bias and noise in gyro and reference, but robot.yaml's tread is 2 % too large."""
    made = write_perfect(tmp_path_factory.mktemp("compare") / "wide", gyro=True, bias_deg_s=0.05, legs=STANDING)
    edit(made, {**SLOPPY, "tread_m: 0.5": "tread_m: 0.51"})
    rng = np.random.default_rng(1)
    shake(made / "reference.csv", lambda rows: rows + rng.standard_normal(rows.shape) * (0.0, 0.002, 0.002, 0.05))
    shake(made / "fog.csv", lambda rows: rows + rng.standard_normal(rows.shape) * (0.0, 0.005))
    return made


def shake(file: Path, change: Callable[[Array], Array]) -> None:
    header = file.read_text().splitlines()[0]
    rows = change(np.loadtxt(file, delimiter=",", skiprows=1))
    np.savetxt(file, rows, "%.6f", ",", header=header, comments="")


@pytest.fixture(scope="module")
def compared(wide: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder with results, and what was printed."""
    folder = tmp_path_factory.mktemp("compared")
    told = io.StringIO()
    with redirect_stdout(told):
        assert main([str(wide), "--output", str(folder)]) == 0
    return folder, told.getvalue()


def results(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "results.json").read_text())
    return content


def channels(folder: Path) -> dict[str, Any]:
    return {c["id"]: c for c in results(folder)["channels"]}


def test_a_wrong_tread_shows_as_a_turn_that_goes_with_the_yaw_rate(compared: tuple[Path, str]) -> None:
    folder, told = compared
    found = channels(folder)
    for name in ("wheels_turn", "wheels_gyro"):
        assert found[name]["named"][0] == "yaw rate"
        best = next(d for d in found[name]["drivers"] if d["name"] == "yaw rate")
        slope = np.polyfit(best["knots"], best["value"], 1)[0]
        assert slope == pytest.approx(0.5 / 0.51 - 1.0, rel=0.15)
        assert best["share"] > 0.8
    assert found["gyro"]["verdict"] == found["sideways"]["verdict"] == "nothing"
    assert found["gyro"]["end"] == pytest.approx(0.0, abs=0.1)  # the standstill's bias is off
    assert "the mismatch depends on yaw rate (cross-validated share" in told
    assert "Gyro: nothing beyond noise" in told
    for name in ("report.html", "overview.png", *(f"{channel}.png" for channel in found)):
        assert (folder / name).stat().st_size > 10_000


def test_what_no_covariate_explains_is_said_of_all_channels_at_once(compared: tuple[Path, str]) -> None:
    c = Comparison.load(compared[0])
    channels = [msgspec.structs.replace(ch, verdict="more", named=[], ratio=3.0) for ch in c.channels]
    told = "\n".join([*lead(replace(c, channels=channels)), *map(sentence, channels)])
    titles = ", ".join(ch.title for ch in channels)
    assert f"Beyond noise, but no covariate explains it significantly: {titles}." in told
    assert told.count("significantly") == 1
    channels = [msgspec.structs.replace(ch, covariates=[]) for ch in channels]
    assert f"Beyond noise, in too few blocks to identify a covariate: {titles}." in [
        *lead(replace(c, channels=channels))
    ]


@pytest.mark.parametrize("text", ["effects: [{effect: tread_error, parameters: {k: -0.0196078}}]", "tread_m: 0.5"])
def test_the_right_model_leaves_nothing(wide: Path, tmp_path: Path, text: str) -> None:
    model = tmp_path / "model.yaml"
    model.write_text(text)
    found = compare(with_model(read_recording(wide), model))
    assert {c.id: c.named for c in found.channels if c.verdict != "nothing"} == {}
    assert str(model) in found.sha256


def test_saved_results_are_drawn_again_alike(compared: tuple[Path, str], capsys: pytest.CaptureFixture[str]) -> None:
    folder, told = compared
    picture = (folder / "gyro.png").read_bytes()
    (folder / "gyro.png").unlink()
    assert main(["--draw", str(folder)]) == 0
    assert capsys.readouterr().out == told
    assert (folder / "gyro.png").read_bytes() == picture


def test_the_same_seed_repeats(wide: Path, compared: tuple[Path, str]) -> None:
    assert compare(read_recording(wide)) == Comparison.load(compared[0])


def test_without_a_reference_wheels_and_gyro_are_compared(wide: Path, tmp_path: Path) -> None:
    bare = shutil.copytree(wide, tmp_path / "bare")
    (bare / "reference.csv").unlink()
    found = compare(read_recording(bare))
    (channel,) = found.channels
    assert (channel.id, channel.named[0]) == ("wheels_gyro", "yaw rate")


def test_a_reference_at_start_and_end_still_tells_the_sums(wide: Path, tmp_path: Path) -> None:
    sparse = shutil.copytree(wide, tmp_path / "sparse")
    lines = (sparse / "reference.csv").read_text().splitlines()
    (sparse / "reference.csv").write_text("\n".join([lines[0], lines[1], lines[-1], ""]))
    found = {c.id: c for c in compare(read_recording(sparse)).channels}
    assert found["gyro"].verdict == "nothing"
    assert found["gyro"].end == pytest.approx(0.0, abs=5.0 * found["gyro"].end_sigma)


def test_without_a_gyro_the_rest_is_compared(wide: Path, tmp_path: Path) -> None:
    bare = shutil.copytree(wide, tmp_path / "bare")
    (bare / "fog.csv").unlink()
    edit(bare, {"fog: {rate_hz: 10, range_deg_s: 100}": "fog: null"})
    found = {c.id: c for c in compare(read_recording(bare)).channels}
    assert set(found) == {"wheels_turn", "distance", "left", "right", "sideways"}
    assert found["wheels_turn"].named[0] == "yaw rate"


def test_a_short_recording_says_that_it_is_too_short(tmp_path: Path) -> None:
    folder = write_perfect(tmp_path / "short", gyro=True, legs=((0.0, 0.0, 5.0), (0.5, 0.3, 12.0)))
    found = compare(read_recording(folder))
    assert any("too few" in note for note in found.notes)
    assert all(not c.named for c in found.channels)


def test_bad_input_is_refused(wide: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bare = shutil.copytree(wide, tmp_path / "bare")
    for name in ("fog.csv", "reference.csv"):
        (bare / name).unlink()
    with pytest.raises(ConfigError, match="wheels alone"):
        main([str(bare), "--output", str(tmp_path / "out")])
    with pytest.raises(ConfigError, match="a readable MCAP file"):
        main([str(tmp_path / "run.mcap"), "--output", str(tmp_path / "out")])
    with pytest.raises(ConfigError, match=r"an earlier `drd compare`"):
        main(["--draw", str(tmp_path / "nothing")])
    (tmp_path / "results.json").write_text('{"format": "drd-comparison/1", "channels": []}')
    with pytest.raises(ConfigError, match="recording: expected a value"):
        main(["--draw", str(tmp_path)])
    for arguments in ([], [str(wide)], [str(wide), "--draw", "x"], ["--draw", "x", "--model", "y"]):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 2
    capsys.readouterr()
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="a folder to write to"):
        main([str(wide), "--output", str(tmp_path / "file")])


@pytest.mark.recordings
@pytest.mark.skipif(not (SHARED / "trials").is_dir(), reason="no shared trials")
def test_a_trial_in_which_nothing_is_missing_shows_nothing() -> None:
    found = compare(read_recording(SHARED / "trials" / "case_034"))
    assert {c.id: c.named for c in found.channels if c.verdict != "nothing"} == {}
