"""Scores against made-up records."""

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drd_tools.trial.score import score, wilson
from drd_tools.trial.text import told

SCALE = {"effect": "gyro_scale_error", "parameters": {"k": 0.001}, "visibility": 25.0}
TREAD = {"effect": "tread_error", "parameters": {"k": 0.02}, "visibility": 25.0}


def finding(
    effect: str, status: str = "confirmed", also_fits: tuple[str, ...] = (), **parameters: Any
) -> dict[str, Any]:
    return {
        "effect": effect, "status": status, "also_fits": list(also_fits), "parameters": parameters, "driver": "time",
        "evidence": {"gain_nats": 100.0, "family_wise_p": 0.001, "e_value": 1e9},
    }  # fmt: skip


def record(verdict: str, truth: list[Any], *findings: dict[str, Any], kind: str = "single") -> dict[str, Any]:
    return {"case": "a", "kind": kind, "effects": truth, "verdict": verdict, "findings": list(findings)}


def amount(value: float, std: float) -> dict[str, Any]:
    return {"value": value, "std": std, "unit": "1"}


def test_the_right_name_with_its_parameter() -> None:
    s = score(record("explained", [SCALE], finding("gyro_scale_error", k=amount(0.0011, 0.0001))))
    assert (s.verdict, s.top_1, s.top_1_class, s.exact, s.exact_class) == (True,) * 5
    assert [(i.parameter, i.inside) for i in s.intervals] == [("k", True)]
    assert s.intervals[0].sigmas == pytest.approx(1.0)


@pytest.mark.parametrize(("value", "inside"), [(0.00116, True), (0.00117, False), (0.00083, False), (0.00084, True)])
def test_a_90_percent_interval_is_1_645_deviations_to_each_side(value: float, inside: bool) -> None:
    s = score(record("explained", [SCALE], finding("gyro_scale_error", k=amount(value, 0.0001))))
    assert s.intervals[0].inside is inside


def test_an_angle_is_wrong_by_the_short_way() -> None:
    truth = {"effect": "gyro_heading_dependent_bias", "parameters": {"b": 0.01, "phase": 0.01}}
    told_phase = {"value": 2.0 * math.pi - 0.01, "std": 0.02, "unit": "rad"}
    s = score(record("explained", [truth], finding("gyro_heading_dependent_bias", phase=told_phase)))
    assert [(i.parameter, i.inside) for i in s.intervals] == [("phase", True)]


def test_parameters_that_were_not_estimated_do_not_count() -> None:
    truth = {"effect": "gyro_scale_temperature", "parameters": {"k": 1e-4, "T0": 20.0}}
    said = finding("gyro_scale_temperature", k=amount(1e-4, 0.0), T0=amount(25.0, 1.0))
    assert score(record("explained", [truth], said)).intervals == ()


def test_another_name_is_wrong_unless_the_class_holds_the_right_one() -> None:
    wrong = score(record("explained", [SCALE], finding("tread_error")))
    assert not any((wrong.top_1, wrong.top_1_class, wrong.exact, wrong.exact_class))
    assert wrong.intervals == ()
    near = score(record("explained", [SCALE], finding("tread_error", also_fits=("gyro_scale_error",))))
    assert (near.top_1, near.top_1_class, near.exact, near.exact_class) == (False, True, False, True)


def test_one_finding_does_not_stand_for_two_effects() -> None:
    one = finding("tread_error", also_fits=("gyro_scale_error",))
    assert not score(record("explained", [SCALE, TREAD], one)).exact_class
    assert score(record("explained", [SCALE, TREAD], one, finding("tread_error"))).exact_class
    assert not score(record("explained", [SCALE, TREAD], finding("tread_error"), finding("tread_error"))).exact_class


def test_a_second_false_name_spoils_the_set_but_not_the_first_name() -> None:
    s = score(record("explained", [SCALE], finding("gyro_scale_error"), finding("gyro_lag")))
    assert (s.top_1, s.exact, s.exact_class) == (True, False, False)


def test_nulls() -> None:
    silent = score(record("nothing_missing", []))
    assert (silent.verdict, silent.claims, silent.exact) == (True, False, True)
    suspect = score(record("explained", [], finding("gyro_lag", "suspected")))
    assert (suspect.verdict, suspect.claims, suspect.sure_claims) == (False, True, False)
    assert score(record("unknown", [], finding("unknown", "supported"))).sure_claims


def test_a_diagnosis_that_failed_is_never_right() -> None:
    s = score(record("failed", []))
    assert not any((s.verdict, s.exact, s.exact_class))


def test_wilson_against_published_values() -> None:
    # Newcombe (1998), Statistics in Medicine 17, table I, method 3.
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(15, 148) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert wilson(1, 29) == pytest.approx((0.0061, 0.1718), abs=5e-5)
    assert wilson(0, 0) == (0.0, 1.0)


@given(n=st.integers(1, 10_000), part=st.floats(0.0, 1.0))
@settings(deadline=None)
def test_wilson_holds_the_share_and_is_symmetric(n: int, part: float) -> None:
    k = round(part * n)
    low, high = wilson(k, n)
    assert 0.0 <= low <= k / n + 1e-12
    assert k / n - 1e-12 <= high <= 1.0
    other = wilson(n - k, n)
    assert (1.0 - other[1], 1.0 - other[0]) == pytest.approx((low, high), abs=1e-9)


def test_the_text_has_the_figures_and_what_was_confused() -> None:
    records = [
        record("explained", [SCALE], finding("gyro_lag", tau=amount(0.03, 0.01))),
        record("explained", [SCALE], finding("gyro_scale_error", k=amount(0.002, 0.0001))),
        record("nothing_missing", [], kind="null"),
        record("explained", [], finding("tyre_deflation", side="left"), kind="null"),
        {"case": "b", "kind": "single", "effects": [], "not_made": "b: none of 30 drives"},
    ]
    text = told({"arguments": ["--seed", "3"], "records": records})
    rows = {line.split()[0]: line.split() for line in text.splitlines() if line.strip()}
    assert rows["null"][1:3] == ["2", "0.50"]
    assert "False claims: 1" in text
    assert "Confused: 1" in text
    assert "gyro_lag (tau 0.03 +- 0.01) confirmed" in text
    assert "tyre_deflation (side left)" in text
    assert "+10.0" in text  # sigmas of the scale
    assert "b: none of 30 drives" in text
    assert "--seed 3 --only CASE" in text
