"""The statistics behind `drd compare`: noise as selected, shares of the right covariate, nothing where nothing is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from replay_folders import long_drive

from drd.arrays import Array
from drd_tools.compare.blocks import Blocks, cut
from drd_tools.compare.covariates import Covariate, covariates_of
from drd_tools.compare.mismatch import KINDS, Standstill, kinds_of, mismatches
from drd_tools.compare.noise import Expected, _fast, draw, expected
from drd_tools.compare.shares import Share, curve, shares, whitened
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.error_model.nominal_path import follow
from drd_tools.diagnose.error_model.path import Path as Poses
from drd_tools.diagnose.observe.evidence import Evidence, gather

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Evidence, Poses]:
    e = gather(long_drive(tmp_path_factory.mktemp("compare")))
    sheet = replace(e.datasheet, position_m=0.01, heading_rad=0.003)
    e = replace(e, datasheet=sheet)
    return e, follow(e)


def ramp(blocks: int, knots: int = 6) -> Covariate:
    at = np.linspace(0.0, 1.0, knots)
    x = np.linspace(0.0, 1.0, blocks)
    return Covariate("x", "m", at, np.column_stack([np.interp(x, at, row) for row in np.eye(knots)]))


def white(blocks: int, sigma: float = 1.0) -> Expected:
    return Expected(sigma**2 * np.eye(blocks), np.zeros((blocks, 0)), blocks)


def judge(y: Array, covariates: list[Covariate], sigma: float = 1.0) -> list[Share]:
    return shares([whitened(y, white(len(y), sigma))], covariates, flips=199)[0]


@settings(deadline=None, max_examples=10)
@given(SEEDS)
def test_a_curve_of_a_driver_is_found_and_measured(seed: int) -> None:
    rng = np.random.default_rng(seed)
    covariate, n = ramp(80), 80
    other = Covariate("other", "m", covariate.knots, covariate.design[rng.permutation(n)])
    truth = rng.choice((-1.0, 1.0)) * 6.0 * (covariate.knots - 0.5)
    y = covariate.design @ truth + rng.standard_normal(n)
    found, wrong = judge(y, [covariate, other])
    assert found.p <= 0.01
    assert found.as_good
    assert 0.4 < found.share < 0.95
    assert 0.55 < found.left < 1.75  # chi-squared over 80, at five sigma
    assert not wrong.as_good
    assert wrong.share < 0.3
    fitted = curve(whitened(y, white(n)), covariate, found.left)
    assert np.all(np.abs(fitted.value - truth) < 5.5 * fitted.sigma)


def test_noise_is_named_as_rarely_as_stated() -> None:
    # Heavy tails, and 30 % larger than the sheet says.
    rng = np.random.default_rng(3)
    y = 1.3 * rng.standard_t(4, (100, 40)) / np.sqrt(2.0)
    false = sum(judge(row, [ramp(40), ramp(40, 4)])[0].p <= 0.05 for row in y)
    assert false <= 11  # of 100; 5 are to be expected


@settings(deadline=None, max_examples=10)
@given(SEEDS, st.floats(1e-6, 1e6))
def test_shares_do_not_depend_on_the_unit(seed: int, factor: float) -> None:
    y = np.random.default_rng(seed).standard_normal(40)
    one, other = judge(y, [ramp(40)])[0], judge(factor * y, [ramp(40)], factor)[0]
    assert other.share == pytest.approx(one.share, abs=1e-6)
    assert other.left == pytest.approx(one.left, rel=1e-6)


def test_what_the_reference_does_is_taken_off_and_no_mismatch() -> None:
    rng = np.random.default_rng(5)
    n = 60
    late = rng.standard_normal((n, 1)) * 5.0
    noise = Expected(np.eye(n), late, n)
    y = late[:, 0] * 1.5 + rng.standard_normal(n)
    values, covariance = noise.fit_reference(y)
    assert values[0] == pytest.approx(1.5, abs=5.0 * covariance[0, 0] ** 0.5)
    assert np.sqrt(np.mean(whitened(y, noise).y ** 2)) < 1.3


def test_long_rests_do_not_make_the_noise_in_motion_larger() -> None:
    # 12 of 20 blocks stand, where a draw leaves a hundredth of the noise: less than datasheets and constant allow for.
    q = np.where(np.arange(20) < 12, 0.0, np.linspace(1e-6, 4e-6, 20))
    moves = q > 0.0
    for seed in range(6):
        draws = np.random.default_rng(seed).standard_normal((12, 20)) * np.sqrt(3.0 * q + 1e-10)
        ratio = np.diag(_fast(draws, q))[moves] / (3.0 * q[moves])
        # The mean over all blocks is right, those at rest being allowed more: of 20 blocks 8 move.
        assert ratio == pytest.approx(np.full(moves.sum(), 8 / 20), abs=0.15)


def test_nominal_recordings_have_the_noise_that_is_expected_of_them(drive: tuple[Evidence, Poses]) -> None:
    e, path = drive
    blocks = cut(e)
    noise = expected(e, path, blocks, Standstill(0.0, 1e12), seed=1)
    assert set(noise) == {kind.id for kind in KINDS}
    rng = np.random.default_rng(2)
    squares: dict[str, list[float]] = {name: [] for name in noise}
    for _ in range(6):
        drawn = draw(e, path, rng)
        found = mismatches(drawn, follow(drawn), Sensitivity(), 0.0)
        for name, channel in noise.items():
            squares[name].append(float(np.mean(whitened(blocks.means(found[name]), channel).y ** 2)))
    for name, values in squares.items():
        assert 0.65 < np.sqrt(np.mean(values)) < 1.15, name


def test_a_perfect_drive_has_no_mismatch(drive: tuple[Evidence, Poses]) -> None:
    e, path = drive
    turned, rolled = np.radians(0.02), 1e-4
    for name, steps in mismatches(e, path, Sensitivity(), np.radians(0.05)).items():
        is_angle = next(k for k in KINDS if k.id == name).angle
        assert np.abs(np.cumsum(steps)).max() < (10.0 * turned if is_angle else 30.0 * rolled), name


def test_blocks_hold_every_step_once(drive: tuple[Evidence, Poses]) -> None:
    e, _ = drive
    blocks = cut(e)
    assert blocks.duration_s.sum() == pytest.approx(e.step_s.sum())
    assert blocks.sums(e.left_m).sum() == pytest.approx(e.left_m.sum())
    assert np.all(np.diff(blocks.time_s) > 0.0)
    assert blocks.duration_s.min() > 0.4 * blocks.length_s


def test_a_design_shares_out_all_of_the_time(drive: tuple[Evidence, Poses]) -> None:
    e, path = drive
    found = {d.name: d for d in covariates_of(e, path, cut(e))}
    assert {"time", "yaw rate", "speed", "heading", "place"} <= set(found)
    assert "temperature" not in found
    for covariate in found.values():
        np.testing.assert_allclose(covariate.design.sum(axis=1), 1.0, atol=1e-9)
        assert covariate.design.sum(axis=0).min() > 0.4


def test_gaps_make_blocks_shorter_but_rates_stay(drive: tuple[Evidence, Poses]) -> None:
    e, _ = drive
    kept = (e.time_s < 40.0) | (e.time_s > 47.0)
    thinned = replace(
        e,
        time_s=e.time_s[kept],
        step_s=e.step_s[kept],
        gyro_rad=None,
        left_m=e.left_m[kept],
        right_m=e.right_m[kept],
        fix=e.fix[:0],
        fix_step=e.fix_step[:0],
        fix_share=e.fix_share[:0],
    )
    blocks = cut(thinned)
    np.testing.assert_allclose(blocks.means(2.0 * thinned.step_s), 2.0)


def test_channels_follow_from_what_was_recorded(drive: tuple[Evidence, Poses]) -> None:
    e, _ = drive
    no_fix = {"fix": e.fix[:0], "fix_step": e.fix_step[:0], "fix_share": e.fix_share[:0]}
    assert [k.id for k in kinds_of(replace(e, **no_fix))] == ["wheels_gyro"]  # type: ignore[arg-type]
    assert kinds_of(replace(e, gyro_rad=None, **no_fix)) == []  # type: ignore[arg-type]
    assert "gyro" not in {k.id for k in kinds_of(replace(e, gyro_rad=None))}


def test_means_are_sums_over_durations() -> None:
    blocks = Blocks(2.0, np.array([0, 0, 1]), np.array([2.0, 1.0]), np.array([1.0, 2.5]))
    np.testing.assert_allclose(blocks.means(np.array([1.0, 3.0, 5.0])), [2.0, 5.0])
