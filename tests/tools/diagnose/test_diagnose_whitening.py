"""Whitened data are white, sensitivities are what effects add, and the reference's own errors are no findings."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import pytest
from diagnosis_drives import ASIDE_4_CM, LATE_5_MS, SLALOM, WAREHOUSE, problem, selected, simulated
from scipy import stats

from drd_tools.diagnose.error_model.linear import Linear, Sensitivity
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.noise_fit import WHEELS, scaled
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.select.library import Library
from drd_tools.diagnose.selected import Selected
from drd_tools.simulate.conditions import PERFECT, Conditions
from drd_tools.simulate.robot import DEFAULT

Array = npt.NDArray[np.float64]

SEEDS = 20
FINE = replace(DEFAULT, counts_per_revolution=2e7)
# Effects of all channels, of a size between just and well visible, and how far the linear model may be off.
LINEAR = [
    (selected("tread_error", k=0.01), 0.03),
    (selected("wheel_radius_error", left=0.001, right=0.0), 0.03),
    (selected("terrain_tread", t0=40.0, t1=80.0, tread=0.02, gain=0.005), 0.03),
    (selected("surface_slip", t0=60.0, t1=90.0, left=0.007, right=0.0), 0.03),
    (selected("rotation_centre_offset", a=0.01), 0.03),
    (selected("lateral_slip_turning", k=0.01), 0.05),
    (selected("gyro_scale_error", k=0.001), 0.01),
    (selected("gyro_bias_step", t0=60.0, b=1e-4), 0.01),
    (selected("gyro_warmup", b=2e-4, tau=200.0), 0.01),
    (selected("gyro_lag", tau=0.05), 0.05),
    (selected("gyro_latency", delay=0.02), 0.05),
    (selected("encoder_latency", delay=0.02), 0.15),
]
NAMES = [c.id for c, _ in LINEAR]


@lru_cache
def null_rows(drive: tuple[str, float]) -> tuple[Array, Array]:
    """Of all seeds: whitened rows of the moving wheels, (n,), and of the fixes, (m, 3), less the nuisances."""
    wheels, fixes = [], []
    for seed in range(SEEDS):
        p = problem(drive, seed)
        left, n = refine(p, []).left, len(p.evidence.time_s)
        wheels.append(left[:n][~p.evidence.still])
        fixes.append(left[n:].reshape(-1, 3))
    return np.concatenate(wheels), np.concatenate(fixes)


def in_bounds(rows: Array, projected: float = 0.0) -> bool:
    """Mean square of white rows, by chi-square at 1e-4; `projected`: what the noise model is known to be off."""
    low, high = stats.chi2.ppf([5e-5, 1.0 - 5e-5], len(rows)) / len(rows)
    return bool(low - projected < np.mean(rows**2) < high)


@pytest.mark.parametrize("drive", [WAREHOUSE, SLALOM])
def test_whitened_fixes_without_any_effect_have_unit_variance_and_no_memory(drive: tuple[str, float]) -> None:
    _, fixes = null_rows(drive)
    for column in fixes.T:
        assert in_bounds(column)
        memory = float(column[1:] @ column[:-1]) / float(column @ column)
        assert abs(memory) < 4.0 / np.sqrt(len(column))


@pytest.mark.parametrize("drive", [WAREHOUSE, SLALOM])
def test_whitened_wheels_have_unit_variance_but_at_stops_where_the_model_is_cautious(drive: tuple[str, float]) -> None:
    wheels, _ = null_rows(drive)
    assert in_bounds(wheels, projected=0.2)  # the most of three steps' travel: too large where the speed changes
    memory = float(wheels[1:] @ wheels[:-1]) / float(wheels @ wheels)
    assert abs(memory) < 5.0 / np.sqrt(len(wheels))  # counts' rounding leaves a trace


def test_noise_that_is_drawn_from_the_model_itself_comes_out_white() -> None:
    """The algebra alone: gains, factors and fixes within a step, with a gyro that has a bias."""
    p = problem(SLALOM, 0)
    e, noise, n = p.evidence, p.noise, len(p.evidence.time_s)
    model, rng = Linear(e, p.path, noise), np.random.default_rng(4)
    sensitivities = []
    for _ in range(SEEDS):
        bias = noise.bias_rad_s * rng.standard_normal() + np.cumsum(
            noise.bias_walk_rad_s_per_sqrt_s * np.sqrt(e.step_s) * rng.standard_normal(n)
        )
        gyro = bias * e.step_s + np.sqrt(noise.gyro(e)) * rng.standard_normal(n)
        slip = np.sqrt(noise.slip_m_per_sqrt_m**2 * e.near_travel_m / 2.0 + ~e.still * noise.count_m**2 / 6.0)
        left, right = (slip * rng.standard_normal(n) for _ in range(2))
        sideways = noise.lateral_m_per_sqrt_m * np.sqrt(e.travel_m / 2.0) * rng.standard_normal(n)
        sigma = [noise.position_m, noise.position_m, noise.heading_rad]
        fix = np.array(sigma) * rng.standard_normal((len(e.fix), 3))
        sensitivities.append(Sensitivity(gyro, left, right, sideways, fix))
    rows = model.rows(sensitivities)
    wheels, fixes = rows[:n], rows[n:]
    assert in_bounds(wheels[~e.still].ravel())
    # The path moves by the most of three steps' travel here, the filter's Q by the step's own: nearly the same.
    assert np.mean(fixes**2) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("drive", [WAREHOUSE, SLALOM])
@pytest.mark.parametrize(("missing", "share"), LINEAR, ids=NAMES)
def test_data_less_an_effects_signature_are_the_data_without_it(
    drive: tuple[str, float], missing: Selected, share: float
) -> None:
    exact = Conditions(quantise=False)
    without = Problem(gather(simulated(drive, 3, conditions=exact, nominal=FINE).recording))
    data = gather(simulated(drive, 3, missing, conditions=exact, nominal=FINE).recording)
    added = Problem(data, without.path).data - without.data
    told = without.effect_rows([missing])
    assert np.linalg.norm(added) > 2.0
    assert np.linalg.norm(added - told) < share * np.linalg.norm(added)


def estimates(missing: Selected, seeds: int) -> Array:
    """Of the effect's first linear parameter: error over the sigma that the whitened norm predicts, (seeds,)."""
    name, found = missing.free[0], []
    for seed in range(seeds):
        p = problem(SLALOM, seed, missing)
        fit = refine(p, [replace(missing, free=missing.free[:1])])
        found.append((fit.selection[0].number(name) - missing.number(name)) / fit.selection[0].sigma(name))
    return np.array(found)


