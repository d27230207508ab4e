"""What several recordings show together, though none shows it alone."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import SLALOM, problem, selected
from diagnosis_results import seeing, tread
from msgspec.structs import replace as replace_result

from drd_tools.diagnose.combine import joint
from drd_tools.diagnose.combine.pool import combined
from drd_tools.diagnose.combine.statistics import SufficientStatistics, shared, sufficient_statistics
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.results import Amount, Finding, Status, Support
from drd_tools.diagnose.selected import Selected

TREAD = selected("tread_error", k=1.0)
D = 3.5  # visibility in each recording: 6 nats, where 8 are asked for


@lru_cache
def drive() -> Problem:
    return problem(SLALOM, 0)


def part(size: float, seed: int) -> SufficientStatistics:
    """A recording of white noise, and the effect so visible."""
    p = drive()
    row = p.effect_rows([TREAD])
    p = p.with_data(np.random.default_rng(seed).standard_normal(len(row)) + size * row / np.linalg.norm(row))
    return sufficient_statistics(p, refine(p, ()))


def together(parts: Sequence[SufficientStatistics], selected: set[str]) -> list[Finding]:
    return joint.together(parts, selected).findings


def test_effects_with_a_shape_or_an_origin_of_their_own_are_not_shared() -> None:
    names = {effect.id for effect in shared()}
    assert {"tread_error", "wheel_radius_error", "gyro_scale_error"} <= names
    assert not {"gyro_bias_temperature", "gyro_warmup", "surface_slip", "gyro_latency", "gyro_deadband"} & names


def test_weak_in_each_is_found_in_all() -> None:
    true_k = D / np.linalg.norm(drive().effect_rows([TREAD]))
    assert together([part(0.5 * D, 0), part(0.5 * D, 1)], set()) == []
    (found,) = together([part(D, seed) for seed in range(10)], set())
    assert "tread_error" in (found.effect, *found.also_fits)
    assert found.status == "confirmed"
    assert found.evidence.gain_nats == pytest.approx(0.5 * 10 * D**2, rel=0.5)
    if found.effect == "tread_error":
        k = found.parameters["k"]
        assert k.value == pytest.approx(true_k, abs=4.0 * k.std)
        assert k.std < 0.5 * true_k


def test_a_recording_that_shows_an_effect_at_one_value_only_is_no_error() -> None:
    parts = [part(D, seed) for seed in range(10)]
    parts[3] = replace(parts[3], ranges={name: {} for name in parts[3].ranges})
    (found,) = together(parts, set())
    assert found.seen == parts[0].ranges[found.effect]


def test_what_a_recording_claims_itself_is_not_found_again() -> None:
    parts = [part(D, seed) for seed in range(10)]
    (found,) = together(parts, set())
    again = together(parts, {found.effect, *found.also_fits})
    assert not {f.effect for f in again} & {found.effect, *found.also_fits}


def test_noise_and_contradictions_are_no_findings() -> None:
    selection = [together([part(0.0, 10 * k + seed) for seed in range(6)], set()) for k in range(20)]
    assert sum(map(bool, selection)) <= 1
    assert together([part((-1.0) ** seed * 3.0 * D, seed) for seed in range(10)], set()) == []


def without(one: SufficientStatistics, *names: str) -> SufficientStatistics:
    """The statistics of a recording that has selected some effects itself."""
    kept = [i for i, (effect, _) in enumerate(one.names) if effect not in names]
    ranges = {effect: seen for effect, seen in one.ranges.items() if effect not in names}
    held = tuple(one.names[i] for i in kept)
    return replace(one, names=held, G=one.G[np.ix_(kept, kept)], b=one.b[kept], ranges=ranges)


def test_what_one_recording_claims_itself_is_found_in_the_others() -> None:
    """One drive's chance name hides from none of the others what they have in common."""
    parts = [part(D, seed) for seed in range(10)]
    (found,) = together(parts, set())
    parts[4] = without(parts[4], found.effect, *found.also_fits)
    (again,) = together(parts, set())
    assert again.effect == found.effect
    assert again.gain_nats == pytest.approx(0.9 * found.gain_nats, rel=0.2)
    mostly = [without(one, found.effect, *found.also_fits) if i < 6 else one for i, one in enumerate(parts)]
    assert together(mostly, set()) == []


def test_a_name_that_is_withdrawn_may_be_what_all_have_in_common(tmp_path: Path) -> None:
    """One drive's tread of 0.5 is withdrawn, as nine others speak against it; what all of them show is not."""
    alone = seeing(tmp_path, 0.001, tread(0.5))
    results = [alone, *(replace_result(seeing(tmp_path, 0.01), recording=f"drive {i}") for i in range(9))]
    parts = [part(2.0 * D, seed) for seed in range(10)]
    (found,) = combined(results, [without(parts[0], "tread_error", "turn_scrub"), *parts[1:]]).findings
    assert (found.effect, found.status) == ("tread_error", "confirmed")
    k = found.parameters["k"]
    assert k.value == pytest.approx(2.0 * D / np.linalg.norm(drive().effect_rows([TREAD])), abs=4.0 * k.std)


