"""The search among sets of selected effects."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnosis_drives import SLALOM, WAREHOUSE, problem, recorded, selected

import drd_tools.diagnose.select.search
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.conclude.rivals import FAR_NATS, near_sets
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, refine
from drd_tools.diagnose.select.library import is_plausible, is_possible
from drd_tools.diagnose.select.search import (
    Found,
    Search,
    _other_set,
    _relinearised_rivals,
    _with_others,
    coarse_search,
    full_search,
    is_rough,
)
from drd_tools.diagnose.select.sets import Sets


def test_a_stretch_that_was_found_in_pieces_becomes_one() -> None:
    p = problem(WAREHOUSE, 3)
    whole = selected("surface_slip", t0=40.0, t1=90.0, left=0.01, right=0.008)
    p = p.with_data(np.random.default_rng(4).standard_normal(len(p.data)) + p.effect_rows([whole]))
    free = ("t0", "t1", "left", "right")
    pieces = [
        replace(selected("surface_slip", t0=t0, t1=t1, left=0.01, right=0.008), free=free)
        for t0, t1 in ((40.0, 75.0), (76.0, 90.0))
    ]
    fit = Search(p).others(refine(p, pieces))[0]
    assert len(fit.selection) == 1
    assert fit.selection[0].number("t0") == pytest.approx(40.0, abs=4.0)
    assert fit.selection[0].number("t1") == pytest.approx(90.0, abs=4.0)


def test_every_stretch_of_the_grid_is_weighed_as_if_it_had_been_whitened_itself() -> None:
    p = problem(WAREHOUSE, 3)
    slip = selected("surface_slip", t0=30.0, t1=71.0, left=0.01, right=0.004)
    p = p.with_data(np.random.default_rng(4).standard_normal(len(p.data)) + p.effect_rows([slip]))
    fit = refine(p, [selected("tread_error", k=0.001)])
    gain, best = next((g, c) for g, c in Search(p).ranked(fit) if c.id == "surface_slip")
    free = ("left", "right")
    assert set(best.free) == {*free, "t0", "t1"}
    sizes_only = refine(p, [*fit.selection, replace(best, free=free)])
    beside = refine(
        p, [*fit.selection, replace(selected("surface_slip", **{**best.values, "left": 0.0, "right": 0.0}))]
    )
    # Its form's own doubt, and the search's single precision, are not in the gain.
    assert gain + p.penalty([best]) == pytest.approx(refine(p, fit.selection).cost - sizes_only.cost, rel=0.05)
    assert beside.selection[-1].number("left") == pytest.approx(best.number("left"), rel=0.05)
    edges = np.linspace(float(p.sensitivities.motion.time_s[0]), p.sensitivities.motion.end_s, 33)
    for t0, t1 in ((edges[i], edges[j]) for i in range(4, 12) for j in range(14, 22)):
        other = replace(best, values={**best.values, "t0": float(t0), "t1": float(t1)}, free=free)
        assert refine(p, [*fit.selection, other]).cost > sizes_only.cost - 0.05 * gain


def test_two_delays_that_stand_for_one_become_one() -> None:
    p = problem(SLALOM, 3, selected("gyro_latency", delay=0.08))
    lag, late = selected("gyro_lag", tau=0.07), selected("gyro_latency", delay=0.01)
    both = [replace(lag, free=("tau",)), replace(late, free=("delay",))]
    around = p.around(both)
    fit = refine(around, both)
    found = _relinearised_rivals(Search(around), Found(around, fit, 0.0))
    (only,) = found.fit.selection
    assert only.id == "gyro_latency"
    assert only.number("delay") == pytest.approx(0.08, abs=0.005)


def test_a_set_whose_parameters_leave_all_sizes_when_it_is_linearised_around_is_not_chosen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    p = problem(SLALOM, 3, selected("encoder_latency", delay=0.2))
    search, empty = Search(p), refine(p, ())
    found = Found(p, empty, search.score(empty))
    assert _other_set(search, found) is not None
    runaway = selected("terrain_tread", t0=0.0, t1=9.0, tread=-0.91, gain=-1.98)

    def linearised(problem: Problem, fit: Fit, null: float) -> Found:
        return Found(problem, replace(fit, selection=(runaway,)), null)

    monkeypatch.setattr(drd_tools.diagnose.select.search, "linearised", linearised)
    assert _other_set(search, found) is None


def test_what_acts_all_the_way_is_no_stretch() -> None:
    p = problem(WAREHOUSE, 3)
    end_s = p.sensitivities.motion.end_s
    intervals = [selected("surface_slip", t0=t0, t1=end_s, left=0.01, right=0.004) for t0 in (0.0, 0.6 * end_s)]
    assert [is_possible(p, interval) for interval in intervals] == [False, True]
    assert is_possible(p, selected("encoder_dropout", side="left", t0=0.0, t1=end_s))


def test_events_are_never_joined() -> None:
    p = problem(WAREHOUSE, 3)
    dropout = replace(selected("encoder_dropout", side="left", t0=40.0, t1=44.0), free=())
    slip = replace(
        selected("surface_slip", t0=44.0, t1=90.0, left=0.01, right=0.01), free=("t0", "t1", "left", "right")
    )
    p = p.with_data(np.random.default_rng(5).standard_normal(len(p.data)) + p.effect_rows([dropout, slip]))
    fit = refine(p, [dropout, slip])
    found = next(iter(Search(p, [dropout]).others(fit)), fit).selection
    assert {c.id for c in found} >= {"encoder_dropout"}
    assert found[0].number("t1") == 44.0


def test_two_that_hide_each_other_are_found_together() -> None:
    """Bumps count too much way, a wheel that grows with speed counts too little: alone neither is worth its cost."""
    p = problem(WAREHOUSE, 3)
    bumps, growth = selected("bump_counts", travel_per_m=1.0), selected("wheel_radius_speed", k=1.0)
    a, b = (row / np.linalg.norm(row) for row in (p.effect_rows([bumps]), p.effect_rows([growth])))
    p = p.with_data(30.0 * (a + b) + np.random.default_rng(4).standard_normal(len(a)))
    search, empty = Search(p), refine(p, ())
    assert not {"bump_counts", "wheel_radius_speed"} & {c.id for _, c in search.ranked(empty)}
    assert {c.id for c in search.others(empty)[0].selection} == {"bump_counts", "wheel_radius_speed"}


def test_pairs_are_rarely_found_in_noise() -> None:
    p = problem(WAREHOUSE, 3)
    found = []
    for seed in range(20):
        p = p.with_data(np.random.default_rng(seed).standard_normal(len(p.data)))
        found.append(bool(Search(p).others(refine(p, ()))))
    assert sum(found) <= 2


def test_a_ripple_is_found_beside_counts_that_turn_its_phase_away() -> None:
    bumps = selected("bump_counts", travel_per_m=0.003)
    ripple = selected("wheel_eccentricity", side="right", e=0.006, phase=1.0)
    result = analyse(recorded(("square-cw", 300.0), 5, bumps, ripple)).conclusion
    named = [{f.effect, *f.also_fits} for f in result.causes]
    assert len(named) == 2
    assert any("bump_counts" in names for names in named)
    assert any("wheel_eccentricity" in names for names in named)


@pytest.mark.parametrize("measured", [0.0, 0.004])
def test_a_constant_that_was_measured_is_held_as_closely_in_the_search_as_in_the_fit(measured: float) -> None:
    """A free radius would take most of a long slip of its wheel."""
    p = problem(WAREHOUSE, 3)
    slip = selected("surface_slip", t0=20.0, t1=80.0, left=0.01, right=0.0)
    p = p.exact().with_data(np.random.default_rng(4).standard_normal(len(p.data)) + p.effect_rows([slip]))
    prior = {"left": (measured, 0.0005), "right": (0.0, 0.0005)}
    fit = refine(p, [replace(selected("wheel_radius_error", left=0.0, right=0.0), prior=prior)])
    gain, best = next((g, c) for g, c in Search(p).ranked(fit) if c.id == "surface_slip")
    sizes = tuple(name for name in best.free if name not in ("t0", "t1"))
    beside = refine(p, [*fit.selection, replace(best, free=sizes)])
    assert gain + p.penalty([best]) == pytest.approx(refine(p, fit.selection).cost - beside.cost, rel=0.05)


def test_columns_that_what_is_held_explains_belong_to_no_candidate(monkeypatch: pytest.MonkeyPatch) -> None:
    beside = Sets._beside

    def rounded(self: Sets, columns: Any, products: Any) -> tuple[Any, Any]:
        """Two columns of 1e12 are held: of single precision's products less than nothing is left."""
        G, b = beside(self, columns, products)
        if columns.shape[1] > 2:
            G[:2, :2] = [[-1e4, 1e11], [1e11, -1e4]]
        return G, b

    monkeypatch.setattr(Sets, "_beside", rounded)
    sets = Sets(problem(WAREHOUSE, 3), ())
    assert sets.candidates
    assert not any({0, 1}.intersection(c.columns) for c in sets.candidates)
    assert sets.best(3, 3)


