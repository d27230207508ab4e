"""Each promise is broken by figures that break it, and by nothing else; the table and the file show all of them."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drd.config.schema import ConfigError
from drd_tools.honesty import __main__ as command
from drd_tools.honesty.baselines import GYRO, STOPS, WHEELS
from drd_tools.honesty.configurations import CALIBRATED, DEFAULT, NOMINAL_LIMIT, STATED
from drd_tools.honesty.figures import Figures
from drd_tools.honesty.promises import goals, nees_limit, promises, ratio_at_least, single_seeds_worse
from drd_tools.honesty.results import Judged, Results, together
from drd_tools.honesty.table import table_rows, text_of

GOOD = Figures(0.4, 1.0, 1.0, inside=1.0, bound_m=1.5, bound_ratio=4.0, valid=1.0)
REAL = "warthog_made_up"


def figures(**default: Any) -> dict[str, Figures]:
    poor, fair, best = (Figures(m, 2.0, 2.0) for m in (10.0, 0.6, 0.5))
    return {DEFAULT: replace(GOOD, **default), WHEELS: poor, GYRO: fair, STOPS: best}


def results(
    real: Mapping[str, Figures] | None = None, seeds: list[dict[str, Figures]] | None = None, nees: float = 3.0
) -> Results:
    drives = [Judged("real", REAL, REAL, dict(real or figures()))]
    for number, one in enumerate(seeds or [figures()] * 10):
        drives.append(Judged("simulated", "plain", f"seed {number}", one, {STATED: nees, DEFAULT: nees}))
    return Results(10, drives)


def broken(found: Results) -> list[str]:
    return [verdict.about.split(":")[0] for verdict in promises(found) if not verdict.kept]


def test_good_figures_break_nothing() -> None:
    assert broken(results()) == []


@pytest.mark.parametrize(
    ("changed", "promise"),
    [
        ({"position_rms_m": 0.53}, "never worse than its inputs"),
        ({"inside": 0.98}, "the bound holds"),
        ({"inside": None}, "the bound holds"),
        ({"bound_ratio": 8.1}, "the bound is of use"),
    ],
)
def test_each_promise_of_a_real_drive(changed: dict[str, Any], promise: str) -> None:
    assert broken(results(real=figures(**changed))) == [promise]


def test_a_twentieth_more_than_the_best_input_is_allowed() -> None:
    assert broken(results(real=figures(position_rms_m=0.52))) == []


def test_simulated_drives_are_judged_over_their_seeds() -> None:
    lucky = [figures(position_rms_m=0.7), *[figures(position_rms_m=0.3)] * 39]
    assert broken(results(seeds=lucky)) == []
    found = results(seeds=lucky)
    assert single_seeds_worse(found.groups("simulated")["plain"]) == 1
    worse, astray = figures(position_rms_m=0.6), figures(position_rms_m=0.9)
    assert broken(results(seeds=[worse] * 40)) == ["never worse than its inputs"]
    assert broken(results(seeds=[worse] * 10)) == []  # luck could do that
    assert broken(results(seeds=[astray] * 10)) == ["never worse than its inputs"]


def test_one_seed_astray_breaks_the_promise_however_unsure_it_makes_the_ratio() -> None:
    seeds = [figures(position_rms_m=6.0), *[figures(position_rms_m=0.45)] * 39]
    assert ratio_at_least([6.0, *[0.45] * 39], [0.5] * 40) < 1.0
    nees_kept = results(seeds=seeds)
    assert broken(nees_kept) == ["never worse than its inputs"]


def test_how_sure_the_seeds_make_a_ratio() -> None:
    assert ratio_at_least([0.6], [0.5]) == 0.0
    assert ratio_at_least([0.6] * 3, [0.5] * 3) == pytest.approx(1.2)
    assert ratio_at_least([0.2, 1.0, 0.4], [0.4, 0.8, 0.5]) < 1.0


@pytest.mark.parametrize(("nees", "kept"), [(3.0, True), (1.5, False), (5.0, False)])
def test_nees_has_to_lie_in_its_interval_on_both_sides(nees: float, kept: bool) -> None:
    assert (broken(results(seeds=[figures()] * 40, nees=nees)) == []) is kept


def test_a_scenario_that_the_filter_does_not_model_is_a_goal_from_above_only() -> None:
    def found(nees: float) -> Results:
        return Results(10, [Judged("simulated", "mix", f"{k}", figures(), {DEFAULT: nees}) for k in range(10)])

    for nees, kept in ((0.5, True), (6.0, False)):
        assert broken(found(nees)) == []
        assert [verdict.kept for verdict in goals(found(nees))] == [kept]
    assert 3.0 < nees_limit(300) < nees_limit(10)


def test_goals_are_medians_of_their_drives() -> None:
    def warthog(name: str, default_m: float, calibrated_m: float) -> Judged:
        calibrated = {CALIBRATED: replace(GOOD, position_rms_m=calibrated_m)}
        return Judged("real", name, name, figures(position_rms_m=default_m) | calibrated)

    found = Results(1, [warthog(f"warthog_{k}", 0.2 * k, 0.29 + 0.01 * k) for k in range(1, 4)])
    verdicts = goals(found)
    assert [verdict.kept for verdict in verdicts] == [True, False]
    assert "0.4 m" in verdicts[0].text
    near = Results(1, [Judged("simulated", "plain", "0", figures() | {NOMINAL_LIMIT: Figures(0.38, 1.0, None)})])
    assert [verdict.kept for verdict in goals(near)] == [True]


def test_real_groups_are_medians_and_simulated_ones_root_mean_squares() -> None:
    many = [replace(GOOD, position_rms_m=m) for m in (3.0, 4.0, 12.0)]
    assert together(many, "real").position_rms_m == 4.0
    assert together(many, "simulated").position_rms_m == pytest.approx(7.505, abs=1e-3)
    assert together([Figures(1.0, 1.0, None)], "real").inside is None


def test_the_table_has_a_row_for_each_configuration_of_each_group() -> None:
    rows = list(table_rows(results()))
    assert [row[2] for row in rows] == [DEFAULT, WHEELS, GYRO, STOPS] * 2
    assert [row[0] for row in rows if row[0]] == [REAL, "plain"]
    assert rows[4][1] == "10"
    assert rows[1][5:] == ["2.00", "-", "-", "-", "-"]


def test_what_is_kept_prints_the_same_again_and_fails_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "honesty.json"
    for found, code in ((results(), 0), (results(real=figures(inside=0.5)), 1)):
        found.write(file)
        assert Results.read(file) == found
        assert command.main(["--read", str(file)]) == code
        assert capsys.readouterr().out.strip() == text_of(found)
    assert f"BROKEN: the bound holds: {REAL}: 50.0 % inside" in text_of(found)


def test_another_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "other.json"
    assert command.main(["--read", str(file)]) == 2
    file.write_text(json.dumps({"format": "something"}))
    assert command.main(["--read", str(file)]) == 2
    assert "drd-honesty/1" in capsys.readouterr().err
    with pytest.raises(ConfigError):
        Results.read(file)
