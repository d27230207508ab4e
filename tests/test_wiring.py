"""Each wiring fault is found and named from the samples of a drive; a right wired robot is never accused."""

import math
import subprocess
import sys
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wiring_drives import CIRCLE, COUNT_M, CURVES, GEOMETRY, SPOT, STAND, STRAIGHT, TOUR, TREAD_M, Legs, Robot

from drd.samples import GyroSample, WheelSample
from drd.units import NS_PER_S
from drd.wiring.findings import Finding, Outcome, Statement
from drd.wiring.hypotheses import Seen, Wiring, explanations
from drd.wiring.judge import Geometry, judge
from drd.wiring.table import sentences, table

SAID = Statement(drove=1, turned=1)


def findings(robot: Robot, said: Statement | None = None, geometry: Geometry = GEOMETRY) -> dict[str, Finding]:
    return {finding.check: finding for finding in judge(*robot.samples(), geometry, said)}


def faults(found: dict[str, Finding]) -> dict[str, str]:
    return {name: f.remedy for name, f in found.items() if f.outcome is Outcome.FAULT}


def test_a_right_wired_robot_is_good_in_everything() -> None:
    found = findings(Robot(), Statement(drove=1, turned=1, distance_m=13.5))
    assert {name: f.outcome for name, f in found.items() if f.outcome is not Outcome.GOOD} == {}
    assert found["directions"].remedy == ""


# ---- senses --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wiring", [Wiring(*flags) for flags in product((False, True), repeat=4)])
def test_each_of_the_sixteen_wirings_is_named_once_the_user_says_what_he_does(wiring: Wiring) -> None:
    robot = Robot(
        gyro=-1.0 if wiring.gyro else 1.0,
        left=-1.0 if wiring.left else 1.0,
        right=-1.0 if wiring.right else 1.0,
        swapped=wiring.swapped,
        legs=(*STRAIGHT, *SPOT),
    )
    found = findings(robot, SAID)
    if wiring == Wiring():
        assert faults(found) == {}
    else:
        remedy = found["directions"].remedy
        assert found["directions"].outcome is Outcome.FAULT
        assert wiring.words().lower() in remedy.lower()
        assert "Either" not in remedy


@pytest.mark.parametrize("legs", [SPOT, CIRCLE, CURVES, TOUR])
@pytest.mark.parametrize("fault", [Robot(gyro=-1.0), Robot(swapped=True), Robot(left=-1.0, right=-1.0)])
def test_opposite_senses_are_one_class_until_the_user_says_more(fault: Robot, legs: Legs) -> None:
    found = findings(replace(fault, legs=legs))
    assert "opposite directions" in found["directions"].text
    ratio, _, sigma = found["directions"].text.split("gyro = ")[1].split()[:3]
    assert float(ratio) == pytest.approx(-1.0, abs=0.02)
    assert float(sigma) < 0.25
    for word in ("both wheels count backwards", "left and right are swapped", "the gyro's sign is wrong"):
        assert word in found["directions"].remedy
    assert "--drove forward" in found["directions"].remedy
    assert "--turned left" in found["directions"].remedy


@pytest.mark.parametrize("legs", [SPOT, CURVES, TOUR])
@pytest.mark.parametrize("side", ["left", "right"])
def test_one_inverted_side_is_named_by_the_gyro_alone(side: str, legs: Legs) -> None:
    inverted = Robot(left=-1.0, legs=legs) if side == "left" else Robot(right=-1.0, legs=legs)
    assert f"{side} wheel counts backwards" in faults(findings(inverted))["directions"]


@pytest.mark.parametrize("side", ["left", "right"])
def test_one_inverted_side_driven_straight_looks_like_a_blind_gyro(side: str) -> None:
    robot = Robot(left=-1.0, legs=STRAIGHT) if side == "left" else Robot(right=-1.0, legs=STRAIGHT)
    found = faults(findings(robot))
    assert "the left wheel counts backwards" in found["directions"]
    assert "the right wheel counts backwards" in found["directions"]
    assert "the gyro does not measure (fog.axis" in found["directions"]
    told = faults(findings(robot, Statement(drove=1)))
    assert f"the {side} wheel counts backwards" in told["directions"]
    assert "gyro" not in told["directions"]


@pytest.mark.parametrize("legs", [STRAIGHT, STAND * 5])
def test_senses_stay_open_without_a_turn(legs: Legs) -> None:
    found = findings(Robot(gyro=-1.0, legs=legs))
    assert faults(found) == {}
    assert any(f.outcome is Outcome.UNKNOWN and "to the left" in f.text + f.remedy for f in found.values())


