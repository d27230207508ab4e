"""What to drive next."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tied_pairs import PAIRS, as_if, checked, diagnosed, finding, nearest, question, recorded, selected, tied

from drd_tools.diagnose.advise.laps import Laps, driven
from drd_tools.diagnose.advise.manoeuvres import MANOEUVRES
from drd_tools.diagnose.advise.next_drive import ENOUGH, next_drive, open_questions, plans_for
from drd_tools.diagnose.advise.separation import SETTLED_NATS, Place, _shape_scale, columns_of, expected_ratio
from drd_tools.diagnose.conclude.cause import Cause
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.results import NOTHING, NextDrive, Status
from drd_tools.diagnose.select.splines import Curve
from drd_tools.diagnose.selected import Selected
from drd_tools.simulate.conditions import Reference
from drd_tools.simulate.robot import DEFAULT

CIRCLES = next(name for name in MANOEUVRES if name.startswith("circles"))
WEAK = ("a slalom", "straight lines", "figures of eight")


def advised(*findings: Cause, reference: str = "full") -> NextDrive:
    advice = next_drive(diagnosed(*findings, reference=reference), DEFAULT)
    assert advice is not None
    return advice


def test_without_an_open_question_there_is_nothing_to_drive() -> None:
    assert next_drive(diagnosed(), DEFAULT) is None
    assert next_drive(diagnosed(finding(selected("tread_error", k=0.02))), DEFAULT) is None
    step = selected("gyro_bias_step", b=1e-4, t0=30.0)
    assert next_drive(diagnosed(finding(step, status=Status.SUSPECTED)), DEFAULT) is None


def test_questions_are_all_that_also_fits_and_what_is_only_suspected() -> None:
    sure = finding(selected("gyro_scale_error", k=0.001))
    scrub, terrain = selected("turn_scrub", k=0.02), selected("terrain_tread", k=0.02)
    either = finding(selected("tread_error", k=0.02), scrub, terrain, status=Status.SUSPECTED)
    maybe = finding(selected("gyro_lag", tau=0.1), status=Status.SUSPECTED)
    assert open_questions([sure, either, maybe]) == [
        (either, scrub),
        (either, terrain),
        (maybe, None),
    ]


@pytest.mark.parametrize(("name", "rival"), [("tread_error", "turn_scrub"), ("turn_scrub", "tread_error")])
def test_constant_against_growing_tread_takes_tight_and_wide_turns(name: str, rival: str) -> None:
    conclusion = diagnosed(tied(selected(name, k=0.05), rival))
    advice = next_drive(conclusion, DEFAULT)
    assert advice is not None
    assert CIRCLES in [s.manoeuvre for s in advice.segments]
    assert advice.separates == [[name, rival]]
    assert (advice.nats or 0.0) >= SETTLED_NATS
    assert (advice.probability or 0.0) >= ENOUGH
    assert f"{name} from {rival}" in advice.sentence
    plans = plans_for(conclusion.found, DEFAULT, open_questions(conclusion.causes))
    nats = {p.parts[0].manoeuvre: p.nats[0] for p in plans if len(p.parts) == 1 and p.seconds < 240.0}
    assert all(nats[weak] < 0.8 * nats[CIRCLES] for weak in nats if weak.startswith(WEAK))


def test_two_questions_take_the_manoeuvres_of_both() -> None:
    turning = tied(selected("tread_error", k=0.05), "turn_scrub")
    rolling = tied(selected("wheel_radius_error", left=0.01, right=0.01), "wheel_radius_speed")
    both = advised(turning, rolling)
    assert len(both.separates) == 2
    assert len(both.segments) > 1
    assert both.minutes == pytest.approx(sum(s.minutes for s in both.segments) + both.stand_s / 60.0, abs=0.1)
    assert both.probability == pytest.approx(math.prod(q.probability for q in both.questions), abs=0.01)
    assert all(both.minutes >= advised(one).minutes for one in (turning, rolling))
    assert all(s.manoeuvre in both.sentence for s in both.segments)


def test_warm_up_against_temperature_takes_a_temperature_that_falls_again() -> None:
    warmup = selected("gyro_warmup", b=math.radians(0.012), tau=175.0)
    advice = advised(tied(warmup, "gyro_bias_temperature", "gyro_bias_temperature_rate"))
    assert "cooled" in advice.manoeuvre
    assert len(advice.separates) == 2
    assert "power-on" in advice.sentence
    assert all(a.settles == 0 or "cooled" in a.manoeuvre for a in advice.alternatives)


def test_a_finding_is_not_beside_itself_once_it_is_reported() -> None:
    cause = tied(selected("tread_error", k=0.05), "turn_scrub")
    assert cause.selected is not None
    reported = replace(cause, selected=replace(cause.selected, values={"k": 0.049}))
    conclusion = replace(diagnosed(cause), causes=[reported])
    advice = next_drive(conclusion, DEFAULT)
    assert advice is not None
    assert advice.separates == [["tread_error", "turn_scrub"]]


def test_what_no_drive_settles_is_said() -> None:
    advice = advised(tied(selected("tread_error", k=1e-4), "turn_scrub"))
    assert advice.separates == []
    assert advice.unsettled == [["tread_error", "turn_scrub"]]
    assert advice.nats is not None
    assert advice.nats < SETTLED_NATS
    assert advice.sentence.startswith("None of the simulated drives")


def test_more_laps_bring_more() -> None:
    conclusion = diagnosed(tied(selected("gyro_scale_error", k=0.0003), "gyro_scale_asymmetry"))
    plans = plans_for(conclusion.found, DEFAULT, open_questions(conclusion.causes))
    for name in MANOEUVRES:
        nats = [p.nats[0] for p in plans if [part.manoeuvre for part in p.parts] == [name]]
        assert np.all(np.diff(nats) > -0.5)
        assert not nats or nats[-1] > nats[0]


@pytest.mark.parametrize("reference", ["full", "sparse:20", "ends", "none"])
def test_it_serves_every_kind_of_reference(reference: str) -> None:
    suspected = finding(selected("tread_error", k=0.01), status=Status.SUSPECTED)
    assert advised(suspected, reference=reference).separates == [["tread_error", NOTHING]]


def test_it_says_the_same_twice() -> None:
    suspected = finding(selected("gyro_warmup", b=math.radians(0.02), tau=100.0), status=Status.SUSPECTED)
    first = advised(suspected)
    driven.cache_clear()
    assert advised(suspected) == first


def test_a_curve_without_a_name_is_put_against_names() -> None:
    knots = np.linspace(-40.0, 40.0, 8)
    curve = Curve("gyro", "yaw_rate", "deg/s", "deg/s", knots, 1e-4 * knots**2, np.full(8, 0.01), 20.0, 1.0)
    advice = advised(finding(None, selected("gyro_scale_error", k=0.001), curve=curve))
    assert advice.separates == [["unknown", "gyro_scale_error"]]


def test_a_stretch_of_ground_is_driven_over_again() -> None:
    slip = selected("surface_slip", t0=20.0, t1=30.0, left=0.03, right=0.03)
    assert "same ground again" in advised(finding(slip, status=Status.SUSPECTED)).sentence


def test_a_robot_without_gyro_or_thermometer() -> None:
    recording, problem = recorded("full")
    without = replace(recording, fog=None)
    gyroless = Problem(gather(without))
    larger = selected("wheel_radius_error", left=0.004, right=0.004)
    conclusion = diagnosed(tied(larger, "wheel_radius_speed", problem=gyroless))
    found = replace(conclusion.found, problem=gyroless)
    advice = next_drive(replace(conclusion, found=found), without.nominal)
    assert advice is not None
    assert advice.separates
    assert problem.evidence.gyro_rad is not None


def test_laps_of_several_manoeuvres_add_up_to_the_drive() -> None:
    true = selected("tread_error", k=0.01)
    rival = as_if("turn_scrub", true, recorded()[1])
    laps = Laps(diagnosed().found, DEFAULT, [true, rival])
    parts = tuple(next(p for p in laps.parts if p.manoeuvre.startswith(way)) for way in WEAK)
    added = sum(laps.products[laps.parts.index(part)] for part in parts) + laps.standing
    columns, layout = columns_of(Problem(*driven(parts, DEFAULT, Reference(period_s=0.1), True, True)), [true, rival])
    of_sum, of_whole = (
        expected_ratio(products[None], layout, true, rival, []) for products in (added, columns.T @ columns)
    )
    assert of_sum[0] == pytest.approx(of_whole[0], rel=0.1)
    assert of_sum[1] == pytest.approx(of_whole[1], rel=0.1)


@pytest.mark.parametrize("pair", PAIRS[:3])
def test_as_many_drives_settle_it_as_is_said(pair: tuple[Selected, str]) -> None:
    conclusion, asked = question(*pair)
    plans = plans_for(conclusion.found, DEFAULT, [asked])
    stated, share = 0.0, 0.0
    for level in (0.4, 0.9):
        found = checked(asked, nearest(plans, level), range(4))
        stated, share = stated + 0.5 * found.plan.probabilities[0], share + 0.5 * found.share
    # Of 16 drives at such levels 0.1 is one sigma.
    assert share == pytest.approx(stated, abs=0.2)


def test_a_shape_that_a_manoeuvre_does_not_show_has_no_size() -> None:
    """It was as large as its cause, and ended as no number."""
    products = np.diag([4.0, 1.0, 0.0, 1e-300])[None]
    scale = _shape_scale(products, Place(0, range(0), range(1, 4)), np.array([4e10]))
    assert scale == pytest.approx(np.array([[0.15 * 2e5, 0.0, 0.0]]))
