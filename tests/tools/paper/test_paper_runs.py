"""The daemon's classes on the paper's path: what the paper says of its filter and of its results."""

import dataclasses

import numpy as np
import pytest

from drd.config.file import load_config
from drd_tools.paper import physics as p
from drd_tools.paper.runs import CELLS, Laboratory, Outcome, Robot, informed, run_gyro
from drd_tools.paper.studies import STATES, delay_alone, sigmas_over_laps
from drd_tools.shipped import shipped_config


@pytest.fixture(scope="module")
def laboratory() -> Laboratory:
    physics = p.Physics()
    return Laboratory.make(informed(load_config(shipped_config("pioneer-at.yaml")).value, physics), physics)


@pytest.fixture(scope="module")
def outcomes(laboratory: Laboratory) -> list[Outcome]:
    """By their seeds."""
    return [run_gyro(laboratory, seed, runs_each_way=1) for seed in range(6)]


def test_the_path_is_the_papers(laboratory: Laboratory) -> None:
    for way, turn in zip(laboratory.ways, (-2 * np.pi, 2 * np.pi), strict=True):
        assert way.distance_m[-1] == pytest.approx(210.0, abs=0.1)
        assert way.heading_rad[-1] == pytest.approx(turn, abs=0.01)
        assert np.hypot(way.x_m[-1], way.y_m[-1]) < 0.1
        assert 150 < way.time_s[-1] < 200


def test_the_variances_do_what_the_paper_says(laboratory: Laboratory) -> None:
    time_s, sigma = sigmas_over_laps(laboratory)
    lap_s = time_s[-1] / 3
    start, one, two, three = (int(np.searchsorted(time_s, t)) for t in (15.0, lap_s, 2 * lap_s, time_s[-1]))
    by_name = dict(zip(STATES, sigma.T, strict=True))
    position = np.hypot(by_name["x"], by_name["y"])
    for growing in (position, by_name["heading"], by_name["gyro heading"]):  # unobservable
        assert growing[start] < growing[one] < growing[two] < growing[three]
    for scale in (by_name["right scale"], by_name["left scale"]):  # converge
        assert scale[one] < 0.8 * scale[0]
        assert scale[three] == pytest.approx(scale[one], rel=0.05)
    for slow in (by_name["tread"], by_name["gyro bias"]):  # diverge at a slow rate
        assert slow[one] < 1.01 * slow[two] < 1.01**2 * slow[three] < 2.0 * slow[start]  # the learned noise settles


def test_the_return_position_hides_a_delay(laboratory: Laboratory) -> None:
    for delay_s, at_return_m, on_the_way_m in delay_alone(laboratory, (0.0, 0.1)):
        assert at_return_m < 0.005
        # v tau (u(psi) - u(psi0)): up to twice 0.8 m/s in the corner where the robot has turned round.
        assert on_the_way_m == pytest.approx(2 * 0.8 * delay_s, abs=0.005)


def test_calibration_gains_an_order_and_the_filter_does_no_harm(outcomes: list[Outcome]) -> None:
    error = np.array([o.return_m for o in outcomes])
    assert error.shape == (6, 2, len(CELLS))
    neither, kalman, calibrated, both = error.mean(axis=(0, 1))
    assert neither > 4.0 * calibrated
    assert kalman < neither
    assert both < 1.15 * calibrated
    assert np.mean(error < [o.bound_m for o in outcomes]) > 0.95
    largest = np.array([o.largest_m for o in outcomes])
    assert (largest >= error).all()


def test_runs_repeat_by_their_seed(laboratory: Laboratory, outcomes: list[Outcome]) -> None:
    again = run_gyro(laboratory, 1, runs_each_way=1).return_m
    assert np.array_equal(outcomes[1].return_m, again)
    assert not np.array_equal(outcomes[0].return_m, again)


def robot(laboratory: Laboratory, **physics: float) -> Robot:
    """A robot whose wheels have no errors but these."""
    none = p.Robot(scale_sigma=0.0, tread_sigma=0.0, skid=0.0, pavement_m_per_sqrt_m=0.0, bump_per_m=0.0)
    changed = dataclasses.replace(laboratory.physics, robot=dataclasses.replace(none, **physics))
    return Robot(laboratory.config, changed, np.random.default_rng(1))


def test_the_samples_are_those_of_the_drive(laboratory: Laboratory) -> None:
    way = laboratory.ways[1]
    rates, steps = robot(laboratory).samples(way, 1)
    assert sum(s.rate_rad_s for s in rates) * 0.1 == pytest.approx(2 * np.pi, rel=0.02)
    left, right = (sum(getattr(s, side) for s in steps) for side in ("left_m", "right_m"))
    assert 0.5 * (left + right) == pytest.approx(way.distance_m[-1], abs=0.001)
    assert (right - left) / laboratory.config.robot.tread_m == pytest.approx(way.heading_rad[-1], abs=0.001)


def test_the_treads_fluctuation_and_the_pavement_are_as_large_as_stated(laboratory: Laboratory) -> None:
    way, turned, along = laboratory.ways[1], [], []
    for seed in range(40):
        _, steps = robot(laboratory, skid=0.02).samples(way, seed)
        turned.append(sum(s.right_m - s.left_m for s in steps) / laboratory.config.robot.tread_m)
        _, steps = robot(laboratory, pavement_m_per_sqrt_m=0.002).samples(way, seed)
        along.append(sum(s.left_m for s in steps))
    # Four corners of 6 m: 24 m / (2 x 0.5 m) independent pieces, of which a bend weighs the middle 1.5 times.
    assert np.std(turned) == pytest.approx(0.02 * 2 * np.pi * np.sqrt(1.5 / 24), rel=0.4)
    assert np.std(along) == pytest.approx(0.002 * np.sqrt(210.0), rel=0.4)


def test_bumps_only_ever_add_travel(laboratory: Laboratory) -> None:
    physics = laboratory.physics.robot
    _, steps = robot(laboratory, bump_per_m=physics.bump_per_m).samples(laboratory.ways[0], 2)
    added = sum(0.5 * (s.left_m + s.right_m) for s in steps) - laboratory.ways[0].distance_m[-1]
    assert added == pytest.approx(physics.bump_per_m * physics.bump_m * 210.0, rel=0.3)
