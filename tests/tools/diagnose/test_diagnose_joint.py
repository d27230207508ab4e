"""What several recordings show together, though none shows it alone."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import SLALOM, problem, selected
from diagnosis_results import seeing, tread
from msgspec.structs import replace as replace_result

from drd_tools.diagnose.combine.joint import SufficientStatistics, shared, sufficient_statistics, together
from drd_tools.diagnose.combine.pool import combined
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine

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
    assert "all 10 together" in found.sentence


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
    """Of a recording that has selected some effects itself."""
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
