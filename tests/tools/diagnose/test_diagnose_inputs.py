"""`drd diagnose` on all kinds of recordings: without gyro, without counts, with a poor reference or none."""

import json
from pathlib import Path

import pytest
from diagnosis_drives import SLALOM, recorded, selected, simulated
from diagnosis_runs import NO_GYRO, SCALE, SPEEDS, TREAD, diagnosed, names, written

from drd.cli import main
from drd_tools.diagnose.analysis import analyse
from drd_tools.simulate.conditions import Conditions, Reference


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_dropout_is_told_with_its_side(tmp_path: Path, side: str) -> None:
    missing = selected("encoder_dropout", side=side, t0=41.0, t1=42.0)
    finding = diagnosed(written(tmp_path / "run", missing), tmp_path / "out")["findings"][0]
    assert finding["effect"] == "encoder_dropout"
    assert side in json.dumps(finding["parameters"]["side"])
    assert finding["windows"] == [[pytest.approx(41.0, abs=0.06), pytest.approx(42.0, abs=0.06)]]


def test_speeds_do_instead_of_counts(tmp_path: Path) -> None:
    assert names(diagnosed(written(tmp_path / "run", SCALE, nominal=SPEEDS), tmp_path / "out")) == ["gyro_scale_error"]


@pytest.mark.parametrize("reference", ["sparse:60", "ends", "none"])
def test_a_poor_reference_is_no_reason_to_find_something(reference: str) -> None:
    poor = Conditions(reference=Reference.parse(reference))
    assert analyse(recorded(SLALOM, 1, conditions=poor)).conclusion.causes == []


@pytest.mark.parametrize("reference", ["sparse:60", "none"])
def test_gyro_and_wheels_alone_show_a_wrong_tread(tmp_path: Path, reference: str) -> None:
    found = diagnosed(written(tmp_path / "run", TREAD, reference=reference), tmp_path / "out")
    finding = found["findings"][0]
    assert "tread_error" in (finding["effect"], *finding["also_fits"])


@pytest.mark.parametrize("reference", ["sparse:20", "ends"])
def test_without_a_gyro_nothing_is_said_of_a_gyro(tmp_path: Path, reference: str) -> None:
    found = diagnosed(written(tmp_path / "run", TREAD, reference=reference, nominal=NO_GYRO), tmp_path / "out")
    assert not any(name.startswith("gyro") for name in (*names(found), *found["detectable"]))


def test_without_a_gyro_a_full_reference_is_no_reason_to_find_something() -> None:
    assert analyse(simulated(SLALOM, 1, nominal=NO_GYRO).recording).conclusion.causes == []


def test_wheels_alone_are_refused_with_a_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = written(tmp_path / "run", nominal=NO_GYRO, reference="none")
    assert main(["diagnose", str(recording), "--output", str(tmp_path / "out")]) == 2
    assert "wheels alone" in capsys.readouterr().err


def test_a_robot_that_stands_still_is_no_error(tmp_path: Path) -> None:
    assert names(diagnosed(written(tmp_path / "run", drive=("stand", 60.0)), tmp_path / "out")) == []