def test_a_statement_that_the_drive_contradicts_decides_nothing() -> None:
    to_and_fro: Legs = (*STRAIGHT, (-0.5, 0.0, 6.0), *SPOT, (0.0, -0.5, 12.0), *STAND)
    found = findings(Robot(gyro=-1.0, legs=to_and_fro), SAID)
    assert "the robot went back and forth" in found["directions"].remedy
    assert "the robot turned to both" in found["directions"].remedy


def test_the_wiring_right_in_itself_can_still_be_all_mirrored() -> None:
    mirrored = Robot(gyro=-1.0, swapped=True, legs=(*STRAIGHT, *SPOT))
    assert faults(findings(mirrored)) == {}
    assert set(faults(findings(mirrored, SAID))) == {"directions"}


@given(st.lists(st.booleans(), min_size=4, max_size=4), st.booleans(), st.booleans(), st.booleans())
def test_the_true_wiring_is_among_the_explanations_or_a_simpler_one_is(
    flags: list[bool], says_turn: bool, says_way: bool, says_relation: bool
) -> None:
    truth = Wiring(*flags)
    turn_v, turn_w, sum_v, sum_w = truth.coefficients()
    inverted, gyro = turn_w == 0, -1 if truth.gyro else 1
    seen = Seen(
        one_inverted=inverted if says_relation else None,
        opposite=gyro * (sum_w if inverted else turn_w) < 0 if says_relation else None,
        gyro_turn=gyro if says_turn else None,
        wheel_travel=(turn_v if inverted else sum_v) if says_way else None,
    )
    found = explanations(seen)
    assert truth in found or found[0].changes < truth.changes
    if says_turn and says_way and says_relation:
        assert found == [truth]


# ---- dead sensors --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("legs", [STRAIGHT, SPOT, CURVES, TOUR])
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_dead_encoder_is_named(side: str, legs: Legs) -> None:
    robot = Robot(left=0.0, legs=legs) if side == "left" else Robot(right=0.0, legs=legs)
    found = findings(robot)
    assert set(faults(found)) == {"encoders"}
    assert f"the {side} counter does not count" in found["encoders"].text
    assert "directions" not in found


@pytest.mark.parametrize("lost", [1, 5, 15])
@pytest.mark.parametrize("left", [0.0, 1.0])
def test_what_the_gyro_lost_is_no_travel_that_an_encoder_lost(left: float, lost: int) -> None:
    gyro, wheels = Robot(left=left, legs=(*STAND, (1.0, 0.0, 1.9), (0.0, 0.0, 0.1))).samples()
    found = {f.check: f for f in judge(gyro[:43] + gyro[43 + lost :], wheels, GEOMETRY, Statement(drove=1))}
    assert ", right 1.86 m" in found["encoders"].text
    assert faults(found).keys() == ({"encoders"} if left == 0.0 else set())
    assert ("the left counter does not count" in found["encoders"].text) == (left == 0.0)


def test_a_turn_about_one_wheel_is_not_taken_for_a_dead_encoder() -> None:
    pivot = Robot(legs=(*STAND, (0.5 * TREAD_M / 2.0, 0.5, 12.0), *STAND), slip_m_per_sqrt_m=0.0)
    found = findings(pivot)
    assert faults(found) == {}
    assert "a turn about the left wheel" in found["encoders"].text
    assert set(faults(findings(pivot, Statement(drove=1)))) == {"encoders"}


def test_a_parked_robot_is_parked() -> None:
    found = findings(Robot(legs=STAND * 5))
    assert faults(found) == {}
    assert "parked" in found["encoders"].text


@pytest.mark.parametrize("said", [Statement(drove=1), Statement(turned=-1)])
def test_two_dead_encoders_are_told_from_a_parked_robot_by_what_the_user_says(said: Statement) -> None:
    dead = Robot(left=0.0, right=0.0)
    assert faults(findings(dead)) == {}
    assert "both are dead" in findings(dead)["encoders"].text
    assert set(faults(findings(dead, said))) == {"encoders"}


def test_a_stuck_gyro_is_found_when_the_wheels_turn() -> None:
    assert set(faults(findings(Robot(gyro_stuck=True)))) == {"gyro"}
    assert faults(findings(Robot(gyro_stuck=True, legs=STRAIGHT))) == {}


@pytest.mark.parametrize("said", [Statement(), SAID])
def test_a_gyro_that_sees_no_turn_is_found(said: Statement) -> None:
    """As on a wrong axis: it has noise, but no rotation."""
    found = findings(Robot(gyro=0.0), said)
    assert "gyro does not measure the turn" in faults(found)["directions"]


