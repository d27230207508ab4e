"""The simulated sensors keep to their datasheets, and share noise with and without effects."""

import hashlib
import math
from dataclasses import replace
from pathlib import Path

import allantools
import numpy as np
import pytest

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect, Values
from drd.units import RAD_PER_DEG, S_PER_H
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.result import table
from drd_tools.simulate.conditions import GROUNDS, PERFECT, Conditions, Ground, Reference, scatter, stream, wandering
from drd_tools.simulate.missions import Drive, make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.route import RATE_HZ, STEP_S, Steps
from drd_tools.simulate.simulator import Simulated, simulate
from drd_tools.simulate.truth import Truth, make_truth

COUNT_M = 2.0 * math.pi * 0.11 / 20000.0


def truth_of(speed_m_s: Array, rate_rad_s: Array) -> Truth:
    """Of step means at 500 Hz."""
    return make_truth(Drive(Steps(speed_m_s * STEP_S, rate_rad_s * STEP_S), 0), "warmup")


def rates(simulated: Simulated) -> Array:
    assert simulated.recording.fog is not None
    return simulated.recording.fog.rate_rad_s


def counts(simulated: Simulated) -> tuple[Array, Array]:
    log = simulated.recording.encoders
    assert log.left_counts is not None
    assert log.right_counts is not None
    return log.left_counts, log.right_counts


def digest(simulated: Simulated) -> str:
    r = simulated.recording
    assert r.fog is not None
    assert r.reference is not None
    arrays = (r.fog.time_s, r.fog.rate_rad_s, *counts(simulated), r.reference.x_m, r.reference.heading_rad)
    return hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest()


def test_the_gyros_noise_is_that_of_its_datasheet() -> None:
    seconds, sheet = 3600, replace(DEFAULT, gyro_bias_random_walk_deg_per_h_per_sqrt_h=20.0)
    still = np.zeros(seconds * RATE_HZ)
    simulated = simulate(truth_of(still, still), sheet, seed=5)
    rate_deg_s = rates(simulated) / RAD_PER_DEG
    taus, adev, _, _ = allantools.oadev(rate_deg_s, rate=10.0, data_type="freq", taus=[0.5, 1.0, 2.0, 500.0])
    walk = 60.0 * adev * np.sqrt(taus)  # deg/sqrt(h): sigma = N / sqrt(tau)
    np.testing.assert_allclose(walk[:3], 0.0833, rtol=0.08)
    # sigma = K sqrt(tau / 3), with the angle random walk's share; some seven independent spans.
    drift = 20.0 / S_PER_H / 60.0 * math.sqrt(500.0 / 3.0)
    expected = math.hypot(drift, 0.0833 / 60.0 / math.sqrt(500.0))
    assert 0.3 < adev[3] / expected < 2.5


def test_the_bias_is_as_repeatable_as_its_datasheet_says() -> None:
    truth = truth_of(np.zeros(RATE_HZ), np.zeros(RATE_HZ))
    biases = [simulate(truth, DEFAULT, seed=seed).bias_rad_s / RAD_PER_DEG for seed in range(300)]
    assert np.std(biases) == pytest.approx(0.02, rel=0.15)  # 3.7 sigma of 300
    assert abs(np.mean(biases)) < 4.0 * 0.02 / math.sqrt(300)


def test_slip_noise_grows_with_the_root_of_the_way() -> None:
    speed = np.full(600 * RATE_HZ, 1.5)
    simulated = simulate(truth_of(speed, np.zeros_like(speed)), DEFAULT, seed=2)
    left, right = (np.diff(side) * COUNT_M - 1.5 * 0.05 for side in counts(simulated))
    distance_m = 1.5 * 0.05
    for errors in (left, right):
        # Rounding down adds the variance of the difference of two uniform numbers, 2/12 of a count squared.
        per_m = (errors.var() - COUNT_M**2 / 6.0) / distance_m
        assert math.sqrt(per_m) == pytest.approx(0.002, rel=0.03)  # 12000 values: 0.65 % each
    assert abs(np.corrcoef(left, right)[0, 1]) < 0.04
    # White: sums over 200 rows have 200 times the variance.
    sums = left.reshape(-1, 200).sum(axis=1)
    assert sums.std() / left.std() == pytest.approx(math.sqrt(200.0), rel=0.35)


