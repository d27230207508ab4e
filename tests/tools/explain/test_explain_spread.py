"""With one cause switched on, the actual errors over seeds spread as that cause's line of the budget says."""

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.stats import chi2

from drd.arrays import Array
from drd.config.keys import Noise
from drd.estimation.filter import Filter, Outcome
from drd.estimation.noise import make_noise
from drd.estimation.state import GYRO_HEADING, Sigmas, X, Y
from drd.estimation.track import Track
from drd_tools.explain.interval import Interval
from drd_tools.explain.tap import TappedFilter
from drd_tools.limit.causes import GROUPS, by_group

TREAD_M, STEP_S, STEPS, SEEDS = 0.588, 0.05, 500, 40
POSE = [X, Y, GYRO_HEADING]
BEGIN_S = 10.0  # errors count from the pose there
SIGMAS = Sigmas(
    position_m=0.0, heading_rad=0.0, wheel_scale=0.003, tread_m=0.01, gyro_scale=0.004, gyro_bias_rad_s=4e-4
)
NOISE = make_noise("physical", Noise(), TREAD_M, 1e-3)


def drive(kf: Filter, clock: SimpleNamespace, cause: str, random: np.random.Generator) -> tuple[Array, Array]:
    """Drive with only `cause` at work; the true and the estimated poses, shape (STEPS + 1, 3) each."""
    on = {name: float(name == cause) for name in GROUPS}
    scales = on["wheel scales"] * SIGMAS.wheel_scale * random.normal(size=2)
    tread_m = TREAD_M - on["tread"] * SIGMAS.tread_m * random.normal()
    gyro_scale = 1.0 - on["gyro scale"] * SIGMAS.gyro_scale * random.normal()
    bias = -on["gyro bias"] * SIGMAS.gyro_bias_rad_s * random.normal()
    x = y = heading = 0.0
    n = kf.nominal
    true, estimated = [[x, y, heading]], [[n.x_m, n.y_m, kf.heading_rad]]
    for step in range(STEPS):
        clock.t_ns = round(step * STEP_S * 1e9)
        rate = 0.5 * math.sin(0.35 * step * STEP_S) + 0.2
        turn, way = rate * STEP_S, STEP_S
        travel = np.array([way - 0.5 * turn * tread_m, way + 0.5 * turn * tread_m])
        slip, skid, side, place_x, place_y, gyro = random.normal(size=6)
        on_slip = on["slip noise"]
        middle = heading + 0.5 * turn
        side *= on_slip * math.sqrt(NOISE.lateral_m2_per_m * way)
        place = on_slip * math.sqrt(NOISE.position_m2_per_rad * abs(turn))
        x += way * math.cos(middle) - side * math.sin(middle) + place * place_x
        y += way * math.sin(middle) + side * math.cos(middle) + place * place_y
        heading += turn
        travel += on_slip * np.sqrt(NOISE.wheel_m2_per_m * travel) * np.array([slip, random.normal()])
        skid *= on_slip * math.sqrt(NOISE.turn_rad2_per_rad * abs(turn)) * 0.5 * tread_m
        left, right = (travel + np.array([-skid, skid])) / (1.0 - scales)
        read = turn + on["gyro noise"] * math.sqrt(NOISE.gyro_rad2_per_s * STEP_S) * gyro
        reading = (read / STEP_S - bias) / gyro_scale
        kf.predict(STEP_S, left, right, reading)
        if step % 2:
            # The comparison's noise is believed in, and is not at work: only its cause's line may tell of it.
            assert kf.update(reading) is Outcome.ACCEPTED
        scales = scales + on["wheel scales"] * np.sqrt(NOISE.wheel_scale_per_m * travel) * random.normal(size=2)
        tread_m += on["tread"] * math.sqrt(NOISE.tread_m2_per_rad * abs(turn)) * random.normal()
        gyro_scale += on["gyro scale"] * math.sqrt(NOISE.gyro_scale_per_s * STEP_S) * random.normal()
        bias += on["gyro bias"] * math.sqrt(NOISE.gyro_bias_rad2_s2_per_s * STEP_S) * random.normal()
        true.append([x, y, heading])
        estimated.append([n.x_m, n.y_m, kf.heading_rad])
    return np.array(true), np.array(estimated)


def increment(poses: Array) -> Array:
    """The last pose as seen from that at BEGIN_S."""
    first, last = poses[round(BEGIN_S / STEP_S)], poses[-1]
    dx, dy, turn = last - first
    c, s = math.cos(first[2]), math.sin(first[2])
    return np.array([c * dx + s * dy, c * dy - s * dx, turn])


@pytest.fixture(scope="module")
def budget() -> Array:
    """Of the increment, by group, in the axes at BEGIN_S, from a drive without any error: (groups, 3, 3)."""
    interval, clock = Interval(0, BEGIN_S, None), SimpleNamespace(t_ns=0)
    interval.clock = cast(Track, clock)
    kf = TappedFilter(interval, TREAD_M, SIGMAS, NOISE, 100.0)
    _, estimated = drive(kf, clock, "none", np.random.default_rng(0))
    angle = estimated[round(BEGIN_S / STEP_S), 2]
    c, s = math.cos(angle), math.sin(angle)
    T = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    turned: Array = T @ by_group(interval.budget.P[:, POSE][:, :, POSE]) @ T.T
    return turned


@pytest.mark.parametrize("cause", ["gyro noise", "gyro bias", "gyro scale", "wheel scales", "tread", "slip noise"])
def test_errors_spread_as_the_budget_says(budget: Array, cause: str) -> None:
    found = []
    for seed in range(SEEDS):
        kf = Filter(TREAD_M, SIGMAS, NOISE, gate_sigma=100.0)
        true, estimated = drive(kf, SimpleNamespace(t_ns=0), cause, np.random.default_rng([seed, 7]))
        found.append(increment(estimated) - increment(true))
    expected = np.diag(budget[GROUPS.index(cause)])
    low, high = chi2.ppf([0.0005, 0.9995], SEEDS) / SEEDS
    ratio = np.mean(np.square(found), axis=0) / expected
    assert (ratio > low).all() and (ratio < high).all(), f"{ratio} not within {low:.2f} to {high:.2f}"  # noqa: PT018
