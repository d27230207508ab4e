"""A warm restart claims no more than it can know."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn_robot import STATES, STEP_S, TREAD_M, Truth
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from drd.config.keys import Config
from drd.config.schema import loads
from drd.estimation.basis import Basis
from drd.estimation.estimate import Estimate, check_covariance
from drd.estimation.learning import Drive, Learned
from drd.estimation.state import GYRO_BIAS, GYRO_SCALE, HEADING, SCALE_L, SCALE_R, SLIP, TREAD, WHEEL_LAG, X, Y
from drd.pipeline import Pipeline
from drd.state.restart import Restart, duration, time_off_s, warm_restart
from drd.state.saved import Moment, Saved
from drd.units import NS_PER_S, RAD_PER_DEG

S, H = NS_PER_S, 3600 * NS_PER_S
WALL = 1_800_000_000 * S
THEN = Moment(WALL, 1000 * S, "a")
SEEDS = 60


@pytest.mark.parametrize(
    ("now", "chip", "expected_s"),
    [
        pytest.param(Moment(WALL + 5 * S, 1005 * S, "a"), True, 5.0, id="same boot"),
        pytest.param(Moment(WALL - 7 * H, 1005 * S, "a"), False, 5.0, id="same boot, clock stepped back"),
        pytest.param(Moment(WALL + 7 * H, 1005 * S, "a"), True, 5.0, id="same boot, clock stepped ahead"),
        pytest.param(Moment(WALL + 60 * S, 20 * S, "b"), True, 60.0, id="rebooted"),
        pytest.param(Moment(WALL + 60 * S, 20 * S, "b"), False, None, id="rebooted without a clock that goes on"),
        pytest.param(Moment(WALL - 1 * H, 20 * S, "b"), True, None, id="rebooted, clock went backward"),
        pytest.param(Moment(WALL + 60 * S, 2000 * S, "b"), True, None, id="this boot is longer than the clock says"),
        pytest.param(Moment(WALL + 5 * H, 60 * S, "b"), True, 18_000.0, id="hours ahead only widen more"),
        pytest.param(Moment(WALL + 5 * S, 1005 * S, ""), True, 5.0, id="boot not known, clocks agree"),
        pytest.param(Moment(WALL - 5 * H, 1005 * S, ""), True, None, id="boot not known, clock went backward"),
        pytest.param(Moment(WALL + 5 * H, 1005 * S, ""), True, 18_000.0, id="boot not known, clock ahead"),
        pytest.param(Moment(WALL + 60 * S, 20 * S, ""), True, 60.0, id="boot not known, uptime is less"),
        pytest.param(Moment(WALL + 5 * S, 900 * S, "a"), True, None, id="a boot id that lies"),
    ],
)  # fmt: skip
def test_the_time_off_is_never_less_than_the_clocks_can_vouch_for(
    now: Moment, chip: bool, expected_s: float | None
) -> None:
    found = time_off_s(THEN, now, chip)
    assert found == (None if expected_s is None else pytest.approx(expected_s))


@settings(deadline=None)
@given(st.integers(0, 10**9), st.integers(0, 10**9), st.integers(-(10**9), 10**9), st.booleans(), st.booleans())
def test_with_any_step_of_the_wall_clock_the_time_is_not_too_short(
    ran_s: int, off_s: int, step_s: int, rebooted: bool, chip: bool
) -> None:
    """With a boot's id. A clock set back over a reboot by less than it was off cannot be noticed: step from 0 then."""
    now = Moment(THEN.wall_ns + (off_s + step_s) * S, THEN.boottime_ns + off_s * S, "a")
    if rebooted:
        off_s += ran_s
        now = Moment(THEN.wall_ns + (off_s + abs(step_s)) * S, ran_s * S, "b")
    if now.wall_ns >= 0:
        found = time_off_s(THEN, now, chip)
        assert found is None or found >= off_s - 2.0


