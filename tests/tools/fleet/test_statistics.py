"""What the statistics of a fleet say of histories that are known, and of histories without anything."""

from datetime import timedelta
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from fleet_tables import day, made_table

from drd_tools.fleet.calibration import inflation
from drd_tools.fleet.discoveries import benjamini_hochberg, by_probability
from drd_tools.fleet.levels import Series
from drd_tools.fleet.sentences import sentences
from drd_tools.fleet.series import CONSTANTS, MOST, Maintained, logs
from drd_tools.fleet.statistics import analyse


def test_nothing_is_found_where_nothing_is() -> None:
    found = [analyse(made_table(12, 40, seed)) for seed in range(8)]
    # 3,840 robot-days; the goal is one false alarm in 1,000.
    assert sum(len(s.found) for s in found) <= 1
    assert sum(len(f.population.steps) for s in found for f in s.fitted.values()) == 0
    # A false discovery rate of 5 % over 8 fleets without anything: each may have one with that chance, three kinds.
    assert sum(len(s.standing_out) for s in found) <= 4


def test_dates_and_sizes_are_as_sure_as_they_say() -> None:
    random = np.random.default_rng(1)
    when, size = random.integers(5, 35, 80), random.choice([-1.0, 1.0], 80) * random.uniform(0.003, 0.012, 80)
    dated, inside, sized = [], [], []
    for part in range(5):
        own = slice(16 * part, 16 * part + 16)
        t, d = when[own], size[own]
        found = analyse(made_table(16, 40, 100 + part, lambda r, k, *_, t=t, d=d: d[r - 1] * (k >= t[r - 1]))).found
        assert len(found) == 16
        for e in found:
            i = int(e.robot) - 1
            true = day(int(t[i])).timestamp() / 86_400.0
            dated.append(abs(e.first - t[i]) <= 1)
            inside.append(e.low <= true + 1.0 and true <= e.high)
            sized.append((e.size - d[i]) / e.sigma)
    assert np.mean(dated) >= 0.95
    assert np.mean(inside) >= 0.90
    assert 0.82 <= np.mean(np.abs(sized) < 1.645) <= 0.99  # of 80; 90 % are promised


def test_a_robot_a_floor_and_a_batch_are_told_apart() -> None:
    def happens(robot: int, k: int, place: str, batch: str) -> float:
        own = 0.006 * (robot == 7 and k >= 12)
        return own - 0.008 * (place == "p1" and k >= 25) + 0.007 * (batch == "b2" and k >= 18)

    s = analyse(made_table(15, 40, 5, happens, places=3, batches=3))
    steps = {(x.kind, x.which): x for x in s.fitted["radius_left"].population.steps}
    assert steps.keys() == {("place", 1), ("batch", 2)}
    assert steps["place", 1].size == pytest.approx(-0.008, abs=0.001)
    assert steps["batch", 2].size == pytest.approx(0.007, abs=0.001)
    [event] = s.found
    assert (event.robot, event.cause, event.others) == ("7", "robot", 14)
    assert event.causes["robot"] > 0.95


def test_a_place_of_one_robot_is_not_blamed_for_what_may_be_the_robots() -> None:
    def stands_out(visitors: set[str]) -> set[str]:
        table = made_table(6, 40, 3, lambda r, k, *_: 0.02 * (str(r) in visitors and k % 2), places=1, batches=1)
        days = zip(table["robot"], table["start_utc"], strict=True)
        table["place"] = ["hall" if r in visitors and (start - day(0)).days % 2 else "yard" for r, start in days]
        return {o.who for o in analyse(table).standing_out if o.kind == "place"}

    assert stands_out({"4"}) == set()
    assert "hall" in stands_out({"1", "4", "6"})


def test_the_first_robots_on_a_new_floor_are_not_blamed() -> None:
    s = analyse(made_table(4, 40, 2, lambda r, k, place, _: 0.01 * (place == "p1" and k >= 37 and r <= 2), places=4))
    assert all(e.cause != "robot" for e in s.found)


def test_two_of_three_robots_do_not_speak_for_a_floor() -> None:
    s = analyse(made_table(3, 30, 11, lambda r, k, *_: -0.01 * (r <= 2 and k >= 12), places=2, batches=1))
    assert s.fitted["radius_left"].population.steps == ()
    assert {e.robot for e in s.found} == {"1", "2"}


def test_what_is_apart_ever_since() -> None:
    s = analyse(made_table(12, 20, 3, lambda r, _, place, __: 0.01 * (place == "p2") + 0.02 * (r == 5), places=3))
    assert {(o.kind, o.who) for o in s.standing_out} == {("place", "p2"), ("robot", "5")}
    assert s.found == []


def test_maintenance_makes_a_change_likelier() -> None:
    table = made_table(8, 30, 4, lambda r, k, *_: 0.0014 * (r == 3 and k >= 28))

    def probability(*what: str) -> float:
        log = [{"date": day(28), "robot": "3", "what": w} for w in what]
        events = analyse(table, log).fitted["radius_left"].events
        return max((e.probability for e in events if e.robot == "3"), default=0.0)

    assert probability("left tyre changed") > 0.95
    assert probability() == probability("right tyre changed") < 0.9


