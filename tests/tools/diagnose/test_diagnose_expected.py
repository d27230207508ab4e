"""Effects that a recording is expected to have, since others of its robot have them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import SLALOM, problem, selected
from diagnosis_results import seeing, tread
from diagnosis_runs import SCALE, written
from msgspec.structs import replace
from scipy import stats

from drd_tools.diagnose.combine.expected import Expected, expected
from drd_tools.diagnose.combine.pool import combined
from drd_tools.diagnose.combine.statistics import SufficientStatistics, sufficient_statistics
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.results import Result
from drd_tools.diagnose.run import run_all
from drd_tools.recordings.daemon_log import read

K, STD = 0.02, 0.008  # of a tread that a recording shows with 2.5 sigma: alone that is nothing
SHORT_S = 15.0  # shows the gyro's scale with 3 to 4 sigma: alone that is nothing
TREAD = selected("tread_error", k=1.0)


def statistics(k: float) -> SufficientStatistics:
    """A recording that knows a tread to STD, and sees `k`."""
    p = problem(SLALOM, 0)
    row = p.effect_rows([TREAD])
    p = p.with_data(k * row)
    made = sufficient_statistics(p, refine(p, ()))
    i = made.names.index(("tread_error", "k"))
    scale = 1.0 / (STD**2 * made.G[i, i])
    return SufficientStatistics(made.names, scale * made.G, scale * made.b, made.rows, made.ranges, made.span_s)


def others(folder: Path, *values: float) -> list[Result]:
    return [replace(seeing(folder, 0.001, tread(k)), recording=f"{i}") for i, k in enumerate(values)]


def told(results: Sequence[Result], k: float, *of_others: float) -> tuple[Expected, ...]:
    """Effects that the last of these recordings is expected to have, where it sees `k`, and those before it so much."""
    shown = [statistics(other) for other in of_others] or [statistics(K)] * (len(results) - 1)
    return expected(results, [*shown, statistics(k)])[-1]


def test_what_others_have_and_the_data_bear_out_is_expected(tmp_path: Path) -> None:
    blind = seeing(tmp_path, 1.0)
    (found,) = told([*others(tmp_path, K, K, K), blind], K)
    assert found.selected.id == "tread_error"
    assert found.selected.prior["k"] == pytest.approx((K, 0.002 / np.sqrt(3.0)))
    assert found.others == 3
    assert found.odds == pytest.approx(4.0 * found.bayes_factor)
    assert told([*others(tmp_path, K, K, K), blind], 0.0) == ()
    assert told([*others(tmp_path, K), blind], K) == ()


def test_others_whose_data_speak_against_it_are_counted_and_those_that_tell_nothing_are_not(tmp_path: Path) -> None:
    without = seeing(tmp_path, 1.0)
    (alone,) = told([*others(tmp_path, K, K), without], 1.8 * K)
    for shown, factor in ((-K, 0.5), (0.5 * K, 1.0)):
        (found,) = told([*others(tmp_path, K, K), without, without], 1.8 * K, K, K, shown)
        assert found.odds == pytest.approx(factor * alone.odds)
    assert told([*others(tmp_path, K, K), without, without, without], 1.8 * K, K, K, -K, -K) == ()


def test_the_bayes_factor_is_the_ratio_of_marginal_likelihoods() -> None:
    G, b, mean, std = 1.0 / STD**2, 0.7 * K / STD**2, K, 0.003
    k = np.linspace(mean - 8.0 * std, mean + 8.0 * std, 20001)
    integral = np.trapezoid(stats.norm.pdf(k, mean, std) * np.exp(b * k - 0.5 * G * k**2), k)
    seen = SufficientStatistics((("tread_error", "k"),), np.array([[G]]), np.array([b]), 100, {}, (0.0, 1.0))
    assert seen.log_bayes_factor("tread_error", {"k": (mean, std)}) == pytest.approx(np.log(integral), rel=1e-6)


def test_a_short_drive_of_a_robot_is_told_with_the_names_of_the_long_ones(tmp_path: Path) -> None:
    drives = (("a", ("slalom", 60.0), 1), ("b", ("slalom", 60.0), 2), ("short", ("slalom", SHORT_S), 3))
    recordings = [read(written(tmp_path / name, SCALE, drive=drive, seed=seed)) for name, drive, seed in drives]
    *each, whole = (w.diagnosis for w in run_all(recordings, [], tmp_path / "out", 1, "a, b, short"))
    assert [f.effect for d in each for f in d.findings] == 3 * ["gyro_scale_error"]
    finding = each[-1].findings[0]
    assert finding.evidence.prior_odds == pytest.approx(3.0)
    assert "2 other recordings show it" in finding.sentence
    # Their own values are not counted twice.
    two = combined([d.result for d in each[:2]], [d.statistics for d in each[:2] if d.statistics is not None])
    assert whole.findings[0].parameters == two.findings[0].parameters
    (alone,) = run_all(recordings[-1:], [], tmp_path / "alone", 1, "short")
    assert alone.diagnosis.findings == ()