CONFIG = f"""\
robot: {{wheel_radius_m: 0.1, tread_m: {TREAD_M}, drive: differential}}
encoders: {{counts_per_revolution: 20000}}
estimation:
  initial: {{position_m: 0.02, heading_deg: 0.573, wheel_scale: 0.003, tread: 0.0102, gyro_scale: 0.004,
    gyro_bias_deg_s: 0.02, wheel_lag_s: 0}}
state: {{position_m: 0.3, heading_deg: 4}}
"""


def pipeline(text: str = CONFIG) -> Pipeline:
    return Pipeline(loads(text, Config).value, Path(), lambda *_: None)


def state(made: Pipeline, **changes: Any) -> Saved:
    kf = made.estimator.filter
    estimate = Estimate(dataclasses.replace(kf.nominal), kf.P.copy(), True, False, 0.0, 0.0)
    return Saved(dataclasses.replace(estimate, **changes), THEN, made.basis, "robot")


def after(off_s: float) -> Moment:
    return Moment(THEN.wall_ns + round(off_s * S), THEN.boottime_ns + round(off_s * S), "a")


UNKNOWN = Moment(THEN.wall_ns - 1, 20 * S, "b")


def restart(saved: Saved, now: Moment, text: str = CONFIG) -> tuple[Restart, Pipeline]:
    made = pipeline(text)
    config = loads(text, Config).value
    found = warm_restart(saved, now, config, made, clock_chip=True)
    check_covariance(found.estimate.P)
    made.resume(1, found.estimate, found.bias_known)
    return found, made


def step(truth: Truth, t_s: float) -> None:
    left, right, rate = truth.drive(t_s)
    truth.kf.predict(STEP_S, left, right, rate)
    truth.kf.update(rate)


def nees(seed: int, moved: bool) -> tuple[float, float]:
    """Of the pose and of all states, after a drive, two hours off, and another drive."""
    rng = np.random.default_rng(seed)
    first = pipeline()
    e = first.estimator
    e.filter.noise = dataclasses.replace(e.noise)  # known, not learned
    truth = Truth(rng, e.filter, e.sigmas, e.noise)
    for i in range(600):
        step(truth, i * STEP_S)
    off_s = 7200.0
    if moved:
        truth.x += 0.3 * rng.normal()
        truth.y += 0.3 * rng.normal()
        truth.heading += 4.0 * RAD_PER_DEG * rng.normal()
    settings, k = loads(CONFIG, Config).value.state, e.noise
    truth.scale_right += settings.wheel_scale * rng.normal()
    truth.scale_left += settings.wheel_scale * rng.normal()
    truth.tread += settings.tread * TREAD_M * rng.normal()
    truth.gyro_scale += math.sqrt(k.gyro_scale_per_s * off_s) * rng.normal()
    truth.bias += math.sqrt(k.gyro_bias_rad2_s2_per_s * off_s + k.gyro_bias_restart_rad2_s2) * rng.normal()
    truth.kf = restart(state(first), after(off_s))[1].estimator.filter
    truth.kf.noise = dataclasses.replace(e.noise)
    for i in range(600):
        step(truth, i * STEP_S)
    error = truth.error()
    P = truth.kf.P[np.ix_(STATES, STATES)]
    return float(error[:3] @ np.linalg.solve(P[:3, :3], error[:3])), float(error @ np.linalg.solve(P, error))


@pytest.mark.parametrize("moved", [False, True], ids=["left alone", "moved within sigma"])
def test_the_covariance_after_a_restart_is_honest(moved: bool) -> None:
    results = np.array([nees(seed, moved) for seed in range(SEEDS)])
    for dimension, values in ((3, results[:, 0]), (8, results[:, 1])):
        low, high = chi2.ppf([0.005, 0.995], dimension * SEEDS)
        # A robot that nobody moved is known better than claimed; that is the price of not knowing it.
        assert values.sum() < high, values.mean()
        assert not moved or values.sum() > low, values.mean()