def test_names_that_fit_alike_are_led_by_the_best_exact_form() -> None:
    p = problem(WAREHOUSE, 3)
    scrub = replace(selected("turn_scrub", k=0.02), free=("k",))
    row = p.effect_rows([scrub])
    p = p.with_data(12.0 * row / np.linalg.norm(row))
    found = full_search(coarse_search(p))
    assert [c.id for c in found.fit.selection] == ["turn_scrub"]
    exact = Search(p).exact_score(refine(p, [selected("tread_error", k=0.0)]))
    assert Search(p).exact_score(found.fit) > exact


def test_a_rough_search_ends_where_little_changes_and_can_be_gone_on_with() -> None:
    p = problem(WAREHOUSE, 3)
    true = (
        (selected("tread_error", k=0.01), 30.0),
        (selected("gyro_vibration_bias", k=1e-4), 24.0),
        (selected("rotation_centre_offset", a=0.01), 20.0),
    )
    p = p.with_data(2.0 * np.random.default_rng(4).standard_normal(len(p.data)))
    for one, size in true:
        row = p.effect_rows([one])
        p = p.with_data(p.data + size * row / np.linalg.norm(row))
    rough = coarse_search(p)
    assert is_rough(rough.fit)
    assert 0 < len(rough.fit.selection) < 3
    assert {c.id for c in full_search(rough).fit.selection} >= {one.id for one, _ in true}


