"""NEES: honest estimates keep its bounds, boasting ones do not, over many seeds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pose_files import dead_reckoned, drive

from drd_tools.evaluate.alignment import align
from drd_tools.evaluate.consistency import Consistency, Nees, consistency, effective_rows, nees, together
from drd_tools.evaluate.judge import judge
from drd_tools.evaluate.text import sentences
from drd_tools.evaluate.trajectory import MAX_GAP_S, Poses, Reference, associate

SEEDS = 60


def judged(estimate: Poses, reference: Reference, kind: str = "start") -> Consistency:
    aligned, alignment = align(associate(estimate, reference, MAX_GAP_S), kind, 3.0)
    return consistency(aligned, alignment, reference)


def pose_nees(seed: int, claim: float) -> Nees:
    found = judged(*dead_reckoned(np.random.default_rng(seed), claim))
    assert [n.part for n in found.nees] == ["pose", "position", "heading"]
    return found.nees[0]


def test_consistent_errors_are_called_so_one_by_one_and_together() -> None:
    parts = [pose_nees(seed, 1.0) for seed in range(SEEDS)]
    wrong = [n for n in parts if n.verdict != "consistent"]
    assert len(wrong) <= 5  # 1 % is meant; the effective number of rows is an estimate too
    pooled = together(parts)
    assert pooled.verdict == "consistent"
    assert pooled.low < 3.0 < pooled.high
    assert pooled.high - pooled.low < 2.0


def test_what_was_claimed_before_a_late_reference_is_told() -> None:
    estimate, reference = dead_reckoned(np.random.default_rng(1))
    assert judged(estimate, reference).before is None
    half = len(reference.time_s) // 2
    late = replace(reference, time_s=reference.time_s[half:], pose=reference.pose[half:])
    assert estimate.covariance is not None
    xx, xy, yy, hh = (float(estimate.covariance[half, i, j]) for i, j in ((0, 0), (0, 1), (1, 1), (2, 2)))
    worst_m = np.sqrt(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy))
    assert judged(estimate, late).before == pytest.approx((worst_m, np.sqrt(hh)), rel=0.05)
    assert judged(estimate, late, "none").before is None
    (told,) = (s for s in sentences(judge(estimate, late)) if "before the first common time" in s)
    assert f"{np.degrees(np.sqrt(hh)):.2g} deg (1 sigma)" in told


def test_overconfidence_and_caution_are_told() -> None:
    bold = [pose_nees(seed, 0.2) for seed in range(SEEDS)]
    assert sum(n.verdict == "overconfident" for n in bold) >= 0.8 * SEEDS
    assert together(bold).verdict == "overconfident"
    assert together([pose_nees(seed, 4.0) for seed in range(20)]).verdict == "too cautious"


def test_the_references_own_noise_counts() -> None:
    """With a perfect estimate all of the error is the reference's, and that of its first row in every one."""
    parts = []
    for seed in range(SEEDS):
        _, reference = dead_reckoned(np.random.default_rng(seed))
        perfect = Poses("perfect", reference.time_s, drive(60.0).pose, np.zeros((len(reference.time_s), 3, 3)))
        parts += judged(perfect, reference).nees[:1]
    assert together(parts).verdict == "consistent"
    assert sum(n.verdict == "consistent" for n in parts) >= 0.9 * SEEDS


@pytest.mark.parametrize("size", [1.0, 1e6, 1e80])
def test_only_rows_whose_covariance_has_no_inverse_are_left_out(size: float) -> None:
    """An estimate that has run away is told as what it is, and nothing raised."""
    estimate, reference = dead_reckoned(np.random.default_rng(1))
    aligned, alignment = align(associate(estimate, reference, MAX_GAP_S), "none", 3.0)
    assert aligned.covariance is not None
    units = np.array([size, size, 1.0])
    covariance = aligned.covariance * units[:, None] * units
    together = units * np.random.default_rng(2).uniform(0.1, 1.0, (len(covariance), 3))
    covariance[::2] = (together[:, :, None] * together[:, None])[::2]  # their least eigenvalue is rounding
    exact = replace(reference, position_sigma_m=0.0, heading_sigma_rad=0.0)
    pose, position, heading = consistency(replace(aligned, covariance=covariance), alignment, exact).nees
    assert pose.rows == position.rows == pytest.approx(0.5 * len(covariance), abs=2)
    assert heading.rows == pytest.approx(len(covariance), abs=2)


@pytest.mark.parametrize("kind", ["se2", "first-metres"])
def test_an_alignment_that_uses_the_errors_has_no_nees(kind: str) -> None:
    estimate, reference = dead_reckoned(np.random.default_rng(1))
    found = judged(estimate, reference, kind)
    assert not found.nees
    assert "not meaningful" in found.why_not
    assert found.inside_99 is None


def test_share_inside_the_claimed_radius() -> None:
    shares = []
    for seed in range(20):
        estimate, reference = dead_reckoned(np.random.default_rng(seed))
        shares.append(judged(estimate, reference).inside_99)
        given = replace(estimate, covariance=None, bound_m=np.full(len(estimate.time_s), 1e-6))
        perfect = replace(reference, position_sigma_m=0.0, heading_sigma_rad=0.0)
        found = judged(given, perfect)
        assert found.inside_99 is not None
        assert found.inside_99 < 0.1
        assert "no covariance" in found.why_not
    assert np.mean([s for s in shares if s is not None]) > 0.97


def test_independent_rows_count_in_full_and_a_constant_counts_once() -> None:
    rng = np.random.default_rng(0)
    white = np.median([effective_rows(1.2 * rng.normal(size=(1000, 3))) for _ in range(20)])
    assert 700.0 < white <= 1000.0
    assert effective_rows(np.ones((500, 2))) == pytest.approx(1.0)
    assert effective_rows(0.01 * rng.normal(size=(1000, 3))) < 1.1  # the rest may be a constant
    correlated = np.zeros((20000, 1))
    for k in range(1, len(correlated)):
        correlated[k] = 0.95 * correlated[k - 1] + rng.normal()
    expected = 20000 * (1.0 - 0.95**2) / (1.0 + 0.95**2)  # of an AR(1), for squares
    assert effective_rows(correlated) == pytest.approx(expected, rel=0.35)


@given(scale=st.floats(1.0, 10.0), seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=30)
def test_nees_scales_with_the_square_of_the_error_and_its_bounds_do_not(scale: float, seed: int) -> None:
    error = np.cumsum(np.random.default_rng(seed).normal(size=(300, 2)), axis=0)
    S = np.broadcast_to(1e-4 * np.array([[2.0, 0.5], [0.5, 1.0]]), (300, 2, 2))
    once, scaled = nees("position", error, S), nees("position", scale * error, S)
    assert scaled.average == pytest.approx(scale**2 * once.average, rel=1e-9)
    assert (scaled.low, scaled.high) == pytest.approx((once.low, once.high), rel=1e-6)
    assert 1.0 <= once.effective <= 300.0