def test_counts_are_whole_and_rounded_down() -> None:
    speed = np.full(20 * RATE_HZ, 0.3)
    forward, backward = (
        simulate(truth_of(sign * speed, np.zeros_like(speed)), DEFAULT, (), PERFECT) for sign in (1.0, -1.0)
    )
    at_s = forward.recording.encoders.time_s
    for simulated, sign in ((forward, 1.0), (backward, -1.0)):
        for side in counts(simulated):
            travel = sign * 0.3 * at_s / COUNT_M
            assert (side == np.round(side)).all()
            np.testing.assert_array_equal(side, np.floor(travel + 1e-6))
    assert (counts(forward)[0] <= 0.3 * at_s / COUNT_M + 1e-6).all()


def test_a_gyro_sample_is_the_mean_over_its_interval() -> None:
    time_s = (np.arange(10 * RATE_HZ) + 0.5) * STEP_S
    simulated = simulate(truth_of(np.zeros_like(time_s), 0.5 * np.sin(3.0 * time_s)), DEFAULT, (), PERFECT)
    assert simulated.recording.fog is not None
    ends = simulated.recording.fog.time_s
    np.testing.assert_allclose(ends, 0.1 * np.arange(1, 101), atol=1e-9)
    mean = 0.5 * (np.cos(3.0 * (ends - 0.1)) - np.cos(3.0 * ends)) / 3.0 / 0.1
    np.testing.assert_allclose(rates(simulated), mean, atol=2e-6)
    middle = 0.5 * np.sin(3.0 * (ends - 0.05))
    assert np.abs(rates(simulated) - middle).max() > 1e-4  # the test can tell them apart


def test_the_gyro_is_rounded_to_its_resolution_and_clipped_at_its_range() -> None:
    rate = np.linspace(-3.0, 3.0, 20 * RATE_HZ)
    simulated = simulate(truth_of(np.zeros_like(rate), rate), DEFAULT, seed=1)
    steps = rates(simulated) / RAD_PER_DEG / 0.004
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.abs(rates(simulated)).max() == pytest.approx(100.0 * RAD_PER_DEG)


def test_wheels_turn_as_the_tread_and_the_speed_demand() -> None:
    n = 10 * RATE_HZ
    simulated = simulate(truth_of(np.full(n, 0.5), np.full(n, 0.4)), DEFAULT, (), PERFECT)
    left, right = (side[-1] * COUNT_M for side in counts(simulated))
    assert left == pytest.approx(10.0 * (0.5 - 0.4 * 0.26), abs=2 * COUNT_M)
    assert right == pytest.approx(10.0 * (0.5 + 0.4 * 0.26), abs=2 * COUNT_M)


def test_without_counts_the_drive_reports_speeds_and_without_a_datasheet_there_is_no_gyro() -> None:
    robot = replace(DEFAULT, counts_per_revolution=None).without_gyro()
    n = 5 * RATE_HZ
    recording = simulate(truth_of(np.full(n, 0.55), np.zeros(n)), robot, (), PERFECT).recording
    assert recording.fog is None
    assert recording.encoders.left_rad_s is not None
    np.testing.assert_allclose(recording.encoders.left_rad_s[1:], 0.55 / 0.11, atol=1e-5)


def test_the_same_seed_gives_the_same_bits_and_another_one_does_not() -> None:
    truth, conditions = make_truth(make_drive("warehouse", 60.0)), Conditions(ground=GROUNDS["grass"], jitter_s=0.001)
    first, again, other = (digest(simulate(truth, DEFAULT, (), conditions, seed)) for seed in (4, 4, 5))
    assert first == again
    assert first != other
    assert digest(simulate(make_truth(make_drive("warehouse", 60.0)), DEFAULT, (), conditions, 4)) == first


def test_effects_leave_the_noise_as_it_is() -> None:
    truth = make_truth(make_drive("eights", 120.0))
    fine = replace(DEFAULT, gyro_resolution_deg_s=None)
    known = catalogue()
    effects = [(known["gyro_scale_error"], {"k": 0.01}), (known["wheel_radius_error"], {"left": 0.02, "right": 0.0})]
    for conditions in (Conditions(), Conditions(ground=GROUNDS["grass"], tails=4.0).stressed(3)):
        plain, changed = (simulate(truth, fine, e, conditions, seed=9) for e in ((), effects))
        exact_plain, exact = (
            simulate(truth, fine, e, replace(PERFECT, ground=conditions.ground), 9) for e in ((), effects)
        )
        bias = 0.01 * plain.bias_rad_s  # the scale error scales the bias, too
        np.testing.assert_allclose(rates(changed) - rates(plain), rates(exact) - rates(exact_plain) + bias, atol=5e-6)
        for a, b, c, d in zip(*(counts(s) for s in (changed, plain, exact, exact_plain)), strict=True):
            np.testing.assert_allclose(a - b, c - d, atol=2.0)


