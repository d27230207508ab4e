"""The budget mirrors the filter: sums to rounding, increments, and the parts that the comparisons reveal."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.arrays import Array
from drd.config.keys import Noise
from drd.estimation.filter import Filter, Outcome
from drd.estimation.noise import NoiseProfile, make_noise
from drd.estimation.state import GYRO_HEADING, HEADING, TREAD, N, Sigmas, X, Y
from drd.estimation.track import Track
from drd_tools.explain.budget import Budget
from drd_tools.explain.interval import Interval
from drd_tools.explain.parts import Parts
from drd_tools.explain.tap import TappedFilter
from drd_tools.limit import causes

SIGMAS = Sigmas(
    position_m=0.02,
    heading_rad=0.01,
    wheel_scale=0.003,
    tread_m=0.01,
    gyro_scale=0.004,
    gyro_bias_rad_s=2e-4,
    wheel_lag_s=0.1,
    slip_s=0.1,
    scale_difference=0.002,
)
PHYSICAL = replace(make_noise("physical", Noise(), 0.6, 1e-3), gyro_bias_restart_rad2_s2=1e-9)
STEP_S = 0.05
POSE = [X, Y, GYRO_HEADING]


def tapped(
    noise: NoiseProfile = PHYSICAL,
    from_s: float | None = None,
    keep_s: tuple[float, ...] = (1e6,),
    sigmas: Sigmas = SIGMAS,
    along_gyro: bool = True,
) -> Any:
    """A tapped filter with a clock of its own, and its interval."""
    interval = Interval(0, from_s, None, keep_s)
    interval.clock = cast(Track, SimpleNamespace(t_ns=0))
    return TappedFilter(interval, 0.6, sigmas, noise, 50.0, True, along_gyro), interval


def assert_equal(found: Array, P: Array) -> None:
    """Two covariances, to rounding, on the scale of their own standard deviations."""
    sigma = np.sqrt(np.maximum(np.diag(P), 1e-30))
    assert np.abs((found - P) / np.outer(sigma, sigma)).max() < 1e-6


def assert_mirrored(kf: Filter, interval: Interval) -> None:
    parts = interval.budget.parts
    assert parts is not None
    assert_equal(interval.budget.P.sum(axis=0), kf.P)
    assert_equal(parts.covariance.reshape(len(causes.GROUPS), N, -1, N).sum(axis=(0, 2)), kf.P)
    sigma = np.sqrt(np.maximum(np.diag(kf.P), 1e-30))
    assert np.abs(parts.mean.sum(axis=0) / sigma).max() < 1e-5
    for P in interval.budget.P:
        assert np.linalg.eigvalsh(P / np.outer(sigma, sigma))[0] > -1e-7


DRIVE = st.tuples(st.just("drive"), st.integers(1, 60), st.floats(-1.0, 1.5), st.floats(-1.0, 1.0))
BLIND = st.tuples(st.just("blind"), st.floats(0.0, 2.0), st.booleans())
ODOMETRY = st.tuples(st.just("odometry"), st.integers(1, 20), st.floats(0.0, 1.0))
ONCE = st.sampled_from(
    [
        ("slip",),
        ("bias",),
        ("silence",),
        ("set_pose",),
        ("restart",),
        ("hole",),
        ("skid",),
        ("put",),
        ("forget",),
        ("straight",),
    ]
)


def act(kf: Filter, event: tuple[Any, ...]) -> None:
    """What estimator and track do with the filter."""
    match event:
        case ("drive", steps, speed_m_s, rate_rad_s):
            half = 0.3 * rate_rad_s * STEP_S
            for k in range(steps):
                kf.predict(STEP_S, speed_m_s * STEP_S - half, speed_m_s * STEP_S + half, rate_rad_s + 1e-4, 1e-4)
                if k % 2:
                    kf.update(rate_rad_s)
        case ("odometry", steps, speed_m_s):
            for _ in range(steps):
                kf.predict(STEP_S, speed_m_s * STEP_S, 1.1 * speed_m_s * STEP_S, None)
                kf.anchor_gyro()
        case ("blind", variance, is_blind):
            kf.predict(STEP_S, 0.0, 0.0, None if is_blind else 0.3)
            kf.add_position_variance(variance)
            if is_blind:
                kf.add_heading_variance(variance, both=True)
            else:
                kf.anchor_wheels()
        case (name,):
            once(kf, name)


def once(kf: Filter, name: str) -> None:
    match name:
        case "slip":
            kf.add_heading_variance(0.01)
            kf.update(0.1)
        case "hole":
            kf.anchor_wheels()
            kf.add_heading_variance(0.01, both=True)
        case "bias":
            kf.set_gyro_bias(1e-3, 1e-5)
        case "silence":
            kf.add_gyro_bias_variance(1e-9)
        case "set_pose":
            kf.set_pose(1.0, 2.0, 0.5, np.diag([0.04, 0.04, 1e-4]))
            kf.lead_to_pose(1.2, 0.4)
        case "restart":
            kf.restart(0.6, SIGMAS)
        case "skid":
            kf.add_scale_variance(0.04, 0.03)
            kf.add_slip_variance(0.04)
        case "straight":
            kf.turn_by_gyro_alone(0.5)
            kf.forget_slip()
        case "put":
            kf.put(kf.nominal, 0.5 * kf.P)
        case "forget":
            kf.forget(TREAD, 0.3)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.one_of(DRIVE, DRIVE, BLIND, ODOMETRY, ONCE), min_size=1, max_size=12), st.booleans())
def test_the_causes_add_up_to_the_filters_covariance_whatever_happens(events: list[Any], paper: bool) -> None:
    kf, interval = tapped(make_noise("paper", Noise(), 0.6) if paper else PHYSICAL, along_gyro=not paper)
    for event in events:
        act(kf, event)
        assert_mirrored(kf, interval)


def test_a_filter_that_takes_over_goes_on_with_the_others_budget() -> None:
    """As at a reload: the second filter is made beside the first one, and copies it."""
    first, interval = tapped()
    act(first, ("drive", 30, 1.0, 0.4))
    brought = interval.budget.P[causes.GYRO_NOISE].copy()
    second = TappedFilter(interval, 0.6, SIGMAS, PHYSICAL, 50.0, recorded=False)
    assert np.array_equal(interval.budget.P[causes.GYRO_NOISE], brought)
    second.copy_from(first)
    act(second, ("drive", 30, 1.0, -0.4))
    assert_mirrored(second, interval)
    assert interval.budget.P[causes.GYRO_NOISE, GYRO_HEADING, GYRO_HEADING] > brought[GYRO_HEADING, GYRO_HEADING] > 0.0


def test_each_source_goes_to_its_own_cause() -> None:
    for field, cause in (
        ("wheel_m2_per_m", causes.SLIP_TRAVEL),
        ("turn_rad2_per_rad", causes.SLIP_HEADING),
        ("lateral_m2_per_m", causes.SLIP_SIDEWAYS),
        ("position_m2_per_rad", causes.SLIP_POSITION),
        ("wheel_scale_per_m", causes.WHEEL_SCALE_WALK),
        ("tread_m2_per_rad", causes.TREAD_WALK),
        ("gyro_rad2_per_s", causes.GYRO_NOISE),
        ("gyro_scale_per_s", causes.GYRO_SCALE_WALK),
        ("gyro_bias_rad2_s2_per_s", causes.BIAS_WALK),
        ("wheel_lag_s2_per_s", causes.LAG_WALK),
        ("timing_s2", causes.TIMING),
        ("jitter_s2", causes.JITTER),
        ("comparison_rad2", causes.COMPARISON),
    ):
        kf, interval = tapped(NoiseProfile(**({"comparison_rad2": 0.0} | {field: 1e-6})))
        interval.budget.forget(*range(N))
        kf.P[:] = np.diag(
            [0.0] * 3 + [1e-30] * (N - 3)
        )  # nothing is known badly; the comparison must have some variance
        kf.predict(STEP_S, 0.04, 0.06, 0.6)
        if cause in (causes.TIMING, causes.COMPARISON):
            kf.P[HEADING, HEADING] = 1e-9
            kf.nominal.heading_rad = kf.nominal.gyro_heading_rad  # else it were slip
            assert kf.update(0.4) is Outcome.ACCEPTED
        brought = np.flatnonzero(np.abs(interval.budget.P).max(axis=(1, 2)) > 0.0)
        assert brought.tolist() == [cause], field


def test_increments_are_those_of_a_filter_that_remembers_the_pose() -> None:
    """(59) against a state that is augmented by a copy of the pose: exact, whatever was known badly by then."""
    start_ns, at = 4_000_000_000, 80
    kf, interval = tapped(from_s=start_ns * 1e-9)
    A = np.zeros((N + 3, N + 3))
    pose = np.zeros(3)
    H = np.zeros(N + 3)
    H[HEADING], H[GYRO_HEADING] = 1.0, -1.0
    for k in range(200):
        n = kf.nominal
        if k == at:
            A = np.zeros((N + 3, N + 3))
            A[:N, :N] = kf.P
            A[N:, :N], A[:N, N:], A[N:, N:] = kf.P[POSE], kf.P[:, POSE], kf.P[np.ix_(POSE, POSE)]
            pose = np.array([n.x_m, n.y_m, kf.heading_rad])
        interval.clock.t_ns = round(k * STEP_S * 1e9)
        rate = 0.5 * math.sin(0.05 * k)
        kf.predict(STEP_S, 0.05 - 0.3 * rate * STEP_S, 0.05 + 0.3 * rate * STEP_S, rate)
        F = np.eye(N + 3)
        F[:N, :N] = kf._FT.T
        A = F @ A @ F.T
        A[:N, :N] += kf._Q
        if k % 2:
            K = np.zeros(N + 3)
            K[:N] = kf.P[HEADING] - kf.P[GYRO_HEADING]
            assert kf.update(rate) is Outcome.ACCEPTED
            K /= kf.S
            M = np.eye(N + 3) - np.outer(K, H)
            R = PHYSICAL.comparison_rad2 + PHYSICAL.timing_s2 * rate * rate
            A = M @ A @ M.T + R * np.outer(K, K)
    n = kf.nominal
    J = np.hstack([np.eye(N)[POSE], -np.eye(3)])
    J[0, -1], J[1, -1] = n.y_m - pose[1], -(n.x_m - pose[0])
    # The corrections move the nominal a little between the steps: the lever is that of the linearisation.
    assert np.allclose(interval.budget.P.sum(axis=0)[np.ix_(POSE, POSE)], J @ A @ J.T, rtol=1e-3, atol=1e-9)
    assert interval.budget.P.sum() != pytest.approx(kf.P.sum(), rel=1e-3)


def test_parts_are_the_conditional_means_of_a_dense_gaussian() -> None:
    """(60) against one large Gaussian of all that is random, conditioned on the comparisons at once."""
    random = np.random.default_rng(5)
    first, second = causes.TREAD_START, causes.GYRO_SCALE_START  # two groups; a third brings the comparisons' noise
    budget, parts = Budget(), Parts()
    budget.parts = parts
    steps, sources = 4, 2 * N + 4 * (2 * N + 1)
    x = np.zeros((3, N, sources))  # each group's state in terms of the sources, which are independent and of variance 1
    kept, z_rows, column = [], [], 2 * N
    for group, cause in enumerate((first, second)):
        root = random.normal(size=(N, N))
        x[group, :, group * N : (group + 1) * N] = root
        for i in range(N):
            for j in range(N):
                budget.add(cause, i, j, float((root @ root.T)[i, j]))
    H = np.zeros(N)
    H[HEADING], H[GYRO_HEADING] = 1.0, -1.0
    observed = random.normal(size=steps)
    for step in range(steps):
        F = np.eye(N) + 0.3 * random.normal(size=(N, N))
        Q = np.zeros((len(causes.CAUSES), N, N))
        x = F @ x
        for group, cause in enumerate((first, second)):
            root = 0.5 * random.normal(size=(N, N))
            Q[cause] = root @ root.T
            x[group, :, column : column + N] += root
            column += N
        budget.predict(F.T, Q, 0.0)
        R = np.zeros(len(causes.CAUSES))
        R[causes.TIMING] = 0.7
        noise = np.zeros(sources)
        noise[column] = math.sqrt(0.7)
        column += 1
        total = budget.P.sum(axis=0)
        K = total @ H / (H @ total @ H + 0.7)
        z_rows.append(H @ x.sum(axis=0) + noise)
        x = x - np.multiply.outer(K, np.ones(sources))[None] * (np.einsum("i,gis->gs", H, x))[:, None, :]
        x[2] -= np.outer(K, noise)
        budget.update(K, R, float(observed[step]))
        if step in (1, 3):
            kept.append(x[:, :3].copy())
            parts.keep(np.eye(3, N))
    Z = np.array(z_rows)
    gain = np.linalg.inv(Z @ Z.T)
    groups = [causes.GROUPS.index(name) for name in ("tread", "gyro scale", "latency")]
    y = np.concatenate([pose.reshape(-1, sources) for pose in kept])
    mean = (y @ Z.T @ gain @ observed).reshape(2, 3, 3)
    covariance = (y @ y.T - y @ Z.T @ gain @ Z @ y.T).reshape(2, 3, 3, 2, 3, 3)
    size = len(causes.GROUPS)
    found = parts.kept_covariance.reshape(2, size, 3, 2, size, 3)[:, groups][:, :, :, :, groups]
    assert np.allclose(parts.kept_mean[:, groups], mean, atol=1e-9)
    assert np.allclose(found, covariance, atol=1e-9)


def test_a_late_gyro_moves_the_pose_as_foretold() -> None:
    """The same drive with a gyro that is 10 ms late, less the drive without: what the linearisation says, (58)."""

    step_s = 0.25 * STEP_S

    def heading(t_s: float) -> float:
        return 0.8 * (1.0 - math.cos(0.6 * t_s))

    def drive(delay_s: float) -> tuple[Array, Array, float]:
        # A lag that is estimated would be found, and the estimator, not this filter, would shift the gyro's samples.
        noise, sigmas = replace(PHYSICAL, wheel_lag_s2_per_s=0.0), replace(SIGMAS, wheel_lag_s=0.0)
        kf, interval = tapped(noise, keep_s=(), sigmas=sigmas)
        poses, predicted = [], []
        for k in range(2400):
            t_s = k * step_s
            turn = heading(t_s + step_s) - heading(t_s)
            rate = (heading(t_s + step_s - delay_s) - heading(t_s - delay_s)) / step_s
            kf.predict(step_s, step_s - 0.3 * turn, step_s + 0.3 * turn, rate)
            assert kf.update(rate) is Outcome.ACCEPTED
            poses.append([kf.nominal.x_m, kf.nominal.y_m, kf.heading_rad])
            predicted.append(interval.budget.delay[POSE].copy())
        return np.array(poses), np.array(predicted), interval.delay_s

    poses, predicted, delay_s = drive(0.0)
    late = drive(delay_s)[0] - poses
    for k in range(3):
        assert np.abs(late[:, k]).max() > 3e-3
        # The rate is known as means over steps: the effect is predicted half a step late.
        assert np.abs(late - predicted)[:, k].max() < 0.2 * np.abs(late[:, k]).max()