@pytest.mark.parametrize("hours", [0.0, 12.0])
def test_a_date_without_a_time_means_any_time_of_that_day(hours: float) -> None:
    """Robots drive at 8: what is done behind the drive of day 20 changes that of day 21."""
    table = made_table(8, 40, 0, lambda r, k, *_: -0.008 * (r == 3 and k >= 21), places=1, batches=1)
    log = [{"date": day(20) + timedelta(hours=hours), "robot": "3", "what": "left tyre changed"}]
    [event] = [e for e in analyse(table, log).fitted["radius_left"].events if e.robot == "3"]
    assert (event.recording, event.maintenance is not None) == ("3_21", True)


@pytest.mark.parametrize(("what", "left", "gyro"), [
    ("left tyre changed", True, False), ("Right tyre pumped up", False, False), ("tyres", True, False),
    ("gyro exchanged", False, True), ("inspection", None, None),
])  # fmt: skip
def test_what_maintenance_means(what: str, left: bool | None, gyro: bool | None) -> None:
    done = Maintained(0.0, "1", what)
    assert (done.means("radius_left"), done.means("gyro_scale")) == (left, gyro)


def test_sentences() -> None:
    def happens(robot: int, k: int, *_: str) -> float:
        return -0.008 * (robot == 7 and 11 <= k < 30)

    log = [{"date": day(30), "robot": "7", "what": "tyre changed"}]
    [said] = sentences(analyse(made_table(41, 40, 6, happens), log))
    head, tail = said.text.split("; ")
    assert head.startswith("Robot 7, left tyre -0.8")
    assert head.endswith("since 12 March 2026 (1.00), not in the other 40")
    assert tail == "tyre changed 31 March 2026: back to 0.0."
    assert said.is_over


def test_a_leak_creeps() -> None:
    s = analyse(made_table(8, 60, 7, lambda r, k, *_: -0.0006 * max(0, k - 20) * (r == 2)))
    [event] = s.found
    assert (event.robot, event.form, event.cause) == ("2", "creep", "robot")
    assert abs(event.first - 21) <= 5
    assert event.size == pytest.approx(-0.0234, abs=0.001)


def test_a_season_is_nobodys_change() -> None:
    s = analyse(made_table(20, 90, 8, lambda _, k, *__: 0.001 * float(np.sin(k / 30.0))))
    assert s.found == []
    season = s.fitted["radius_left"].population.season
    assert np.ptp(season) == pytest.approx(0.001, abs=0.0002)


def test_many_recordings_of_one_robot_are_averaged() -> None:
    [log] = logs(made_table(1, 1500, 9)).values()
    assert MOST // 2 <= len(log.value) <= MOST + 2
    assert all(a <= b for a, b in pairwise(log.day))
    assert np.median(log.sigma) < 3e-4


def test_only_of_that_robot_and_whatever_places_others_are_at() -> None:
    many, few, others = made_table(1, MOST + 8, 9), made_table(6, 100, 10), made_table(40, 1, 11)
    joined: dict[str, list[Any]] = {}
    for table, mark in ((many, "many"), (few, "few"), (others, "other")):
        table["robot"] = [mark + robot for robot in table["robot"]]
        table["place"] = [f"site of {robot}" for robot in table["robot"]]
        joined |= {column: joined.get(column, []) + rows for column, rows in table.items()}
    [log] = logs(joined).values()
    counts = dict(zip(log.robots, np.bincount(log.robot).tolist(), strict=True))
    assert counts["many1"] == MOST // 2 + 4
    assert {counts[f"few{k}"] for k in range(1, 7)} == {100}


def test_rows_without_time_or_value_are_left_out() -> None:
    table = made_table(2, 5, 0)
    table["start_utc"][0], table["value"][1], table["sigma"][2] = None, None, 0.0
    assert len(logs(table)["radius_left"].value) == 7


def test_benjamini_hochberg() -> None:
    assert benjamini_hochberg(np.array([0.001, 0.013, 0.014, 0.9]), 0.05).tolist() == [True, True, True, False]
    assert benjamini_hochberg(np.array([0.02, 0.9]), 0.03).tolist() == [False, False]
    assert benjamini_hochberg(np.zeros(0), 0.05).tolist() == []
    random, false, found = np.random.default_rng(0), 0, 0
    for _ in range(300):
        p = random.uniform(size=50)
        p[:10] *= 1e-4
        mask = benjamini_hochberg(p, 0.1)
        false, found = false + int(mask[10:].sum()), found + max(1, int(mask.sum()))
    assert false / found < 0.1


def test_by_probability() -> None:
    assert by_probability(np.array([0.999, 0.5, 0.97, 0.99]), 0.02, 0.9).tolist() == [True, False, True, True]
    assert by_probability(np.array([0.999, 0.96]), 0.01, 0.95).tolist() == [True, False]


@pytest.mark.parametrize(("walk", "least", "most"), [(1.0, 1.0, 1.2), (0.0, 1.4, 9.0)])
def test_levels_that_wander_more_than_is_said_are_less_sure(walk: float, least: float, most: float) -> None:
    random, n = np.random.default_rng(2), 60
    wander, noise = random.standard_normal((2, 30, n))
    every = [
        Series(str(k), "tread", CONSTANTS["tread"], [""] * n, np.arange(float(n)), level, np.full(n, 1e-6), 0.0, 0.01,
               1e-7 * walk, 1.0)
        for k, level in enumerate(np.cumsum(1e-7**0.5 * wander, 1) + 1e-3 * noise)
    ]  # fmt: skip
    assert least <= inflation(every, [one.smoothed([(0, 0, n - 1)]) for one in every]) <= most
