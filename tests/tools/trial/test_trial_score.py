"""Scores against made-up records."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trial_records import SCALE, TREAD, amount, finding, record

from drd_tools.trial.figures import Figures, markdown
from drd_tools.trial.results import Mismatch, NotMade, OtherDrive, Row, TrueEffect
from drd_tools.trial.score import of_names, score, wilson
from drd_tools.trial.text import text


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
    truth = TrueEffect(effect="gyro_heading_dependent_bias", parameters={"b": 0.01, "phase": 0.01})
    phase = amount(2.0 * math.pi - 0.01, 0.02)
    s = score(record("explained", [truth], finding("gyro_heading_dependent_bias", phase=phase)))
    assert [(i.parameter, i.inside) for i in s.intervals] == [("phase", True)]


def test_parameters_that_were_not_estimated_do_not_count() -> None:
    truth = TrueEffect(effect="gyro_scale_temperature", parameters={"k": 1e-4, "T0": 20.0})
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
    assert (silent.verdict, silent.reports, silent.exact) == (True, False, True)
    suspect = score(record("explained", [], finding("gyro_lag", "suspected")))
    assert (suspect.verdict, suspect.reports, suspect.sure_reports) == (False, True, False)
    assert score(record("unknown", [], finding("unknown", "supported"))).sure_reports


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


@pytest.mark.parametrize(
    ("window", "overlap"),
    [((20.0, 40.0), 1.0), ((20.0, 30.0), 0.5), ((10.0, 50.0), 0.5), ((30.0, 50.0), 1.0 / 3.0), ((50.0, 60.0), 0.0)],
)
def test_windows_overlap_by_intersection_over_union(window: tuple[float, float], overlap: float) -> None:
    slip = TrueEffect(effect="surface_slip", parameters={"t0": 20.0, "t1": 40.0, "left": 0.01, "right": 0.01})
    s = score(record("explained", [slip], finding("surface_slip", window=window)))
    ((name, found),) = s.windows
    assert name == "surface_slip"
    assert found == pytest.approx(overlap)


def test_a_step_lasts_until_the_end_and_what_has_no_window_has_no_overlap() -> None:
    step = TrueEffect(effect="gyro_bias_step", parameters={"b": 0.01, "t0": 20.0})
    ((_, overlap),) = score(record("explained", [step], finding("gyro_bias_step", window=(60.0, 100.0)))).windows
    assert overlap == pytest.approx(0.5)
    assert score(record("explained", [SCALE], finding("gyro_scale_error"))).windows == ()


HIDDEN = TrueEffect(effect="unknown_bias_tide", parameters={"k": 0.01})


def test_what_is_in_no_catalogue_is_flagged_or_misnamed_or_silent() -> None:
    flagged = score(record("unknown", [HIDDEN], finding("unknown")))
    assert (flagged.verdict, flagged.top_1, flagged.exact, flagged.flagged, flagged.misnamed) == (True,) * 4 + (False,)
    named = score(record("explained", [HIDDEN], finding("gyro_warmup")))
    assert (named.top_1, named.flagged, named.misnamed, named.false_named) == (False, False, True, 1)
    both = score(record("partly_explained", [HIDDEN], finding("gyro_warmup"), finding("unknown")))
    assert (both.flagged, both.misnamed, both.named, both.false_named) == (True, False, 1, 1)
    silent = score(record("nothing_missing", [HIDDEN]))
    assert (silent.flagged, silent.misnamed, silent.named) == (False, False, 0)


def test_false_names_are_counted_by_class_and_unknown_is_no_name() -> None:
    right = finding("tread_error", also_fits=("gyro_scale_error",))
    s = score(record("explained", [SCALE], right, finding("gyro_lag"), finding("unknown")))
    assert (s.named, s.false_named) == (2, 1)


@pytest.mark.parametrize(
    ("residual", "path_m", "share", "worse", "worse_path"),
    [
        ((1000.0, 820.0, 800.0), (1.0, 0.5), 0.9, False, False),
        ((1000.0, 1050.0, 800.0), (1.0, 1.03), -0.25, True, True),
        ((1000.0, 1020.0, 990.0), (1.0, 1.01), None, False, False),
        ((9000.0, 9900.0, 2000.0), (1.0, 0.5), None, None, False),
    ],
)
def test_another_drive(
    residual: tuple[float, ...], path_m: tuple[float, ...], share: float | None, worse: bool | None, worse_path: bool
) -> None:
    one = record("explained", [SCALE], finding("gyro_scale_error"))
    one.held_out = OtherDrive(900, Mismatch(*residual), Mismatch(*path_m))
    s = score(one)
    assert (s.share, s.worse, s.worse_path) == (None if share is None else pytest.approx(share), worse, worse_path)
    assert score(record("explained", [SCALE], finding("gyro_scale_error"))).worse is None


def test_other_methods_are_judged_alike() -> None:
    one, null = record("explained", [SCALE]), record("nothing_missing", [])
    one.baselines = {"lasso": ["gyro_scale_error"], "BIC": ["gyro_scale_error", "gyro_lag"]}
    null.baselines = {"lasso": []}
    assert of_names(one, "lasso").exact
    two = of_names(one, "BIC")
    assert (two.top_1, two.exact, two.false_named) == (True, False, 1)
    assert not of_names(null, "lasso").reports


def test_the_text_has_the_figures_and_what_was_confused() -> None:
    false_alarm = record("explained", [], finding("tyre_deflation", side="left"), kind="null")
    false_alarm.baselines = {"BIC": []}
    records: list[Row] = [
        record("explained", [SCALE], finding("gyro_lag", tau=amount(0.03, 0.01)), kind="single d=20"),
        record("explained", [SCALE], finding("gyro_scale_error", k=amount(0.002, 0.0001)), kind="single d=20"),
        record("nothing_missing", [], kind="null"),
        false_alarm,
        record("nothing_missing", [HIDDEN], kind="unknown d=20"),
        NotMade("b", "single d=20", "b: none of 30 drives"),
    ]
    figures = Figures(records)
    told = text(figures, ["--seed", "3"])
    rows = {line.split()[0]: line.split() for line in told.splitlines() if line.strip()}
    assert rows["null"][1:4] == ["1", "1.00", "-"]  # beside the other methods: one of both
    assert "False alarms: 1" in told
    assert "Confused: 1" in told
    assert "not flagged: 1" in told
    assert "gyro_lag (tau 0.03 +- 0.01) confirmed" in told
    assert "tyre_deflation (side left)" in told
    assert "+10.0" in told  # sigmas of the scale
    assert "b: none of 30 drives" in told
    assert "drd trial --seed 3 --only CASE" in told
    quoted = markdown(figures.quoted()).splitlines()
    assert quoted[2] == "| nothing is missing, something is reported | 2 | 0.50 (0.09..0.91) | 0.00 of 1 | - |"
    assert "| in no catalogue: flagged as unknown | 1 | 0.00 (0.00..0.79) | - | - |" in quoted


def test_a_trial_of_nothing_but_nulls_has_its_table() -> None:
    (table,) = Figures([record("nothing_missing", [], kind="null")]).tables()
    assert table.rows == [["null", "1", "0.00", "(0.00..0.79)", "0.00", "(0.00..0.79)"]]
