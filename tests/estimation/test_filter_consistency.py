"""The filter's covariance is honest: NEES and NIS lie within their chi-square bounds over seeds."""

import math

import numpy as np
import pytest
from drawn_robot import STATES, STEP_S, TREAD_M, Truth
from scipy.stats import chi2

from drd.config.keys import Noise
from drd.estimation.filter import Filter, Outcome
from drd.estimation.noise import make_noise
from drd.estimation.state import GYRO_SCALE, Sigmas

SEEDS = 60


def sigmas(gyro_scale: float) -> Sigmas:
    return Sigmas(
        position_m=0.02, heading_rad=0.01, wheel_scale=0.003, tread_m=0.006, gyro_scale=gyro_scale, gyro_bias_rad_s=2e-4
    )


def run(seed: int, gyro_scale: float, seconds: float = 60.0) -> tuple[float, float, list[float]]:
    """NEES of the pose, of all states with an uncertainty, and the NIS of each update."""
    rng = np.random.default_rng(seed)
    noise = make_noise("physical", Noise(), TREAD_M)
    s = sigmas(gyro_scale)
    kf = Filter(TREAD_M, s, noise, gate_sigma=100.0)
    truth, nis = Truth(rng, kf, s, noise), []
    for step in range(round(seconds / STEP_S)):
        left, right, rate = truth.drive(step * STEP_S)
        kf.predict(STEP_S, left, right, rate)
        if step % 2:
            jitter = math.sqrt(noise.comparison_rad2 + noise.timing_s2 * rate * rate) * rng.normal()
            kf.nominal.heading_rad += jitter
            before = kf.nominal.gyro_heading_rad
            assert kf.update(rate) is Outcome.ACCEPTED
            kf.nominal.heading_rad -= jitter
            assert kf.nominal.gyro_heading_rad != before
            nis.append(kf.z**2 / kf.S)
    error = truth.error()
    used = [i for i in range(8) if STATES[i] != GYRO_SCALE or gyro_scale]
    P = kf.P[np.ix_([STATES[i] for i in used], [STATES[i] for i in used])]
    e = error[used]
    return float(e[:3] @ np.linalg.solve(P[:3, :3], e[:3])), float(e @ np.linalg.solve(P, e)), nis


@pytest.mark.parametrize(("gyro_scale", "states"), [(0.004, 8), (0.0, 7)], ids=["scale estimated", "calibrated gyro"])
def test_nees_and_nis_lie_within_their_bounds(gyro_scale: float, states: int) -> None:
    results = [run(seed, gyro_scale) for seed in range(SEEDS)]
    for dimension, values in ((3, [r[0] for r in results]), (states, [r[1] for r in results])):
        total = sum(values)
        low, high = chi2.ppf([0.005, 0.995], dimension * SEEDS)
        assert low < total < high, f"NEES of {dimension} states: {total / SEEDS:.2f}"
    nis = np.concatenate([r[2][::10] for r in results])  # every tenth: thousands are enough to find 6 %
    low, high = chi2.ppf([0.005, 0.995], len(nis)) / len(nis)
    assert low < nis.mean() < high, f"NIS: {nis.mean():.3f}, expected {low:.3f} to {high:.3f}"
