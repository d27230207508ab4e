"""Drawn cases, diagnosed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drd.effects.catalogue import catalogue
from drd_tools.diagnose.evidence import gather
from drd_tools.diagnose.problem import Problem
from drd_tools.simulate.conditions import Conditions
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth
from drd_tools.trial.__main__ import RESULTS, main
from drd_tools.trial.draw import Drawing, drawings, make, reversible
from drd_tools.trial.size import sized, visibility

SHORT = (1.5, 1.6)


def test_each_kind_is_drawn_and_patterns_choose() -> None:
    names = [d.name for d in drawings(2, 0, SHORT)]
    assert len(set(names)) == len(names) == 2 * (2 + 2 * len(reversible()) + 1)
    assert "gyro_saturation" not in reversible()
    chosen = [d.name for d in drawings(2, 0, SHORT, only=("null-plain-*", "gyro_lag-d25-001"))]
    assert chosen == ["null-plain-000", "null-plain-001", "gyro_lag-d25-001"]


def test_a_case_depends_on_its_name_and_seed_only() -> None:
    one, again, other, later = (
        make(Drawing(name, "null", (), 0.0, seed, SHORT)).simulated.recording
        for name, seed in (("a", 1), ("a", 1), ("b", 1), ("a", 2))
    )
    assert one.fog is not None
    assert again.fog is not None
    np.testing.assert_array_equal(one.fog.rate_rad_s, again.fog.rate_rad_s)
    for unlike in (other, later):
        assert unlike.fog is not None
        assert not np.array_equal(one.fog.rate_rad_s, unlike.fog.rate_rad_s)


def test_a_stressed_null_has_a_reference_that_is_askew() -> None:
    drawing = Drawing("null-stressed-000", "null stressed", (), 0.0, 5, SHORT)
    case = make(drawing)
    drive, stress = case.answer["drive"], case.answer["stress"]
    truth = make_truth(make_drive(drive["mission"], drive["seconds"], DEFAULT.standstill_at_start_s))
    reference = case.simulated.recording.reference
    assert reference is not None
    yaw_deg = np.degrees(np.mean(reference.heading_rad - np.interp(reference.time_s, truth.time_s, truth.heading_rad)))
    # Noise of 0.15 deg over 900 poses, and at most 5 ms late.
    assert yaw_deg == pytest.approx(stress["yaw_deg"], abs=0.15)
    assert 0.7 <= stress["gyro_noise"] <= 1.3
    assert 0.0 <= stress["latency_s"] <= 0.005
    assert case.answer["effects"] == []


@pytest.mark.parametrize("name", ["gyro_scale_error", "wheel_radius_error", "gyro_lag", "gyro_sample_clock"])
@pytest.mark.parametrize("d", [12.0, 25.0])
def test_a_drawn_effect_is_as_visible_as_asked_for(name: str, d: float) -> None:
    null = simulate(make_truth(make_drive("warehouse", 120.0)), DEFAULT, (), Conditions(), 3)
    problem, effect = Problem(gather(null.recording)), catalogue()[name]
    values = sized(problem, null.motion, effect, d, np.random.default_rng(0))
    assert values is not None
    assert visibility(problem, effect, values) == pytest.approx(d, rel=0.03)


def test_what_a_drive_cannot_show_is_not_made_up() -> None:
    null = simulate(make_truth(make_drive("stand", 60.0)), DEFAULT, (), Conditions(), 3)
    effect = catalogue()["tread_error"]
    assert sized(Problem(gather(null.recording)), null.motion, effect, 25.0, np.random.default_rng(0)) is None


def test_a_null_and_an_effect_from_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    only = ["null-plain-000", "gyro_scale_error-d25-000"]
    arguments = ["--simulated", "1", "--seed", "1", "--minutes", "1.5", "1.6", "--jobs", "1", "--output", str(out)]
    assert main([*arguments, "--only", *only]) == 0
    printed = capsys.readouterr().out
    records = json.loads((out / RESULTS).read_text())["records"]
    assert [r["case"] for r in records] == only
    truth = records[1]["effects"][0]
    assert truth["effect"] == "gyro_scale_error"
    assert truth["visibility"] == pytest.approx(25.0, rel=0.03)
    assert {"rival", "margin_nats", "separable"} <= truth.keys()
    assert records[1]["verdict"] != "nothing_missing"
    assert "single d=25" in printed
    assert main(["--draw", str(out)]) == 0
    assert capsys.readouterr().out.strip() in printed


def test_a_folder_with_answers(tmp_path: Path) -> None:
    from drd_tools.simulate.files import write_folder  # noqa: PLC0415

    truth = make_truth(make_drive("warehouse", 90.0))
    null = simulate(truth, DEFAULT, (), replace(Conditions(), gyro_noise=1.0), 3)
    write_folder(null, tmp_path / "case_1", {"mission": "warehouse", "temperature": "warmup"})
    answers = [{"case": "case_1", "kind": "null", "effects": []}]
    (tmp_path / "answers.json").write_text(json.dumps(answers))
    assert main(["--folder", str(tmp_path), "--jobs", "1", "--output", str(tmp_path / "out")]) == 0
    records = json.loads((tmp_path / "out" / RESULTS).read_text())["records"]
    assert [(r["case"], r["kind"]) for r in records] == [("case_1", "given null")]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--folder", "nowhere"], "answers.json"),
        (["--simulated", "1", "--only", "no-such-*"], "--only"),
        (["--simulated", "1", "--minutes", "5", "4"], "--minutes"),
        (["--simulated", "1", "--reference", "often"], "--reference"),
    ],
)
def test_bad_input_is_one_clear_error(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments, "--output", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
