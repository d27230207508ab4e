"""The fit of given selected effects: it ends where it should from near and far, by slopes of what is explained."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_drives import SLALOM, WAREHOUSE, problem, recorded, selected

from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import DISCREPANCY_SHARE, _inverse, discrepancies, refine, refine_all
from drd_tools.diagnose.selected import Selected

GROUND = replace(
    selected("terrain_tread", t0=40.0, t1=90.0, tread=0.02, gain=0.003), free=("t0", "t1", "tread", "gain")
)
LATE = replace(selected("encoder_latency", delay=0.06), free=("delay",))
SCALE_AND_BIAS = selected("gyro_scale_nonlinearity", a2=1e-4, a3=-2e-4, largest_rate=0.9)


def with_noise(drive: tuple[str, float], truth: Selected, seed: int = 4) -> Problem:
    p = problem(drive, 3)
    return p.with_data(np.random.default_rng(seed).standard_normal(len(p.data)) + p.effect_rows([truth]))


@pytest.mark.parametrize(
    ("truth", "begin"),
    [
        (GROUND, {"t1": 80.0}),
        (GROUND, {"t1": 100.0, "tread": 0.05}),
        (LATE, {"delay": 0.02}),
        (LATE, {"delay": 0.15}),
    ],
)
def test_a_fit_from_afar_ends_where_one_from_the_truth_does(truth: Selected, begin: dict[str, float]) -> None:
    p = with_noise(WAREHOUSE, truth)
    near, far = refine(p, [truth]), refine(p, [replace(truth, values={**truth.values, **begin})])
    assert far.cost == pytest.approx(near.cost, abs=0.5)
    for name in truth.free:
        assert far.selection[0].number(name) == pytest.approx(
            near.selection[0].number(name), abs=near.selection[0].sigma(name)
        )


def test_what_cannot_reach_the_score_is_given_up_and_what_can_is_not() -> None:
    p = with_noise(WAREHOUSE, GROUND)
    right, wrong = replace(GROUND, values={**GROUND.values, "t0": 46.0}), selected("gyro_scale_error", k=0.001)
    whole = refine(p, [right])
    least = -whole.cost - p.penalty(whole.selection) - 1.0
    first, second = refine_all(p, [[right], [wrong]], least)
    assert first.cost == pytest.approx(whole.cost, abs=0.5)
    assert -second.cost - p.penalty(second.selection) < least


@pytest.mark.parametrize("truth", [GROUND, LATE, SCALE_AND_BIAS])
def test_slopes_are_those_of_what_is_explained(truth: Selected) -> None:
    p = problem(SLALOM, 3)
    tangents = p.tangents([truth])
    for name, tangent in zip(truth.free, tangents.T, strict=True):
        h = 0.5 if name in ("t0", "t1") else 1e-3 * abs(truth.number(name))
        ahead, back = (
            p.effect_rows([replace(truth, values={**truth.values, name: truth.number(name) + d})]) for d in (h, -h)
        )
        slope = (ahead - back) / (2.0 * h)
        assert np.linalg.norm(tangent - slope) < 0.05 * np.linalg.norm(slope)


@pytest.mark.parametrize("truth", [GROUND, LATE, SCALE_AND_BIAS])
def test_other_shapes_are_beyond_the_parameters_reach(truth: Selected) -> None:
    p = problem(SLALOM, 3)
    shapes, tangents = discrepancies(p, truth), p.tangents([truth])
    assert shapes.size
    tangents = tangents / np.linalg.norm(tangents, axis=0)
    whole = DISCREPANCY_SHARE * np.linalg.norm(p.effect_rows([truth]))
    assert np.abs(tangents.T @ shapes).max() < 1e-6 * whole
    assert np.linalg.norm(shapes, axis=0).max() <= whole * (1.0 + 1e-9)


@pytest.mark.parametrize("effect", ["encoder_latency", "gyro_latency"])
def test_a_delay_of_many_steps_is_found_and_nothing_else(effect: str) -> None:
    (found,) = analyse(recorded(WAREHOUSE, 3, selected(effect, delay=0.35))).conclusion.causes
    assert found.effect == effect
    assert found.selected is not None
    assert found.selected.number("delay") == pytest.approx(0.35, abs=3.0 * found.selected.sigma("delay"))
    assert found.selected.sigma("delay") < 0.02


@pytest.mark.parametrize("size", [0.0, 1e-320, 1e-200, 1.0])
def test_what_is_not_seen_has_an_inverse_of_nothing(size: float) -> None:
    S = np.diag([4.0, size])
    assert _inverse(S) == pytest.approx(np.diag([0.25, float(size == 1.0)]))
    assert _inverse(S[1:, 1:]) == pytest.approx(float(size == 1.0))