def test_without_samples_the_sensor_is_named() -> None:
    gyro, wheels = Robot().samples()
    assert [f.check for f in judge([], wheels, GEOMETRY)] == ["gyro"]
    assert [f.check for f in judge(gyro, [], GEOMETRY)] == ["encoders"]
    assert [f.check for f in judge([], [], GEOMETRY)] == ["gyro", "encoders"]
    assert [f.check for f in judge(gyro, [s._replace(t_ns=s.t_ns + 10**12) for s in wheels], GEOMETRY)][-1] == "motion"


# ---- sizes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factor", "cause"), [(2.0, "two counts"), (4.0, "four counts"), (0.5, "half"), (0.25, "quarter")]
)
def test_wrong_counts_of_both_sides_show_in_the_turn_and_in_the_distance(factor: float, cause: str) -> None:
    geometry = replace(GEOMETRY, resolution_m=COUNT_M)
    found = faults(findings(Robot(left=factor, right=factor), Statement(distance_m=13.5), geometry))
    assert set(found) == {"turn ratio", "distance"}
    assert cause in found["turn ratio"]
    assert cause in found["distance"]


def test_a_way_that_curves_made_longer_than_the_tape_is_said_to_be_one() -> None:
    found = findings(Robot(legs=(*STRAIGHT, *CURVES)), Statement(drove=1, distance_m=3.0))
    assert "curves made the path longer" in found["distance"].remedy
    found = findings(Robot(left=0.5, right=0.5), Statement(distance_m=13.5))
    assert "curves" not in found["distance"].remedy


def test_what_is_wrong_is_told_in_a_sentence() -> None:
    found = findings(Robot(swapped=True, right=-1.0, legs=(*STRAIGHT, *SPOT)), SAID)
    assert found["directions"].remedy.startswith("Left and right are swapped and the right wheel counts backwards (")


@pytest.mark.parametrize("factor", [57.29578, 1 / 57.29578])
def test_a_gyro_in_the_wrong_unit_is_named(factor: float) -> None:
    found = faults(findings(Robot(gyro=factor)))
    assert set(found) == {"turn ratio"}
    assert "degrees and radians" in found["turn ratio"]


@pytest.mark.parametrize("scrub", [1.2, 1.5, 1.8])
def test_a_skid_steer_robots_tread_is_no_fault(scrub: float) -> None:
    found = findings(Robot(scrub=scrub))
    assert faults(found) == {}
    assert found["turn ratio"].outcome is Outcome.UNKNOWN
    assert "scrubbing or tread" in found["turn ratio"].text
    told = findings(Robot(scrub=scrub), Statement(distance_m=13.5))["turn ratio"]
    assert told.outcome is Outcome.GOOD
    tread_m = float(told.remedy.split("would be ")[1].split()[0])
    assert tread_m == pytest.approx(scrub * TREAD_M, rel=0.02)


@pytest.mark.parametrize(("left", "right"), [(2.0, 1.0), (1.0, 2.0), (1.0, 0.25), (1.4, 1.0)])
def test_wrong_counts_of_one_side_show_against_the_other(left: float, right: float) -> None:
    found = findings(Robot(left=left, right=right))
    assert set(faults(found)) == {"left against right"}
    text = found["left against right"].text
    assert float(text.split("right = ")[1].split()[0]) == pytest.approx(right / left, rel=0.02)


def test_an_inaccurate_wheel_is_for_calibration_not_a_fault() -> None:
    found = findings(Robot(left=1.03))
    assert faults(found) == {}
    assert float(found["left against right"].text.split("right = ")[1].split()[0]) == pytest.approx(1 / 1.03, abs=0.01)


@pytest.mark.parametrize("late_s", [0.4, 0.6, -0.5])
def test_a_late_sensor_is_found(late_s: float) -> None:
    found = findings(Robot(gyro_late_s=late_s))
    assert set(faults(found)) == {"timing"}
    assert ("gyro behind" if late_s > 0.0 else "wheels behind") in found["timing"].text
    assert float(found["timing"].text.split(" by ")[1].split()[0]) == pytest.approx(abs(late_s), abs=0.03)


@pytest.mark.parametrize("lost", range(60, 110, 2))
def test_a_turn_whose_begin_is_lost_tells_no_lag_that_is_not_there(lost: int) -> None:
    robot = Robot(legs=((0.0, 0.0, 5.0), (0.8, 0.0, 3.0), (0.0, 0.0, 1.0), (0.0, 0.5, 8.0)))
    gyro, wheels = robot.samples()
    found = {f.check: f for f in judge(gyro[:lost] + gyro[lost + 1 :], wheels, GEOMETRY, SAID)}
    assert found["timing"].outcome is not Outcome.FAULT


