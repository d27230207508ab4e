"""What several recordings say together: nothing is made up, and nothing is dropped."""

from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import SLALOM, recorded
from diagnosis_results import said, seeing, tread
from msgspec import UNSET
from msgspec.structs import replace

from drd_tools.diagnose.combine.joint import united
from drd_tools.diagnose.combine.pool import combined
from drd_tools.diagnose.combine.statistics import SufficientStatistics
from drd_tools.diagnose.conclude.outcome import model_of, terms_found
from drd_tools.diagnose.observe.parts import with_whole
from drd_tools.diagnose.results import Amount, Because, Finding, Result, Smallest, Status, Term

EMPTY = SufficientStatistics((), np.zeros((0, 0)), np.zeros(0), 0, {}, (0.0, 1.0))


def together(*results: Result) -> Result:
    return combined(results, [EMPTY] * len(results))


def test_without_a_reference_no_end_error_is_known(tmp_path: Path) -> None:
    one, two = said(tmp_path, "one"), said(tmp_path, "two")
    assert together(one, two).unexplained.end_error_m is None
    assert together(one, said(tmp_path, "two", 0.12)).unexplained.end_error_m == 0.12


def test_what_no_recording_can_show_stays_unobservable(tmp_path: Path) -> None:
    no_gyro, nothing = Because("gyro_lag", "the recording has no gyro"), Because("turn_scrub", "nothing shows it")
    one = replace(said(tmp_path, "one"), not_observable=[no_gyro, nothing])
    two = replace(said(tmp_path, "two"), not_observable=[no_gyro])
    assert together(one, two).unobservable == [no_gyro]
    assert together(one, replace(two, not_observable=UNSET)).unobservable == []


def test_what_any_recording_rules_out_is_as_it_would_be_seen_best(tmp_path: Path) -> None:
    small, large = Smallest(0.001, "1"), Smallest(0.1, "1")
    tread, slip = Because("tread_error", "k = 0.0"), Because("surface_slip", "left = 0.0")
    one = replace(said(tmp_path, "one"), ruled_out=[slip], detectable={"tread_error": small})
    two = replace(said(tmp_path, "two"), ruled_out=[tread], detectable={"tread_error": large})
    three = replace(said(tmp_path, "three"), ruled_out=[tread, slip], detectable={"tread_error": small})
    assert together(one, two).ruled_out == [Because("tread_error", "two: k = 0.0")]
    assert together(two, three).ruled_out == [Because("tread_error", "three: k = 0.0")]
    assert [row.effect for row in together(three, three).ruled_out] == ["surface_slip", "tread_error"]


def test_a_recording_that_shows_a_covariate_at_one_value_has_no_range_of_it() -> None:
    assert united([{"curvature": (0.1, 0.5)}, {}, {"curvature": (0.2, 0.9)}]) == {"curvature": (0.1, 0.9)}
    assert united([{}, {"curvature": (0.2, 0.9)}]) == {"curvature": (0.2, 0.9)}


def test_what_holds_in_one_run_is_taken_off_in_that_alone(tmp_path: Path) -> None:
    """At the same times another drive was elsewhere."""
    sizes = {name: Amount(value, 0.01, "1") for name, value in (("left", 0.1), ("right", 0.05))}
    times = {name: Amount(value, 0.5, "s") for name, value in (("t0", 30.0), ("t1", 60.0))}
    slip = replace(tread(0.02), effect="surface_slip", parameters=sizes | times, status=Status.CONFIRMED)
    one, two = replace(said(tmp_path, "one"), findings=(slip,)), said(tmp_path, "two")
    findings = together(one, two).findings
    assert [f.recording for f in findings] == ["one"]
    model = model_of(terms_found(findings), recorded(SLALOM, 1), "one, two", "0")
    assert [[term.effect.id for term in model.holds_in(name)[0]] for name in ("one", "two")] == [["surface_slip"], []]


def test_what_holds_in_a_part_of_a_run_is_taken_off_in_the_whole_one() -> None:
    assert with_whole("one") == "one"
    assert with_whole("one-part-2-of-3") == "one, one-part-2-of-3"


def test_the_linear_term_that_a_form_was_fitted_with_is_in_the_model_of_all(tmp_path: Path) -> None:
    def bent(k: float) -> Finding:
        scale = Term(effect="gyro_scale_error", parameters={"k": Amount(k, 0.001, "1")})
        sizes = {"a2": Amount(0.01, 0.001, "deg/s"), "a3": Amount(0.0, 0.001, "deg/s")}
        largest = {"largest_rate": Amount(30.0, 0.0, "deg/s")}
        return replace(tread(0.0), effect="gyro_scale_nonlinearity", parameters=sizes | largest, beside=scale)

    found = together(seeing(tmp_path, 0.1, bent(0.010)), seeing(tmp_path, 0.2, bent(0.011))).findings
    one, scale = terms_found(found)
    assert (one.effect, scale.effect) == ("gyro_scale_nonlinearity", "gyro_scale_error")
    assert scale.parameters["k"].value == pytest.approx(0.0105)
    assert "gyro_scale_error k = 0.01050" in found[0].sentence
    # Not twice, if another recording has it as a finding.
    alone = replace(tread(0.02), effect="gyro_scale_error")
    found = together(seeing(tmp_path, 0.1, bent(0.010)), seeing(tmp_path, 0.2, alone)).findings
    assert sorted(t.effect for t in terms_found(found)) == ["gyro_scale_error", "gyro_scale_nonlinearity"]