def test_nothing_is_claimed_better_than_before_and_nothing_worse_than_at_a_cold_start() -> None:
    made = pipeline()
    cold = np.diag(made.estimator.filter.P).copy()
    made.estimator.filter.P[GYRO_BIAS, GYRO_BIAS] = 1e-12
    before = np.diag(made.estimator.filter.P).copy()
    last = before
    for off_s in (0.0, 60.0, 86_400.0, 1e9):
        found = np.diag(restart(state(made), after(off_s))[0].estimate.P)
        assert (found >= last).all()
        assert (found[SCALE_R:] <= np.maximum(cold, before)[SCALE_R:] * (1 + 1e-12)).sum() >= 5  # all but the heading
        last = found
    unknown = np.diag(restart(state(made), UNKNOWN)[0].estimate.P)
    assert unknown[GYRO_BIAS] == pytest.approx(cold[GYRO_BIAS])
    assert unknown[GYRO_SCALE] == pytest.approx(cold[GYRO_SCALE])


def test_a_robot_that_stood_goes_on_where_it_stood_and_says_so() -> None:
    made = pipeline()
    made.estimator.filter.set_pose(3.0, -2.0, 1.0, 0.0 * np.eye(3))
    found, other = restart(state(made), after(42.0))
    n, P = other.estimator.filter.nominal, other.estimator.filter.P
    assert (n.x_m, n.y_m, n.heading_rad, n.gyro_heading_rad) == (3.0, -2.0, 1.0, 1.0)
    assert P[X, X] == P[Y, Y] == pytest.approx(0.09)
    assert P[HEADING, HEADING] == pytest.approx((4 * RAD_PER_DEG) ** 2)
    assert found.text.startswith("warm restart after 42 s: where it stood, 0.3 m and 4 deg less certain; gyro bias")
    assert not found.estimate.lost


@pytest.mark.parametrize(("now", "lost"), [(after(4.0), False), (after(60.0), True), (UNKNOWN, True)])
def test_a_robot_that_was_moving_may_have_driven_on(now: Moment, lost: bool) -> None:
    """As after a silence of the encoders: within invalid_after_s it widens, later only set_pose makes it good."""
    found, _ = restart(state(pipeline(), at_rest=False, speed_m_s=1.5, rate_rad_s=0.2), now)
    assert found.estimate.lost is lost
    assert "last seen, moving" in found.text
    assert ("only set_pose" in found.text) is lost
    unseen_m = 1.5 * 4.0 + 0.5 * 4.0**2
    assert found.estimate.P[X, X] >= unseen_m**2
    assert found.estimate.P[HEADING, HEADING] > (0.2 * 4.0 + 0.25 * 4.0**2) ** 2


@pytest.mark.parametrize(("now", "lost"), [(after(599.0), False), (after(601.0), True), (UNKNOWN, True)])
def test_a_robot_that_stood_for_long_may_have_been_carried(now: Moment, lost: bool) -> None:
    found, _ = restart(state(pipeline()), now)
    assert found.estimate.lost is lost
    assert ("only set_pose or reset make it good" in found.text) is lost


def test_what_was_lost_stays_lost() -> None:
    assert restart(state(pipeline(), lost=True), after(1.0))[0].estimate.lost


def test_a_robot_that_restarts_at_its_dock_keeps_only_what_it_has_learned() -> None:
    made = pipeline()
    n = made.estimator.filter.nominal
    n.x_m, n.heading_rad, n.scale_left, n.gyro_bias_rad_s = 50.0, 2.0, 0.002, 1e-4
    made.estimator.filter.P[GYRO_BIAS, GYRO_BIAS] = 1e-12
    text = CONFIG.replace("{position_m: 0.3", "{pose: origin, position_m: 0.3")
    found, other = restart(state(made, at_rest=False, lost=True, speed_m_s=2.0), after(1e5), text)
    n, P = other.estimator.filter.nominal, other.estimator.filter.P
    assert (n.x_m, n.heading_rad, n.scale_left, n.gyro_bias_rad_s) == (0.0, 0.0, 0.002, 1e-4)
    assert P[X, X] == pytest.approx(0.02**2)
    assert not found.estimate.lost
    assert "at the origin, as state.pose says" in found.text