def test_beside_constants_a_set_that_changes_much_ends_the_search_until_the_noise_is_fitted() -> None:
    tread = replace(selected("tread_error", k=0.3), free=("k",))
    p = problem(SLALOM, 1, tread, selected("lateral_slip_turning", k=0.2))
    found = coarse_search(p, (), [tread])
    assert found.is_noise_due
    assert {c.id for c in found.fit.selection} >= {"tread_error", "lateral_slip_turning"}
    assert not coarse_search(p, (), [tread], found).is_noise_due


def test_the_calm_rate_of_a_straight_line_has_no_turn_in_it_and_less_noise() -> None:
    p = problem(("square-ccw", 200.0), 3)
    e, m, calm = p.evidence, p.sensitivities.motion, p.sensitivities.calm_rate_rad_s
    sigma_rad_s = float(np.median(np.sqrt(e.datasheet.gyro(e)) / e.step_s))
    straight = np.abs(m.rate_rad_s) < 5.0 * sigma_rad_s
    assert straight.mean() > 0.2
    assert np.abs(calm[straight]).max() < 8.0 * sigma_rad_s
    driven = straight & (m.speed_m_s > 0.1)
    assert np.std(calm[driven]) < 0.8 * np.std(m.rate_rad_s[driven])


def test_what_explains_less_than_nothing_did_before_is_no_error() -> None:
    """Around a path that a dead counter has bent, and with its noise, all scores may be far below the first one."""
    late = problem(SLALOM, 1, selected("encoder_latency", delay=0.1))
    fit = refine(late, ())
    score = Search(late).score(fit)
    found = _other_set(Search(late), Found(late, fit, score + 1e6))
    assert found is not None
    assert found.fit.selection[0].id == "encoder_latency"


def test_of_the_fits_of_the_same_names_the_best_one_stands_for_them() -> None:
    """An edge in time has several optima, next to each other."""
    found = analyse(recorded(WAREHOUSE, 1, selected("gyro_bias_step", b=2e-4, t0=60.0))).conclusion.found
    search = Search(found.problem)
    near = near_sets(found, search)
    assert near[0].fit is found.fit
    best = {one.names: search.score(one.fit) for one in near}
    for fit in search.near(found.fit, found.score - FAR_NATS):
        assert search.score(fit) <= best[frozenset(c.id for c in fit.selection)] + 1e-3  # where each descent ended


def test_what_is_driven_beyond_all_sizes_is_not_searched_from() -> None:
    """With other noise than that with which it was found: it ended in a model that no daemon reads."""
    p = problem(SLALOM, 0, selected("tread_error", k=-0.05))
    null = refine(p, ())
    assert _with_others(p, null, [selected("turn_scrub", k=0.1)], 0.0).fit.selection == ()
    (tread,) = _with_others(p, null, [selected("tread_error", k=-0.04)], 0.0).fit.selection
    assert tread.number("k") == pytest.approx(-0.05, abs=0.005)


def test_of_two_of_a_name_the_one_that_is_driven_beyond_all_sizes_goes_alone() -> None:
    """No wheel slips by less than nothing."""
    slips = [
        selected("surface_slip", left=left, right=0.0, t0=t0, t1=t0 + 8.0) for left, t0 in ((0.1, 20.0), (-0.1, 50.0))
    ]
    p = problem(SLALOM, 0, *slips)
    starts = [replace(slip, values={**slip.values, "left": 0.05}, free=("left",)) for slip in slips]
    (kept,) = _with_others(p, refine(p, ()), starts, 0.0).fit.selection
    assert kept.number("left") == pytest.approx(0.1, abs=0.02)
    assert kept.begin_s == 20.0


@pytest.mark.parametrize(("scale", "expected"), [(0.1, True), (-0.1, True), (0.2, False), (-50.0, False)])
def test_a_scale_beside_a_form_is_as_limited_as_one_alone(scale: float, expected: bool) -> None:
    bent = selected("gyro_scale_nonlinearity", a2=0.01, a3=0.008, largest_rate=0.5)
    assert is_plausible(replace(bent, values={**bent.values, "scale": scale})) == expected
    assert is_plausible(selected("gyro_scale_error", k=scale)) == expected