def test_a_name_in_one_recording_that_others_would_show_is_withdrawn(tmp_path: Path) -> None:
    alone = seeing(tmp_path, 0.001, tread(0.02))
    one, two = seeing(tmp_path, 0.002), seeing(tmp_path, 0.003)
    (finding,) = together(alone, one, two).findings
    assert finding.status is Status.SUSPECTED
    assert "2 others should show it" in finding.sentence
    assert finding.contradicted_by == 2


def test_a_name_stays_where_the_others_could_not_show_it_or_one_bears_it_out(tmp_path: Path) -> None:
    alone, blind = seeing(tmp_path, 0.001, tread(0.02)), seeing(tmp_path, 0.02)
    (finding,) = together(alone, seeing(tmp_path, 0.002), blind).findings
    assert (finding.status, finding.contradicted_by) == (Status.CONFIRMED, UNSET)
    again = seeing(tmp_path, 0.0015, tread(0.021))
    found = together(alone, again, seeing(tmp_path, 0.002), seeing(tmp_path, 0.003)).findings
    assert [f.status for f in found] == [Status.CONFIRMED]
    assert "contradict each other" not in found[0].sentence


def test_a_name_in_some_recordings_that_more_others_would_show_is_withdrawn(tmp_path: Path) -> None:
    """A few of a hundred drives of a robot have the same name by chance: it is not in the model of all."""
    shown = [seeing(tmp_path, 0.001, tread(k)) for k in (0.02, 0.021)]
    blind, without = seeing(tmp_path, 0.02), seeing(tmp_path, 0.002)
    (finding,) = together(*shown, without, without, without).findings
    assert finding.status is Status.SUSPECTED
    assert "3 others should show it" in finding.sentence
    assert [f.status for f in together(*shown, without, without, blind).findings] == [Status.CONFIRMED]
    (finding,) = combined([*shown, *[blind] * 3], [EMPTY, EMPTY, *[knowing(0.0, 0.004)] * 3]).findings
    assert finding.status is Status.SUSPECTED


def knowing(k: float, sigma: float) -> SufficientStatistics:
    """A recording whose data tell a tread to `sigma`, and see `k`."""
    return SufficientStatistics(
        (("tread_error", "k"),), np.array([[sigma**-2]]), np.array([k * sigma**-2]), 100, {}, (0.0, 1.0)
    )


def test_a_name_against_which_the_data_of_others_speak_is_withdrawn_whatever_they_say(tmp_path: Path) -> None:
    alone, blind = seeing(tmp_path, 0.001, tread(0.02)), seeing(tmp_path, 0.02)

    def status(*others: SufficientStatistics) -> Status:
        # They even tell a name of its class.
        alike = replace(blind, findings=(replace(tread(0.1), effect="turn_scrub", also_fits=("tread_error",)),))
        found = combined([alone, *[alike] * len(others)], [EMPTY, *others]).findings
        return next(f.status for f in found if f.effect == "tread_error")

    assert status(knowing(0.0, 0.004), knowing(0.001, 0.004)) is Status.SUSPECTED
    assert status(knowing(0.0, 0.004)) is Status.CONFIRMED  # one alone may be the one that is wrong
    assert status(knowing(0.0, 0.03), knowing(0.001, 0.03)) is Status.CONFIRMED
    assert status(knowing(0.0, 0.004), knowing(0.022, 0.004)) is Status.CONFIRMED


def test_constants_that_contradict_each_other_are_told(tmp_path: Path) -> None:
    one, two, three = (seeing(tmp_path, 0.001, tread(*value)) for value in ((0.02,), (0.05,), (0.055, 0.02)))
    results = [replace(r, recording=name) for r, name in ((one, "monday"), (two, "tuesday"), (three, "friday"))]
    (finding,) = together(*results).findings
    assert "contradict each other: k is 0.0200 +- 0.0020 in monday and 0.0500 +- 0.0020 in tuesday." in finding.sentence
    assert finding.parameters["k"].std > 0.01


def test_constants_that_agree_within_their_intervals_do_not_contradict(tmp_path: Path) -> None:
    one, two = seeing(tmp_path, 0.001, tread(0.02, 0.01)), seeing(tmp_path, 0.002, tread(0.05, 0.01))
    (finding,) = together(one, two).findings
    assert "contradict each other" not in finding.sentence
    assert finding.parameters["k"].value == pytest.approx(0.035)
    assert "Combined: k = 0.035 +- 0.015." in finding.sentence  # ((0.01^2 + T^2) / 2)^0.5, T^2 = 3.5e-4


def test_faults_of_the_reference_that_most_recordings_show_are_told_with_their_scatter(tmp_path: Path) -> None:
    """A fault that one in three shows may be chance; jumps are counted."""
    jumps, lever = Amount(2.0, 0.0, "1"), Amount(0.03, 0.001, "m")
    faults = [
        {
            "drift": Amount(ppm, 100.0, "ppm"),
            "heading": Amount(0.01 * (ppm - 1000.0), 0.1, "deg"),
            "jumps": jumps,
            **more,
        }
        for ppm, more in ((500.0, {"left": lever}), (1000.0, {}), (1500.0, {}))
    ]
    reference = together(*(replace(said(tmp_path, f"run {i}"), reference=f) for i, f in enumerate(faults))).reference
    assert isinstance(reference, dict)
    assert reference.keys() == {"drift", "jumps"}
    assert reference["drift"].value == pytest.approx(1000.0)
    assert reference["drift"].std == pytest.approx(500.0 / 3.0**0.5, rel=0.01)
    assert reference["jumps"].value == 6.0
    assert together(said(tmp_path, "one"), said(tmp_path, "two")).reference is UNSET