@pytest.mark.parametrize("source", ["gyro white", "left slip", "reference x"])
def test_a_longer_run_begins_with_the_noise_of_a_shorter_one(source: str) -> None:
    np.testing.assert_array_equal(
        scatter(10, stream(3, source), math.inf), scatter(20, stream(3, source), math.inf)[:10]
    )


def plausible(effect: Effect) -> Values:
    """Values near the middle of the plausible ranges, SI."""
    values: dict[str, float | str] = {}
    for p in effect.parameters:
        low, high = max(p.low, 1e-9), min(p.high, 60.0)
        middle = p.choices[0] if p.choices else math.sqrt(low * high) * p.si
        values[p.name] = {"t0": 20.0, "t1": 45.0, "delay": 0.1, "ratio": 1.01, "band": 0.1}.get(p.name, middle)
    return values


@pytest.mark.parametrize("effect", catalogue().values(), ids=lambda e: e.id)
def test_every_effect_of_the_catalogue_shows_in_what_it_acts_on(effect: Effect) -> None:
    truth = make_truth(make_drive("warehouse", 80.0), "rise:10:30")
    plain, changed = (simulate(truth, DEFAULT, e, seed=1) for e in ((), [(effect, plausible(effect))]))
    gyro = bool((rates(plain) != rates(changed)).any())
    wheels = any((a != b).any() for a, b in zip(counts(plain), counts(changed), strict=True))
    slides = bool(changed.truth.lateral_m_s.any())
    expected = {"gyro": (True, False, False), "wheels": (False, True, False), "body": (False, False, True)}
    assert (gyro, wheels, slides) == expected[effect.channel]
    assert np.isfinite(rates(changed)).all()
    np.testing.assert_array_equal(plain.truth.heading_rad, changed.truth.heading_rad)


@pytest.mark.parametrize(("mission", "bound_m"), [("square-cw", 0.002), ("field", 0.002), ("slalom", 0.016),
                                                   ("warehouse", 0.012), ("spins", 0.001)])  # fmt: skip
def test_the_replay_of_a_perfect_drive_is_the_true_path(mission: str, bound_m: float) -> None:
    """Up to some milliseconds of lag that is not there, found in samples of 50 and 100 ms, times the speed."""
    truth = make_truth(make_drive(mission, 200.0))
    rows = table(replay_folder(simulate(truth, DEFAULT, (), PERFECT).recording))
    off = [np.interp(rows[:, 0], truth.time_s, true) - got
           for true, got in zip((truth.x_m, truth.y_m, truth.heading_rad), rows[:, 1:4].T, strict=True)]  # fmt: skip
    assert np.hypot(off[0], off[1]).max() < bound_m
    assert np.abs(off[2]).max() < math.radians(0.02)


def test_a_body_that_slides_leaves_the_path_that_the_sensors_tell() -> None:
    truth = make_truth(make_drive("eights", 100.0))
    slip = [(catalogue()["lateral_slip_turning"], {"k": 0.05})]
    simulated = simulate(truth, DEFAULT, slip, PERFECT)
    np.testing.assert_allclose(simulated.truth.lateral_m_s, -0.05 * truth.speed_m_s * truth.rate_rad_s, atol=1e-12)
    assert np.hypot(simulated.truth.x_m - truth.x_m, simulated.truth.y_m - truth.y_m).max() > 0.05
    reference = simulated.recording.reference
    assert reference is not None
    np.testing.assert_allclose(reference.x_m, np.interp(reference.time_s, truth.time_s, simulated.truth.x_m), atol=1e-5)


def test_the_reference_is_as_good_late_and_off_the_centre_as_asked() -> None:
    n = 400 * RATE_HZ
    truth = truth_of(np.full(n, 1.0), np.zeros(n))
    reference = Reference(period_s=0.1, latency_s=0.05, lever_m=(0.3, -0.2))
    log = simulate(truth, DEFAULT, (), Conditions(reference=reference), 1).recording.reference
    assert log is not None
    along, across = log.x_m[5:] - log.time_s[5:], log.y_m[5:]
    assert along.mean() == pytest.approx(0.3 - 0.05, abs=0.001)
    assert across.mean() == pytest.approx(-0.2, abs=0.001)
    assert along.std() == pytest.approx(0.01, rel=0.05)
    assert np.degrees(log.heading_rad.std()) == pytest.approx(0.15, rel=0.05)