@pytest.mark.parametrize(
    "missing",
    [
        selected("tread_error", k=0.01),
        selected("gyro_scale_error", k=0.0007),
        selected("gyro_bias_step", t0=60.0, b=2e-4),
        selected("surface_slip", t0=40.0, t1=80.0, left=0.007, right=0.0),
    ],
    ids=lambda c: c.id,
)
def test_an_estimate_scatters_as_its_signatures_norm_predicts(missing: Selected) -> None:
    z = estimates(missing, 16)
    low, high = stats.chi2.ppf([1e-4, 1.0 - 1e-4], len(z))
    assert low < float(z @ z) < high


@pytest.mark.parametrize("drive", [WAREHOUSE, SLALOM])
@pytest.mark.parametrize("conditions", [LATE_5_MS, ASIDE_4_CM], ids=["late by 5 ms", "4 cm aside"])
def test_a_late_or_sideways_reference_leaves_the_residual_as_it_was(
    drive: tuple[str, float], conditions: Conditions
) -> None:
    bad, good = (refine(problem(drive, 6, conditions=c), []) for c in (conditions, None))
    mean_squares = [float(np.mean(f.left**2)) for f in (bad, good)]
    assert mean_squares[0] == pytest.approx(mean_squares[1], abs=0.01)
    moved = bad.nuisance - good.nuisance
    expected = [0.5, 0.0, 0.0] if conditions is LATE_5_MS else [0.0, 0.0, 0.8]  # 5 of 10 ms, 4 of 5 cm
    np.testing.assert_allclose(moved, expected, atol=0.1)


@pytest.mark.parametrize("drive", [WAREHOUSE, SLALOM])
def test_perfect_sensors_of_the_nominal_robot_give_no_effect_any_weight(drive: tuple[str, float]) -> None:
    p = Problem(gather(simulated(drive, 3, conditions=PERFECT, nominal=FINE).recording))
    library, left = Library(p), refine(p, []).left
    norm = np.sqrt(np.maximum(np.diag(library.products), 1e-12))
    z = np.abs(library.columns.T @ left.astype(np.float32)) / norm
    assert z.max() < 1.0


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_noise_of_other_sizes_whitens_as_if_it_had_been_there_from_the_start(factor: float) -> None:
    p, delayed = problem(WAREHOUSE, 3), selected("encoder_latency", delay=0.02)
    p.around([delayed])  # its gains are kept
    noise = scaled(p.noise, factor, WHEELS)
    again = p.with_noise(noise, p.fix_inflation, p.inflation)
    fresh = Problem(p.evidence, p.path, noise, p.fix_inflation, inflation=p.inflation)
    np.testing.assert_array_equal(again.data, fresh.data)
    np.testing.assert_array_equal(again.around([delayed]).data, fresh.around([delayed]).data)
    assert np.array_equal(again.data, p.data) == (factor == 1.0)


def test_causes_are_whitened_beside_each_other_as_alone() -> None:
    p = problem(SLALOM, 0)
    of_effects = [p.sensitivity(c.effect, c.values) for c, _ in LINEAR]
    causes = [*(s for _, _, s in p.nuisances), *of_effects, p.linear.data()]
    alone = np.column_stack([p.whiten([s]) for s in causes])
    np.testing.assert_allclose(p.whiten(causes), alone, rtol=0.0, atol=1e-9 * np.abs(alone).max())