@pytest.mark.parametrize("held", [2, 3, 5])
def test_held_values_are_found(held: int) -> None:
    assert {"left values", "right values"} <= set(faults(findings(Robot(held=held))))


# ---- without a gyro ------------------------------------------------------------------------------------------------

NO_GYRO = replace(GEOMETRY, has_gyro=False)


@pytest.mark.parametrize(
    ("robot", "said", "words"),
    [
        (Robot(legs=STRAIGHT), Statement(drove=1), None),
        (Robot(legs=SPOT), Statement(turned=1), None),
        (Robot(legs=(*STRAIGHT, *SPOT)), SAID, None),
        (Robot(legs=STRAIGHT, left=-1.0), Statement(drove=1), "left wheel counts backwards"),
        (Robot(legs=STRAIGHT, right=-1.0), Statement(drove=1), "right wheel counts backwards"),
        (Robot(legs=STRAIGHT, left=-1.0, right=-1.0), Statement(drove=1), "both wheels count backwards"),
        (Robot(legs=(*STRAIGHT, *SPOT), swapped=True), SAID, "left and right are swapped"),
    ],
)
def test_without_a_gyro_the_users_word_is_the_only_measure(robot: Robot, said: Statement, words: str | None) -> None:
    found = findings(robot, said, NO_GYRO)
    assert faults(found) == {} if words is None else words in faults(found)["directions"].lower()
    assert faults(findings(robot, None, NO_GYRO)) == {}


@pytest.mark.parametrize("said", [Statement(drove=1), Statement(turned=1)])
def test_without_a_gyro_who_says_one_thing_may_have_done_the_other_too(said: Statement) -> None:
    long_turn: Legs = (*STAND, (0.0, 0.5, 40.0), *STAND)
    long_way: Legs = (*STAND, (0.5, 0.0, 20.0), *STAND)
    for legs in ((*STRAIGHT, *long_turn), (*long_way, *SPOT)):
        assert faults(findings(Robot(legs=legs), said, NO_GYRO)) == {}
    fault = faults(findings(Robot(right=-1.0, legs=STRAIGHT), Statement(drove=1), NO_GYRO))
    assert "the right wheel" in fault["directions"].lower()


# ---- never a false fault -------------------------------------------------------------------------------------------

leg = st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8), st.integers(1, 8).map(float))


@settings(deadline=None, max_examples=60)
@given(
    legs=st.lists(leg, min_size=1, max_size=8),
    left=st.floats(0.95, 1.05),
    right=st.floats(0.95, 1.05),
    scrub=st.floats(0.9, 1.7),
    slip=st.floats(0.0, 0.01),
    bias=st.floats(-0.1, 0.1),
    walk=st.floats(0.0, 1.0),
    late=st.floats(-0.1, 0.1),
    seed=st.integers(0, 10_000),
)
def test_a_right_wired_robot_is_never_accused(
    legs: list[tuple[float, float, float]],
    left: float,
    right: float,
    scrub: float,
    slip: float,
    bias: float,
    walk: float,
    late: float,
    seed: int,
) -> None:
    robot = Robot(
        legs=(*STAND, *legs, *STAND),
        left=left,
        right=right,
        scrub=scrub,
        slip_m_per_sqrt_m=slip,
        bias_deg_s=bias,
        walk_deg_per_sqrt_h=walk,
        gyro_late_s=late,
        seed=seed,
    )
    assert faults(findings(robot)) == {}
    assert faults(findings(robot, None, NO_GYRO)) == {}


times = st.lists(st.floats(0.01, 5.0), max_size=60)
motions = st.sampled_from([0.0, 1e-9, 0.1, -0.1, 3.0, 1e6])


@settings(deadline=None, max_examples=60)
@given(gyro=times, wheels=times, data=st.data(), has_gyro=st.booleans())
def test_no_samples_are_too_odd_to_be_judged(
    gyro: list[float], wheels: list[float], data: st.DataObject, has_gyro: bool
) -> None:
    gyro_ns, wheels_ns = (np.cumsum([0.0, *steps]) * NS_PER_S for steps in (gyro, wheels))
    turned = [GyroSample(int(t), 0.1, data.draw(motions), math.nan) for t in gyro_ns[1:]]
    moved = [WheelSample(int(t), 0.05, data.draw(motions), data.draw(motions), 0.0) for t in wheels_ns[1:]]
    said = data.draw(st.sampled_from([None, SAID, Statement(drove=-1), Statement(turned=-1, distance_m=2.0)]))
    found = judge(turned, moved, replace(GEOMETRY, has_gyro=has_gyro), said)
    assert found
    assert all(f.check and f.text and "nan" not in f.text for f in found)
    assert all(f.remedy for f in found if f.outcome is Outcome.FAULT)


