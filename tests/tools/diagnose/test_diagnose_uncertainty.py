"""Deviations that are reported cover, also where a curvature is too sure."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from diagnosis_drives import WAREHOUSE, problem, recorded, selected

from drd_tools.diagnose.conclude.reference import BARELY, over_the_reference
from drd_tools.diagnose.conclude.uncertainty import reported_estimates, shrunk
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, refine
from drd_tools.diagnose.select.sets import Sets
from drd_tools.diagnose.selected import Selected

Z_90 = 1.645
COST_NATS = 4.5  # of a parameter, where there are 8000 rows


@lru_cache
def null() -> Problem:
    return problem(WAREHOUSE, 0)


def fitted(truth: Selected, seed: int) -> tuple[Problem, Fit]:
    """White noise and an effect, fitted from the truth on."""
    p = null()
    p = p.with_data(np.random.default_rng(seed).standard_normal(len(p.data)) + p.effect_rows([truth]))
    return p, refine(p, [truth])


def test_a_windows_edges_and_sizes_are_covered() -> None:
    slip = replace(
        selected("surface_slip", t0=45.0, t1=75.0, left=0.01, right=0.01), free=("t0", "t1", "left", "right")
    )
    size = float(np.linalg.norm(null().effect_rows([slip])))
    slip = replace(slip, values={**slip.values, "left": 0.12 / size, "right": 0.12 / size})  # visibility of 12
    inside, curved = [], []
    for seed in range(16):
        p, fit = fitted(slip, seed)
        (found,) = reported_estimates(p, fit)
        for name in slip.free:
            error = abs(found.number(name) - slip.number(name))
            inside.append(error < Z_90 * found.sigma(name))
            curved.append(error < Z_90 * fit.selection[0].sigma(name))
            assert found.sigma(name) >= fit.selection[0].sigma(name)
    assert np.mean(inside) > 0.8
    assert np.mean(inside) > np.mean(curved)


def test_an_intervals_sizes_are_as_unsure_as_the_ground_elsewhere_makes_them() -> None:
    """Where each stretch of ground has a slip of its own, none of which is worth a name, a size is known no better."""
    p, ground = null(), np.random.default_rng(7)
    slip = replace(selected("surface_slip", t0=45.0, t1=60.0, left=0.004, right=0.004), free=("left", "right"))
    begins_s = np.arange(p.evidence.edges_s[0], p.evidence.edges_s[-1], 7.5)
    pieces = [
        replace(slip, values={"t0": t, "t1": t + 7.5, "left": left, "right": right})
        for t, left, right in zip(begins_s, *ground.normal(0.0, 0.004, (2, len(begins_s))), strict=True)
    ]
    white = ground.standard_normal(len(p.data)) + p.effect_rows([slip])
    found = []
    for data in (white, white + p.effect_rows(pieces)):
        q = p.with_data(data)
        fit = refine(q, [slip])
        found.append(Sets(q, fit.selection).scatter(fit.selection[0]))
        (reported,) = reported_estimates(q, fit, scatter=lambda _: found[-1])
        assert reported.sigma("left") == pytest.approx(
            found[-1] * reported_estimates(q, fit)[0].sigma("left"), rel=1e-6
        )
    assert found[0] == 1.0
    assert found[1] > 2.0


def test_a_parameter_that_was_left_out_is_told_with_its_deviation() -> None:
    bias = selected("gyro_bias_temperature", b1=2e-5, b2=0.0)
    p, fit = fitted(replace(bias, free=("b1",)), 1)
    (found,) = reported_estimates(p, fit)
    assert set(found.free) == {"b1", "b2"}
    assert found.sigma("b2") > 0.0
    assert found.sigma("b1") > 1.5 * fit.selection[0].sigma("b1")
    assert found.number("b1") == pytest.approx(2e-5, abs=3.5 * found.sigma("b1"))


@pytest.mark.parametrize("seed", range(3))
def test_what_a_drive_says_nothing_of_is_told_as_nothing(seed: int) -> None:
    """On the spot no wheel goes straight: the gain of other ground is anything, and would spoil a drive that does."""
    ground = selected("terrain_tread", t0=60.0, t1=140.0, tread=0.01, gain=0.0)
    p = problem(("spins", 200.0), seed, ground)
    fit = refine(p, [replace(ground, free=("tread", "gain"))])
    (found,) = reported_estimates(p, fit)
    assert abs(found.number("gain")) < 0.1 * abs(fit.selection[0].number("gain"))
    assert found.sigma("gain") > 10.0 * abs(found.number("gain"))
    assert found.number("tread") == pytest.approx(fit.selection[0].number("tread"), abs=0.5 * found.sigma("tread"))


@pytest.mark.parametrize(("size", "sigma"), [(0.3, 0.05), (0.001, 0.0001)])
def test_what_a_drive_tells_stays_as_it_fits(size: float, sigma: float) -> None:
    """Also where it is larger than is usual."""
    scale = replace(selected("gyro_scale_error", k=size), covariance=np.array([[sigma**2]]))
    (found,) = shrunk([scale], scale.covariance, COST_NATS)
    assert found.number("k") == pytest.approx(size, abs=0.5 * sigma)


def test_where_a_drive_tells_a_sum_only_its_parts_are_small_and_add_up() -> None:
    shape = selected("gyro_scale_nonlinearity", a2=0.5, a3=-0.4, largest_rate=1.0)
    apart, together = np.array([1.0, -1.0]), np.array([1.0, 1.0])
    covariance = np.outer(apart, apart) + 1e-8 * np.outer(together, together)
    (found,) = shrunk([shape], covariance, COST_NATS)
    assert found.number("a2") + found.number("a3") == pytest.approx(0.1, abs=1e-3)
    assert max(abs(found.number("a2")), abs(found.number("a3"))) < 0.1


def test_what_is_known_by_logic_stays_as_it_is() -> None:
    p, fit = fitted(selected("tread_error", k=0.02), 2)
    assert reported_estimates(p, fit, {"tread_error"}) == fit.selection


def test_nothing_found_is_nothing_told() -> None:
    p = null()
    assert reported_estimates(p, refine(p, [])) == ()


def test_a_delay_is_that_of_the_drives_middle_where_its_growth_may_be_the_references() -> None:
    recording = replace(recorded(WAREHOUSE, 0), fog=None)
    p = Problem(gather(recording))
    middle_s = float(p.evidence.edges_s[[0, -1]].mean())
    late = replace(selected("encoder_latency", delay=0.25), free=("delay",), covariance=np.eye(1) * 0.05**2)
    clock = replace(selected("encoder_clock_skew", ppm=800e-6), free=("ppm",), covariance=np.eye(1) * 8e-4**2)
    (delay, rate), (delay_odds, rate_odds) = over_the_reference(p, [late, clock])
    assert delay.number("delay") == pytest.approx(0.25 - 800e-6 * middle_s)
    assert rate == clock
    assert rate_odds < BARELY < delay_odds
    surely = replace(clock, covariance=np.eye(1) * 1e-4**2)
    (delay, _), (_, rate_odds) = over_the_reference(p, [late, surely])
    assert delay == late
    assert rate_odds > BARELY
