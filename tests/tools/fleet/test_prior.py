"""A robot's prior: what its history and the fleet's say, in files that the daemon reads."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fleet_tables import day, made_table

from drd.config.schema import ConfigError
from drd.effects.model import load_model
from drd_tools.fleet.prior import expect, write_prior
from drd_tools.fleet.series import day_of
from drd_tools.fleet.statistics import analyse


def joined(*tables: dict[str, list[Any]]) -> dict[str, list[Any]]:
    return {c: [v for t in tables for v in t[c]] for c in tables[0]}


def test_a_robot_with_a_history_and_one_without() -> None:
    table = made_table(20, 30, 0, lambda r, *_: 0.004 + 0.01 * (r == 3))
    statistics, today = analyse(table), day_of(day(31))
    true = np.mean([v for v, r in zip(table["value"], table["robot"], strict=True) if r == "3"])
    [known] = expect(statistics, "3", today, "p0")
    assert known.value == pytest.approx(true, abs=3.0 * known.sigma)
    assert known.sigma < 5e-4
    assert known.recordings == 30
    [stranger] = expect(statistics, "new", today, "p0")
    assert stranger.value == pytest.approx(0.0045, abs=0.003)
    assert stranger.sigma > 5.0 * known.sigma
    [later] = expect(statistics, "3", today + 365.0, "p0")
    assert later.sigma > known.sigma


def test_a_known_place_is_surer() -> None:
    table = made_table(12, 30, 1, lambda *of: 0.02 * (of[2] == "p1"), name="tread", sigma=2e-3, places=3)
    s = analyse(table)
    [here], [anywhere] = (expect(s, "2", day_of(day(31)), place) for place in ("p1", None))
    [there] = expect(s, "2", day_of(day(31)), "p0")
    assert here.value - there.value == pytest.approx(0.02, abs=0.002)
    assert here.sigma < 0.5 * anywhere.sigma


def test_what_a_batch_has_changed_by_is_in_its_robots_prior() -> None:
    def aged(_: int, day: int, __: str, batch: str) -> float:
        return 0.006 * (batch == "b1" and day >= 20)

    s = analyse(made_table(12, 40, 0, aged, name="gyro_scale", sigma=3e-4, spread=1e-3))
    assert [(step.kind, step.which) for step in s.fitted["gyro_scale"].population.steps] == [("batch", 1)]
    base = analyse(made_table(12, 40, 0, name="gyro_scale", sigma=3e-4, spread=1e-3))
    for robot, change in (("1", 0.006), ("2", 0.0), ("3", 0.006)):
        [now], [before] = (expect(one, robot, day_of(day(41))) for one in (s, base))
        assert now.value - before.value == pytest.approx(change, abs=5e-4)


def test_the_files_are_the_daemons(tmp_path: Path) -> None:
    table = joined(
        made_table(6, 20, 0, name="radius_left"),
        made_table(6, 20, 1, name="radius_right"),
        made_table(6, 20, 2, lambda *_: -0.03, name="lag_s", sigma=1e-3),
        made_table(6, 20, 3, lambda *_: 2e-5, name="bias_per_c", sigma=1e-6, spread=1e-6),
    )
    files = write_prior(expect(analyse(table), "1", day_of(day(21))), "1", tmp_path)
    terms = {t.effect.id: t for t in load_model(files[0]).terms}
    assert terms.keys() == {"wheel_radius_error", "gyro_latency", "gyro_bias_temperature"}
    assert terms["gyro_latency"].values()["delay"] == pytest.approx(0.03, abs=0.01)
    assert terms["gyro_bias_temperature"].values()["b1"] == pytest.approx(2e-5, rel=0.3)
    assert 0.0 < terms["wheel_radius_error"].stds()["left"] < 0.01


def test_an_empty_store() -> None:
    with pytest.raises(ConfigError, match="at least one recording"):
        expect(analyse({c: [] for c in made_table(1, 1, 0)}), "1", 0.0)