@pytest.mark.parametrize(
    ("change", "wheels", "gyro", "text"),
    [
        (("tread_m: 0.588", "tread_m: 0.6"), True, False, "robot.tread_m changed from 0.588 to 0.6"),
        (("wheel_radius_m: 0.1", "wheel_radius_m: 0.11"), True, False, "robot.wheel_radius_m changed from 0.1 to 0.11"),
        (
            ("estimation:", "fog: {positive: counterclockwise}\nestimation:"),
            False,
            True,
            "fog.positive changed from clockwise",
        ),
        (
            ("estimation:", "calibration: {file: c.yaml}\nestimation:"),
            False,
            True,
            "calibration changed from none to sha256",
        ),
        (("estimation:", "realtime: {fifo_priority: 5}\nestimation:"), False, False, "gyro bias known"),
    ],
)
def test_what_was_learned_with_another_geometry_or_calibration_does_not_apply(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: tuple[str, str], wheels: bool, gyro: bool, text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.yaml").write_text(
        "format: drd-gyro-calibration/1\n"
        "error_deg_s: {a0: [0.1, 0, 0], a1: [0, 0, 0], a2: [0, 0, 0], a3: [0, 0, 0]}\n"
        "rate_range_deg_s: [-90, 90]\ntemperature_range_c: [-10, 50]\nresidual_deg_s: 0.003\nprovenance: {who: me}\n"
    )
    made = pipeline()
    kf = made.estimator.filter
    kf.nominal.scale_left, kf.nominal.scale_right, kf.nominal.tread_m = 0.002, -0.001, 0.59
    kf.nominal.gyro_bias_rad_s, kf.nominal.gyro_scale = 1e-4, 1.001
    kf.P[GYRO_BIAS, GYRO_BIAS] = kf.P[SCALE_L, SCALE_L] = 1e-12
    kf.P[GYRO_BIAS, SCALE_L] = kf.P[SCALE_L, GYRO_BIAS] = 1e-13
    found, other = restart(state(made), after(60.0), CONFIG.replace(*change))
    n, P, cold = other.estimator.filter.nominal, other.estimator.filter.P, other.estimator.sigmas
    assert text in found.text
    tread_m = loads(CONFIG.replace(*change), Config).value.robot.tread_m
    assert (n.scale_left, n.scale_right, n.tread_m) == ((0.0, 0.0, tread_m) if wheels else (0.002, -0.001, 0.59))
    assert (n.gyro_bias_rad_s, n.gyro_scale) == ((0.0, 1.0) if gyro else (1e-4, 1.001))
    assert found.bias_known is not gyro
    assert math.isclose(P[GYRO_BIAS, GYRO_BIAS], cold.gyro_bias_rad_s**2) is gyro
    assert math.isclose(P[SCALE_L, SCALE_L], cold.wheel_scale**2) is wheels
    assert math.isclose(P[GYRO_BIAS, SCALE_L], 1e-13) is not (wheels or gyro)
    assert wheels is False or P[TREAD, TREAD] == cold.tread_m**2


DRIVE, GYRO = "drive: differential", "encoders:"
OFF = "fog: {protocol: none}\nencoders:"