@pytest.mark.parametrize(("text", "rows"), [("full", 1201), ("sparse:60", 3), ("ends", 2), ("none", None)])
def test_the_reference_is_there_when_asked(text: str, rows: int | None) -> None:
    conditions = Conditions(reference=Reference.parse(text))
    log = simulate(make_truth(make_drive("eights", 120.0)), DEFAULT, (), conditions).recording.reference
    assert (None if log is None else len(log.time_s)) == rows


def test_heavy_tails_have_the_scatter_of_the_datasheet() -> None:
    heavy, light = scatter(200_000, stream(1, "x"), 5.0), scatter(200_000, stream(1, "x"), math.inf)
    assert heavy.std() == pytest.approx(1.0, rel=0.03)
    assert (np.abs(heavy) > 4.0).sum() > 10 * (np.abs(light) > 4.0).sum()


def test_the_ground_wanders_along_the_way() -> None:
    distance_m = np.linspace(0.0, 5000.0, 100_001)
    values = wandering(distance_m, 0.5, stream(2, "y"))
    assert values.std() == pytest.approx(1.0, rel=0.04)
    lag = round(0.5 / 0.05)  # one correlation length
    assert np.corrcoef(values[:-lag], values[lag:])[0, 1] == pytest.approx(math.exp(-1.0), abs=0.04)


def test_a_skidding_robot_has_a_wandering_tread_and_slides() -> None:
    truth = make_truth(make_drive("spins"))
    ground = Ground(skid=0.1, centre_m=0.05)
    simulated = simulate(truth, DEFAULT, (), replace(PERFECT, ground=ground), 3)
    m, turning = simulated.motion, np.abs(truth.rate_rad_s) > 0.05
    tread_m = (m.right_m_s - m.left_m_s)[turning] / truth.rate_rad_s[turning]
    assert tread_m.mean() == pytest.approx(0.52, rel=0.05)
    assert tread_m.std() == pytest.approx(0.52 * 0.1 / math.sqrt(2.0), rel=0.35)
    assert 0.02 < (simulated.truth.lateral_m_s[turning] / truth.rate_rad_s[turning]).std() < 0.08


def test_bumps_only_ever_add_travel() -> None:
    speed = np.full(400 * RATE_HZ, 1.0)
    ground = Ground(bump_per_m=0.5, bump_m=0.002)
    truth = truth_of(speed, np.zeros_like(speed))
    plain, rough = (simulate(truth, DEFAULT, (), replace(PERFECT, ground=g), 1) for g in (Ground(), ground))
    for a, b in zip(counts(plain), counts(rough), strict=True):
        assert (np.diff(b - a) >= -1.0).all()
        assert (b - a)[-1] * COUNT_M == pytest.approx(400.0 * 0.5 * 0.002, rel=0.4)  # 200 bumps, each exponential


TOLD = """\
robot: {wheel_radius_m: 0.11, tread_m: 0.52}
encoders: {counts_per_revolution: 20000}
estimation:
  noise: {lateral_m_per_sqrt_m: 0, turn_rad_per_sqrt_rad: 0, turn_m_per_sqrt_rad: 0, wheel_scale_per_sqrt_m: 0,
    tread_per_sqrt_rad: 0, gyro_scale_per_sqrt_h: 0}
  initial: {wheel_scale: 0.002, tread: 0.01, gyro_scale: 0.001}
"""


def test_the_daemons_covariance_holds_on_simulated_drives(tmp_path: Path) -> None:
    """Robots drawn from what the filter is told: the pose's errors are as large as it claims."""
    config, known = tmp_path / "told.yaml", catalogue()
    config.write_text(TOLD)
    truth = make_truth(make_drive("warehouse", 180.0))
    squares = []
    for seed in range(14):
        left, right, tread, gyro = (
            np.random.default_rng(seed).standard_normal(4) * (0.002, 0.002, 0.01, 0.001)
        ).tolist()
        effects = [
            (known["wheel_radius_error"], {"left": left, "right": right}),
            (known["tread_error"], {"k": tread}),
            (known["gyro_scale_error"], {"k": gyro}),
        ]
        recording = simulate(truth, DEFAULT, effects, Conditions(), seed).recording
        pose = replay_folder(recording, config).poses[-1]
        error = np.array([pose.x_m - truth.x_m[-1], pose.y_m - truth.y_m[-1], pose.heading_rad - truth.heading_rad[-1]])
        xx, xy, xh, yy, yh, hh = pose.covariance
        squares.append(error @ np.linalg.solve(np.array([[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]]), error))
    # Chi-square with 42 degrees of freedom, over 14: 99.9 % of them lie between 1.37 and 5.5.
    assert 1.3 < np.mean(squares) < 5.5, squares
