"""Drawn cases, diagnosed."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trial_records import record

from drd.cli import main
from drd.config.schema import ConfigError
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.simulate.conditions import Conditions
from drd_tools.simulate.files import write_folder
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth
from drd_tools.trial.draw import make
from drd_tools.trial.figures import Figures
from drd_tools.trial.page import BEGIN, END, quote
from drd_tools.trial.plan import NONE, Drawing, Plan, drawings, events, reversible
from drd_tools.trial.results import RESULTS, Head, NotMade, Run, Store, Stress
from drd_tools.trial.size import Whitener
from drd_tools.trial.unknown import HIDDEN

SHORT = (1.5, 1.6)
# As a trial wrote them before its results had classes.
OLD_RESULTS = """\
{"format": "drd-trial/2", "seed": 3, "minutes": [1.0, 2.0], "reference": "full", "folder": null, "baselines": [], \
"build": "0123456789abcdef"}
{"case": "any-none-000", "kind": "single none", "effects": [{"effect": "wheel_eccentricity", "parameters": {"side": \
"left", "e": 0.001, "phase": 1.5}, "visibility": 20.0, "rival": "", "margin_nats": 150.5, "separable": true}], \
"drive": {"mission": "slalom", "temperature": "cycle", "seconds": 90.0, "seed": 7, "friction": 0.9}, \
"verdict": "explained", "findings": [{"effect": "wheel_eccentricity", "status": "confirmed", "also_fits": [], \
"acts_on": "wheels", "parameters": {"side": "left", "e": {"value": 0.0011, "std": 0.0001, "unit": "1"}, "phase": \
{"value": 1.4, "std": null, "unit": "rad"}}, "windows": [[0.1, 90.0]], "seen": {}, "driver": "wheel_phase", \
"evidence": {"gain_nats": 170.0, "family_wise_p": 0.001, "e_value": 1e20}, "explains": 0.9, "stand_in": null, \
"sentence": "It is."}], "noise": {"slip": 1.1}, "took_s": 2.5, "baselines": {}, "held_out": {"rows": 900, "residual": \
{"before": 1300.0, "after": 901.0, "oracle": 900.0}, "path_m": {"before": 0.5, "after": 0.1, "oracle": 0.1}}}
{"case": "gyro_lag-d8-000", "kind": "single d=8", "not_made": "gyro_lag-d8-000: none of 30 drives"}
"""


def records(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / RESULTS).read_text().splitlines()[1:]]


def test_each_kind_is_drawn_and_patterns_choose() -> None:
    names = [d.name for d in drawings(Plan(*[2] * len(NONE)), 0, SHORT)]
    effects = 3 * len(reversible()) + len(events())
    assert len(set(names)) == len(names) == 2 * (2 + effects + 2 + len(HIDDEN) + 3 * 2 + 2)
    assert set(reversible()) | set(events()) == {e.id for e in catalogue().values() if e.is_diagnosed}
    chosen = [d.name for d in drawings(Plan(nulls=2, singles=1), 0, SHORT, only=("null-plain-*", "gyro_lag-d12-*"))]
    assert chosen == ["null-plain-000", "gyro_lag-d12-000", "null-plain-001"]


def test_a_case_depends_on_its_name_and_seed_only() -> None:
    one, again, other, later = (
        make(Drawing(name, "null", (), 0.0, seed, SHORT)).recording
        for name, seed in (("a", 1), ("a", 1), ("b", 1), ("a", 2))
    )
    assert one.fog is not None
    assert again.fog is not None
    np.testing.assert_array_equal(one.fog.rate_rad_s, again.fog.rate_rad_s)
    for unlike in (other, later):
        assert unlike.fog is not None
        assert not np.array_equal(one.fog.rate_rad_s, unlike.fog.rate_rad_s)


def test_a_stressed_null_has_a_reference_that_is_askew() -> None:
    case = make(Drawing("null-stressed-000", "null stressed", (), 0.0, 5, SHORT))
    drive, stress = case.answer.drive, case.answer.stress
    assert isinstance(drive, Run)
    assert isinstance(stress, Stress)
    truth = make_truth(make_drive(drive.mission, drive.seconds, DEFAULT.standstill_at_start_s))
    reference = case.recording.reference
    assert reference is not None
    yaw_deg = np.degrees(np.mean(reference.heading_rad - np.interp(reference.time_s, truth.time_s, truth.heading_rad)))
    # Noise of 0.15 deg over 900 poses, and at most 5 ms late.
    assert yaw_deg == pytest.approx(stress.yaw_deg, abs=0.15)
    assert 0.7 <= stress.gyro_noise <= 1.3
    assert 0.0 <= stress.latency_s <= 0.005
    assert case.answer.effects == []


@pytest.mark.parametrize("name", ["gyro_scale_error", "wheel_radius_error", "gyro_lag", "gyro_sample_clock"])
@pytest.mark.parametrize("d", [12.0, 20.0])
def test_a_drawn_effect_has_the_detectability_asked_for(name: str, d: float) -> None:
    null = simulate(make_truth(make_drive("warehouse", 120.0)), DEFAULT, (), Conditions(), 3)
    whitener, effect = Whitener(Problem(gather(null.recording)), null.motion), catalogue()[name]
    values = whitener.sized(effect, d, np.random.default_rng(0))
    assert values is not None
    assert whitener.detectability(effect, values) == pytest.approx(d, rel=0.03)


def test_what_a_drive_cannot_show_is_not_made_up() -> None:
    null = simulate(make_truth(make_drive("stand", 60.0)), DEFAULT, (), Conditions(), 3)
    effect = catalogue()["tread_error"]
    whitener = Whitener(Problem(gather(null.recording)), null.motion)
    assert whitener.sized(effect, 25.0, np.random.default_rng(0)) is None


@pytest.mark.parametrize(("reference", "poses"), [("sparse:60", 2), ("ends", 2), ("none", 0)])
def test_another_reference_shows_some_effect_and_the_other_drive_has_a_full_one(reference: str, poses: int) -> None:
    case = make(Drawing("any", "single", (), 20.0, 4, SHORT, reference))
    assert len(case.answer.effects) == 1
    log = case.recording.reference
    assert (0 if log is None else len(log.time_s)) == poses
    other = case.again().reference
    assert other is not None
    assert len(other.time_s) > 800


def test_a_null_and_an_effect_from_the_command_and_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    arguments = ["trial", "--each", "1", "--seed", "1", "--minutes", "1.5", "1.6", "--jobs", "1", "--no-baselines"]
    arguments += ["--output", str(out), "--only", "null-plain-000"]
    assert main(arguments) == 0
    assert main([*arguments, "gyro_scale_error-d20-000"]) == 0
    captured = capsys.readouterr()
    null, single = records(out)
    assert [null["case"], single["case"]] == ["null-plain-000", "gyro_scale_error-d20-000"]
    assert "1 cases are there already, 1 are to do" in captured.err
    (truth,) = single["effects"]
    assert truth["effect"] == "gyro_scale_error"
    assert truth["visibility"] == pytest.approx(20.0, rel=0.03)
    assert {"rival", "margin_nats", "separable"} <= truth.keys()
    assert single["verdict"] != "nothing_missing"
    residual = single["held_out"]["residual"]
    assert residual["oracle"] < residual["before"]
    assert "single d=20" in captured.out
    assert (out / "trial.html").read_text().count("data:image/png") == 1
    assert "| single d=20: the right name first | 1 |" in (out / "figures.md").read_text()
    assert main(["trial", "--draw", str(out)]) == 0
    assert capsys.readouterr().out in captured.out
    readme = tmp_path / "README.md"
    readme.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    for _ in range(2):
        assert main(["trial", "--draw", str(out), "--quote", str(readme)]) == 0
    lines = readme.read_text().splitlines()
    assert [line for line in ("before", BEGIN, END, "after") if line in lines] == ["before", BEGIN, END, "after"]
    assert "old" not in lines
    assert sum("| nothing is missing, something is reported | 1 |" in line for line in lines) == 1


def test_a_file_without_marks_is_not_written(tmp_path: Path) -> None:
    plain = tmp_path / "plain.md"
    plain.write_text("text\n")
    with pytest.raises(ConfigError, match="marks"):
        quote(Figures([record("nothing_missing", [], kind="null")]), Head(seed=1), plain)
    assert plain.read_text() == "text\n"


def test_other_cases_are_not_mixed_and_another_build_begins_again(tmp_path: Path) -> None:
    store, row = Store(tmp_path), NotMade("a", "null", "none")
    assert store.begin(Head(seed=1)) == []
    store.add(row)
    with store.file.open("a") as file:
        file.write('{"case": "cut o')
    assert store.begin(Head(seed=1)) == [row]
    assert store.read()[1] == [row]
    with pytest.raises(ConfigError, match="seed"):
        store.begin(Head(seed=2))
    text = store.file.read_text()
    store.file.write_text(text.replace('"build": "', '"build": "x'))
    assert store.begin(Head(seed=2)) == []
    assert (tmp_path / "results.old.jsonl").exists()


def test_results_on_disk_stay_as_they_are(tmp_path: Path) -> None:
    (tmp_path / RESULTS).write_text(OLD_RESULTS)
    head, rows = Store(tmp_path).read()
    assert (head.seed, head.minutes, len(rows)) == (3, (1.0, 2.0), 2)
    (one,) = Figures(rows).pairs
    assert one[1].exact
    assert math.isnan(one[0].findings[0].parameters["phase"].std)
    assert one[0].findings[0].choices == {"side": "left"}
    again = Store(tmp_path / "again")
    again.file.parent.mkdir()
    for row in rows:
        again.add(row)
    assert [json.loads(line) for line in again.file.read_text().splitlines()] == [
        json.loads(line) for line in OLD_RESULTS.splitlines()[1:]
    ]


def test_a_folder_with_answers(tmp_path: Path) -> None:
    truth = make_truth(make_drive("warehouse", 90.0))
    null = simulate(truth, DEFAULT, (), replace(Conditions(), gyro_noise=1.0), 3)
    write_folder(null, tmp_path / "case_1", {"mission": "warehouse", "temperature": "warmup"})
    answers = [{"case": "case_1", "kind": "null", "effects": []}]
    (tmp_path / "answers.json").write_text(json.dumps(answers))
    out = tmp_path / "out"
    assert main(["trial", "--folder", str(tmp_path), "--jobs", "1", "--no-baselines", "--output", str(out)]) == 0
    assert [(r["case"], r["kind"]) for r in records(out)] == [("case_1", "given null")]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--folder", "nowhere"], "answers.json"),
        (["--each", "1", "--only", "no-such-*"], "--only"),
        (["--each", "1", "--minutes", "5", "4"], "--minutes"),
        (["--each", "1", "--reference", "often"], "--reference"),
    ],
)
def test_bad_input_is_one_clear_error(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["trial", *arguments, "--output", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