# ---- how it is told ------------------------------------------------------------------------------------------------


def test_the_table_has_each_finding_and_counts_them() -> None:
    found = judge(*Robot(gyro=-1.0).samples(), GEOMETRY)
    text = table(found, width=90)
    assert all(f.check in text for f in found)
    assert max(map(len, text.splitlines())) <= 90
    assert f"{len(found)} checks: " in text
    assert "1 FAULT" in text.splitlines()[-1]
    (line,) = sentences(found)
    assert line.startswith("wiring: directions: gyro and wheels turn in opposite directions: over ")
    assert sentences(judge(*Robot().samples(), GEOMETRY)) == []


def test_an_hour_without_a_turn_in_it_is_no_fault() -> None:
    legs: Legs = (*STAND, *(((1.0, 0.0, 300.0), (0.0, 0.0, 10.0)) * 3))
    assert faults(findings(Robot(legs=legs, slip_m_per_sqrt_m=0.005, left=1.01))) == {}


@pytest.mark.parametrize("stand_s", [4.0, 4.5, 5.0, 5.9])
def test_a_drive_right_before_the_end_is_counted_as_a_whole(stand_s: float) -> None:
    robot = Robot(legs=((0.0, 0.0, stand_s), (1.0, 0.0, 1.9), (0.0, 0.0, 0.1)))
    found = findings(robot, Statement(drove=1, distance_m=1.9))
    assert faults(found) == {}
    assert found["distance"].outcome is Outcome.GOOD


def test_a_lost_gyro_sample_takes_nothing_of_the_distance() -> None:
    gyro, wheels = Robot(legs=(*STAND, (1.0, 0.0, 2.0), *STAND, *SPOT)).samples()
    found = {f.check: f for f in judge(gyro[:50] + gyro[51:], wheels, GEOMETRY, Statement(1, 1, 2.0))}
    assert found["distance"].outcome is Outcome.GOOD


@pytest.mark.parametrize(
    ("factor", "outcome"),
    [(1.0, Outcome.UNKNOWN), (0.5, Outcome.FAULT), (2.0, Outcome.FAULT)],
)
def test_a_distance_of_which_a_part_is_in_a_gap_is_no_fault(factor: float, outcome: Outcome) -> None:
    robot = Robot(left=factor, right=factor, legs=(*STAND, (0.5, 0.0, 6.0), *STAND, *SPOT))
    gyro, wheels = robot.samples()
    seen = [s for s in wheels if not 6.0 < s.t_ns * 1e-9 <= 7.0]
    found = {f.check: f for f in judge(gyro, seen, GEOMETRY, Statement(1, 1, 3.0))}
    assert found["distance"].outcome is outcome
    assert "may be in gaps" in found["distance"].text or outcome is Outcome.FAULT
    assert "per configured one" not in found["distance"].remedy  # of twice the counts a sixth is missing


def test_a_counters_jump_takes_nothing_of_the_distance() -> None:
    gyro, wheels = Robot(legs=(*STAND, (1.0, 0.0, 2.0), *STAND, *SPOT)).samples()
    seen = [s for k, s in enumerate(wheels) if k not in (90, 95, 100, 105, 110)]
    found = {f.check: f for f in judge(gyro, seen, GEOMETRY, Statement(1, 1, 2.0))}
    assert found["distance"].outcome is Outcome.GOOD
    assert float(found["distance"].text.split()[0]) == pytest.approx(2.0, abs=0.02)


def test_gaps_are_left_out() -> None:
    gyro, wheels = Robot().samples()
    holed = [s for s in gyro if not 20.0 < s.t_ns * 1e-9 < 25.0]
    lost = [s for s in wheels if not 30.0 < s.t_ns * 1e-9 < 33.0]
    found = {f.check: f for f in judge(holed, lost, GEOMETRY)}
    assert faults(found) == {}
    assert math.isclose(float(found["turn ratio"].text.split("= ")[1].split()[0]), 1.0, abs_tol=0.02)


def test_the_running_daemon_does_not_load_it() -> None:
    program = "import sys, drd.service.daemon, drd.commands.run, drd.commands.check; print('drd.wiring' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "False"