def test_values_of_several_effects_are_each_beside_all_others() -> None:
    p = drive()
    both = (selected("tread_error", k=0.02), selected("turn_scrub", k=0.06))
    rows = p.effect_rows(both)
    parts = []
    for seed in range(10):
        data = p.with_data(rows + np.random.default_rng(seed).standard_normal(len(rows)))
        parts.append(sufficient_statistics(data, refine(data, ())))
    found = {f.effect: f.parameters["k"] for f in together(parts, set())}
    assert set(found) == {"tread_error", "turn_scrub"}
    for one in both:
        amount = found[one.id]
        assert amount.value == pytest.approx(one.number("k"), abs=4.0 * amount.std)


BUMPS = selected("bump_counts", travel_per_m=0.004)
RADII = selected("wheel_radius_error", left=-0.004, right=-0.004)


def part_that_found(found: Selected, true: Selected, seed: int) -> SufficientStatistics:
    """A recording with a true effect, and another that it has found by itself."""
    p = drive()
    p = p.with_data(np.random.default_rng(seed).standard_normal(len(p.data)) + p.effect_rows([true]))
    return sufficient_statistics(p, refine(p, [found]), [found.id])


def test_what_each_has_found_by_itself_may_stand_for_what_all_have_in_common() -> None:
    """Bumps on every drive, and of one size, are a radius; on one drive they are bumps."""
    alike = joint.together([part_that_found(BUMPS, RADII, seed) for seed in range(6)], set())
    (found,) = alike.findings
    assert found.effect == "wheel_radius_error"
    for amount in found.parameters.values():
        assert amount.value == pytest.approx(-0.004, abs=4.0 * amount.std)
    assert not any(alike.own)
    one = [part_that_found(BUMPS, BUMPS, 0), *(part(0.0, seed) for seed in range(1, 6))]
    apart = joint.together(one, set())
    assert not apart.findings
    assert apart.own == [{"bump_counts"}, *([frozenset()] * 5)]


def test_names_of_single_drives_go_where_what_all_have_explains_them(tmp_path: Path) -> None:
    bumps = Finding(
        effect="bump_counts", status=Status.CONFIRMED, also_fits=("wheel_radius_error",), acts_on="wheels",
        windows=((0.0, 1.0),), parameters={"travel_per_m": Amount(0.004, 0.0004, "1")}, covariate=None,
        evidence=Support(50.0, 0.001, 1e9), explains=1.0, sentence="Bumps.",
    )  # fmt: skip
    results = [replace_result(seeing(tmp_path, 0.1, bumps), recording=f"drive {i}") for i in range(6)]
    (found,) = combined(results, [part_that_found(BUMPS, RADII, seed) for seed in range(6)]).findings
    assert (found.effect, found.explains) == ("wheel_radius_error", 1.0)
    assert "6 of 6 recordings show it or an alternative to it" in found.sentence
    parts = [part_that_found(BUMPS, BUMPS, 0), *(part(0.0, seed) for seed in range(1, 6))]
    others = [replace_result(r, findings=()) for r in results[1:]]
    assert [f.effect for f in combined([results[0], *others], parts).findings] == ["bump_counts"]


def test_a_recording_with_a_value_of_its_own_does_not_hide_that_of_the_others() -> None:
    other = selected("wheel_radius_error", left=-0.2, right=0.1)
    strange = part_that_found(other, other, 0)
    found = joint.together([strange, *(part_that_found(RADII, RADII, seed) for seed in range(1, 6))], set())
    (radii,) = found.findings
    assert radii.effect == "wheel_radius_error"
    for amount in radii.parameters.values():
        assert amount.value == pytest.approx(-0.004, abs=4.0 * amount.std)
    assert found.own == [{"wheel_radius_error"}, *([frozenset()] * 5)]


def test_statistics_beside_an_effect_are_those_with_it_projected_out() -> None:
    whole = part(D, 3)
    names = [n for n in whole.names if n[0] != "tread_error"]
    beside = whole.beside({"tread_error"})
    assert list(beside.names) == names
    index = [whole.names.index(n) for n in names]
    at = [i for i, (effect, _) in enumerate(whole.names) if effect == "tread_error"]
    share = whole.G[np.ix_(index, at)] / whole.G[np.ix_(at, at)]
    np.testing.assert_allclose(
        beside.b, whole.b[index] - share @ whole.b[at], rtol=1e-6, atol=1e-6 * np.abs(whole.b).max()
    )
