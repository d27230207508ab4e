"""Figures of merit: known answers, and the same answers wherever the two trajectories lie."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pose_files import dead_reckoned, drive, estimate_of, integrate, moved

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd_tools.evaluate.alignment import KINDS, align
from drd_tools.evaluate.growth import binned, error_growth
from drd_tools.evaluate.heading import heading_drift
from drd_tools.evaluate.judge import judge
from drd_tools.evaluate.metrics import kitti_drift
from drd_tools.evaluate.results import Run
from drd_tools.evaluate.text import main_figures
from drd_tools.evaluate.trajectory import Poses, Reference, associate
from drd_tools.recordings.path_length import path_length_m

ANGLE = st.floats(-20.0, 20.0)
SHIFT = st.floats(-1e3, 1e3)


def all_figures(run: Run) -> list[float]:
    nees = [n.average for n in run.consistency.nees]
    lengths = [v for r in run.by_length + run.by_time for v in (r.position_rmse_m, r.heading_rmse_deg)]
    known = [-1.0 if v is None else v for v in main_figures(run)]
    return [*known, run.end.along_m, run.end.cross_m, run.end.heading_deg, *nees, *lengths]


@pytest.mark.parametrize("kind", KINDS)
@given(x_m=SHIFT, y_m=SHIFT, turn_rad=ANGLE, seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=8)
def test_figures_do_not_depend_on_where_both_trajectories_lie(
    kind: str, x_m: float, y_m: float, turn_rad: float, seed: int
) -> None:
    estimate, reference = dead_reckoned(np.random.default_rng(seed), rows=200)
    assert estimate.covariance is not None
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    T = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    elsewhere = judge(
        replace(estimate, pose=moved(estimate.pose, x_m, y_m, turn_rad), covariance=T @ estimate.covariance @ T.T),
        replace(reference, pose=moved(reference.pose, x_m, y_m, turn_rad)),
        kind=kind,
        metres=5.0,
    )
    here = judge(estimate, reference, kind=kind, metres=5.0)
    assert all_figures(elsewhere) == pytest.approx(all_figures(here), rel=1e-6, abs=1e-7)


@given(x_m=SHIFT, y_m=SHIFT, turn_rad=ANGLE)
@settings(deadline=None, max_examples=20)
def test_an_alignment_takes_off_any_rigid_motion_of_the_estimate(x_m: float, y_m: float, turn_rad: float) -> None:
    reference = drive(30.0)
    pairs = associate(estimate_of(reference, pose=moved(reference.pose, x_m, y_m, turn_rad)), reference, 1.0)
    for kind in ("start", "se2", "first-metres"):
        aligned, found = align(pairs, kind, 10.0)
        error = aligned.error - 2.0 * math.pi * np.round(aligned.error[0] / (2.0 * math.pi)) * (0.0, 0.0, 1.0)
        assert np.abs(error).max() < 1e-8
        assert math.cos(math.radians(found.rotation_deg) + turn_rad) == pytest.approx(1.0)


def test_a_scale_error_is_its_own_drift_in_per_cent() -> None:
    reference = drive(300.0, rate_rad_s=0.0)
    run = judge(estimate_of(reference, pose=reference.pose * (1.02, 1.02, 1.0)), reference)
    assert run.drift is not None
    assert run.drift.percent == pytest.approx(2.0, rel=1e-6)
    assert run.drift.deg_per_m == pytest.approx(0.0, abs=1e-9)
    assert run.end.along_m == pytest.approx(0.02 * 240.0, rel=1e-6)
    assert [round(r.size / run.path_m, 3) for r in run.by_length] == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]


@given(deg_per_h=st.floats(-500.0, 500.0), seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=20)
def test_a_constant_heading_drift_is_recovered(deg_per_h: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time_s = np.sort(rng.uniform(0.0, 600.0, 2000))
    error = math.radians(deg_per_h) * time_s / 3600.0
    error[rng.integers(0, 2000, 20)] += math.radians(30.0)  # jumps of the reference
    found = heading_drift(time_s, error)
    assert found.deg_per_h == pytest.approx(deg_per_h, abs=8.0)
    exact = heading_drift(time_s, math.radians(deg_per_h) * time_s / 3600.0)
    assert exact.deg_per_h == pytest.approx(deg_per_h, abs=1e-6)


def test_the_drifts_interval_holds_the_true_drift_under_a_random_walk_and_noise() -> None:
    time_s = np.arange(0.0, 600.0, 0.1)
    hits = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        walk = np.cumsum(rng.normal(0.0, 1e-3 * math.sqrt(0.1), len(time_s)))
        found = heading_drift(time_s, 1e-4 * time_s + walk + rng.normal(0.0, 2e-3, len(time_s)), seed)
        assert found.low_deg_per_h is not None
        assert found.high_deg_per_h is not None
        hits += found.low_deg_per_h <= math.degrees(1e-4) * 3600.0 <= found.high_deg_per_h
    assert hits >= 85


def test_return_error_is_only_for_closed_paths() -> None:
    time_s = np.arange(0.0, 100.05, 0.1)
    heading = 2.0 * math.pi * time_s / 100.0
    circle = Reference("circle", time_s, np.column_stack([integrate(time_s, heading, 0.5), heading]))
    xy = integrate(time_s, 1.01 * heading, 0.5)
    run = judge(Poses("estimate", time_s, np.column_stack([xy, 1.01 * heading])), circle, kind="se2")
    assert run.end.return_m == pytest.approx(math.hypot(*(xy[-1] - circle.pose[-1, :2])), rel=1e-6)
    assert run.end.return_heading_deg == pytest.approx(3.6, abs=1e-6)
    assert run.end.position_m < 0.9 * math.hypot(*(xy[-1] - circle.pose[-1, :2]))
    assert judge(estimate_of(drive()), drive()).end.return_m is None


def test_association_neither_extrapolates_nor_bridges_gaps() -> None:
    reference = drive(60.0)
    kept = (reference.time_s > 5.0) & (reference.time_s < 50.0) & ~((reference.time_s > 20.0) & (reference.time_s < 25))
    estimate = estimate_of(reference, time_s=reference.time_s[kept], pose=reference.pose[kept])
    pairs = associate(estimate, reference, 1.0)
    assert not ((pairs.time_s > 20.05) & (pairs.time_s < 24.95)).any()
    assert pairs.time_s[0] == estimate.time_s[0]
    assert len(pairs.time_s) + pairs.outside + pairs.in_gaps == len(reference.time_s)
    with pytest.raises(ConfigError, match="2 times in common"):
        associate(estimate_of(reference, time_s=reference.time_s + 100.0), reference, 1.0)


def test_interpolation_is_exact_on_straights_and_goes_through_whole_turns() -> None:
    time_s = np.arange(0.0, 10.0, 1.0)
    pose = np.column_stack([time_s, -time_s, 3.0 * time_s])
    reference = Reference("r", time_s[:-1] + 0.25, pose[:-1] + np.array((0.25, -0.25, 0.75)))
    pairs = associate(Poses("e", time_s, pose), reference, 1.0)
    assert np.abs(pairs.error).max() < 1e-12


def test_a_sparse_reference_gives_the_end_but_no_drift() -> None:
    reference = drive(600.0)
    ends = replace(reference, time_s=reference.time_s[[0, -1]], pose=reference.pose[[0, -1]])
    run = judge(estimate_of(reference), ends)
    assert run.drift is None
    assert run.path_m == pytest.approx(480.0)
    assert run.windows.why_not
    assert run.heading.low_deg_per_h is None
    each_minute = replace(reference, time_s=reference.time_s[::600], pose=reference.pose[::600])
    run = judge(estimate_of(reference), each_minute)
    assert run.drift is not None
    assert 0 < run.drift.segments < 60
    assert run.drift.percent == pytest.approx(0.0, abs=1e-9)


def test_the_references_noise_does_not_lengthen_the_path() -> None:
    rng = np.random.default_rng(1)
    x_m = np.concatenate([np.zeros(1000), np.arange(0.0, 50.0, 0.02)])
    xy_m = np.column_stack([x_m, np.zeros_like(x_m)]) + rng.normal(0.0, 0.01, (len(x_m), 2))
    assert path_length_m(xy_m, 0.01)[-1] == pytest.approx(50.0, rel=0.02)
    assert path_length_m(xy_m, 0.05)[-1] == pytest.approx(50.0, rel=0.02)  # a sigma that holds an offset
    assert path_length_m(xy_m, 0.0)[-1] > 80.0


def test_a_robot_that_stands_has_no_drift_in_per_cent() -> None:
    time_s = np.arange(0.0, 60.0, 0.1)
    still = Reference("still", time_s, np.zeros((len(time_s), 3)))
    run = judge(estimate_of(still), still)
    assert run.drift is None
    assert run.end.share_of_path is None
    with pytest.raises(ConfigError, match="fix a rotation"):
        judge(estimate_of(still), still, kind="se2")


def test_growth_finds_the_scale_error_by_rate_and_not_what_had_piled_up() -> None:
    reference = drive(600.0)
    scaled = 1.01 * reference.pose[:, 2] + 3.0  # and far off from the start
    pose = np.column_stack([integrate(reference.time_s, scaled, 0.8), scaled])
    warm = replace(reference, temperature=(reference.time_s, 20.0 + reference.time_s / 100.0))
    windows = error_growth(associate(estimate_of(reference, pose=pose), reference, 1.0), warm)
    means = binned(windows.rate_deg_s, windows.heading_deg_s)
    assert np.polyfit(means[:, 0], means[:, 1], 1)[0] == pytest.approx(0.01 / 1.01, rel=1e-3)
    assert (means[:, 3] >= 5).all()
    assert means[:, 3].sum() == len(windows.rate_deg_s)
    assert windows.temperature_c is not None
    assert windows.temperature_c[[0, -1]] == pytest.approx((20.01, 25.99), abs=0.02)


@given(scale=st.floats(0.9, 1.1), seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=10)
def test_kitti_drift_does_not_see_where_the_error_was_made(scale: float, seed: int) -> None:
    """Errors are those of each segment: a heading that is off before a segment costs it nothing."""
    reference = drive(120.0, rate_rad_s=0.0)
    kink = np.random.default_rng(seed).integers(100, 1000)
    pose: Array = reference.pose * (scale, scale, 1.0)
    pose[kink:] = pose[kink] + moved(pose[kink:] - pose[kink], 0.0, 0.0, 1.0)
    drift, _ = kitti_drift(associate(estimate_of(reference, pose=pose), reference, 1.0))
    assert drift is not None
    assert drift.percent >= 100.0 * abs(scale - 1.0) - 1e-6
    assert drift.percent < 100.0  # were the kink's metres counted later too, long segments would exceed it