@pytest.mark.parametrize(
    ("then", "now", "wheels", "lag"),
    [
        ((), (GYRO, "fog: {latency_s: 0.1}\nencoders:"), False, True),
        ((), ("20000}", "20000, latency_s: 0.1}"), False, True),
        ((), ("wheel_lag_s: 0.2", "wheel_lag_s: 0.1"), False, True),
        ((), ("estimation:", "estimation:\n  profile: paper"), True, True),
        ((), (GYRO, "fog: {protocol: dsp3000}\nencoders:"), False, True),
        ((), (GYRO, OFF), False, False),
        ((GYRO, OFF), (), True, True),
        ((), (DRIVE, "drive: skid"), True, False),
        ((DRIVE, "drive: auto"), (DRIVE, "drive: skid"), True, False),
        ((DRIVE, "drive: auto"), ("differential}", "auto}\nestimation: {heading: gyro}"), True, False),
    ],
    ids=str,
)
def test_lag_and_how_the_robot_steers_apply_where_they_were_learned_with_the_same(
    then: tuple[str, str], now: tuple[str, str], wheels: bool, lag: bool
) -> None:
    text = CONFIG.replace("wheel_lag_s: 0", "wheel_lag_s: 0.2")
    if "heading" in "".join(now):
        text = text.split("estimation:")[0]
    made = pipeline(text.replace(*then) if then else text)
    kf = made.estimator.filter
    kf.nominal.wheel_lag_s, kf.nominal.tread_m = 0.15, 0.59
    kf.P[WHEEL_LAG, WHEEL_LAG] = kf.P[TREAD, TREAD] = 1e-12
    found, other = restart(state(made, learned=Learned("skid")), after(60.0), text.replace(*now) if now else text)
    n, P, cold = found.estimate.nominal, found.estimate.P, other.estimator.sigmas
    assert ("the wheels' lag is learned again" in found.text) is lag
    assert n.wheel_lag_s == (0.0 if lag else 0.15)
    assert P[WHEEL_LAG, WHEEL_LAG] == pytest.approx(cold.wheel_lag_s**2 if lag else 1e-12)
    assert n.tread_m == (TREAD_M if wheels else 0.59)
    assert P[SLIP, SLIP] == pytest.approx(cold.slip_s**2)
    assert not wheels or P[TREAD, TREAD] >= cold.tread_m**2
    assert (found.estimate.learned.drive == "unknown") is wheels


def test_a_file_of_before_lag_and_drive_were_in_it_is_gone_on_from() -> None:
    with_gyro, without = pipeline(), pipeline(CONFIG.replace(GYRO, OFF))
    for made, is_kept in ((with_gyro, True), (without, False)):
        made.estimator.filter.nominal.tread_m = 0.59
        saved = state(made)
        old = dataclasses.replace(saved, basis=Basis(saved.basis.wheels, saved.basis.gyro, {}))
        found, _ = restart(old, after(5.0))
        assert ("learned again" not in found.text) is is_kept
        assert (found.estimate.nominal.tread_m == 0.59) is is_kept


def test_a_robot_that_was_found_to_skid_does_so_without_its_gyro() -> None:
    text = CONFIG.replace(DRIVE, "drive: auto")
    saved = state(pipeline(text), learned=Learned("skid"))
    _, other = restart(saved, after(5.0), text.replace(GYRO, OFF))
    assert other.estimator.knowledge.steering.drive is Drive.SKID


def test_a_model_of_the_gyro_starts_anew_and_the_bias_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = CONFIG + "model: {file: m.yaml}\n"
    for effect, parameters, anew in (
        ("gyro_bias_temperature", "b1: 0.001", True),
        ("wheel_radius_error", "left: 0.01", False),
    ):
        (tmp_path / "m.yaml").write_text(f"effects: [{{effect: {effect}, parameters: {{{parameters}}}}}]\n")
        made = pipeline(text)
        made.estimator.filter.P[GYRO_BIAS, GYRO_BIAS] = 1e-12
        found, _ = restart(state(made), after(5.0), text)
        assert found.bias_known is not anew
        assert ("the model takes" in found.text) is anew


def test_durations_read_well() -> None:
    assert [duration(t) for t in (4.0, 450.0, 11_520.0, 1e6)] == ["4 s", "7.5 min", "3.2 h", "11.6 days"]
