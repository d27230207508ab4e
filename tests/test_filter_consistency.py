"""The filter's covariance is honest: NEES and NIS lie within their chi-square bounds over seeds."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import chi2

from drd.config import Noise
from drd.filter import GYRO_SCALE, Filter, N, Outcome, Sigmas
from drd.noise import NoiseProfile, make_noise

TREAD_M = 0.588
SEEDS = 60
STEP_S = 0.05


def sigmas(gyro_scale: float) -> Sigmas:
    return Sigmas(
        position_m=0.02, heading_rad=0.01, wheel_scale=0.003, tread_m=0.006, gyro_scale=gyro_scale, gyro_bias_rad_s=2e-4
    )


class Truth:
    """A robot drawn from the prior and driven with the process noise of the model; errors are computed minus true."""

    def __init__(self, rng: np.random.Generator, kf: Filter, s: Sigmas, k: NoiseProfile):
        self.rng, self.k, self.kf = rng, k, kf
        draw = rng.normal(size=N - 1)
        self.x, self.y, self.heading = -s.position_m * draw[0], -s.position_m * draw[1], -s.heading_rad * draw[2]
        self.scale_right, self.scale_left = s.wheel_scale * draw[3], s.wheel_scale * draw[4]
        self.tread = TREAD_M - s.tread_m * draw[5]
        self.gyro_scale, self.bias = 1.0 - s.gyro_scale * draw[6], -s.gyro_bias_rad_s * draw[7]
        self.gyro_walk = -s.heading_rad * draw[2] - self.heading

    def drive(self, t_s: float) -> tuple[float, float, float]:
        """One step of motion; what the encoders and the gyro read over it (left, right, rate)."""
        k, rng = self.k, self.rng
        speed, rate = 1.0, 0.5 * math.sin(0.35 * t_s) + 0.2
        right, left = (speed + 0.5 * rate * self.tread) * STEP_S, (speed - 0.5 * rate * self.tread) * STEP_S
        turn = rate * STEP_S
        slip_r, slip_l = (math.sqrt(k.wheel_m2_per_m * u) * rng.normal() for u in (right, left))
        middle = self.heading + 0.5 * turn
        side = math.sqrt(k.lateral_m2_per_m * 0.5 * (right + left)) * rng.normal()
        self.x += speed * STEP_S * math.cos(middle) - side * math.sin(middle)
        self.y += speed * STEP_S * math.sin(middle) + side * math.cos(middle)
        self.x += math.sqrt(k.position_m2_per_rad * abs(turn)) * rng.normal()
        self.y += math.sqrt(k.position_m2_per_rad * abs(turn)) * rng.normal()
        self.heading += turn
        skid = math.sqrt(k.turn_rad2_per_rad * abs(turn)) * rng.normal() * 0.5 * self.tread
        read_right, read_left = right + slip_r + skid, left + slip_l - skid
        gyro = turn + math.sqrt(k.gyro_rad2_per_s * STEP_S) * rng.normal()
        reading = (gyro / STEP_S - self.bias) / self.gyro_scale
        self.scale_right += math.sqrt(k.wheel_scale_per_m * right) * rng.normal()
        self.scale_left += math.sqrt(k.wheel_scale_per_m * left) * rng.normal()
        self.tread += math.sqrt(k.tread_m2_per_rad * abs(turn)) * rng.normal()
        self.bias += math.sqrt(k.gyro_bias_rad2_s2_per_s * STEP_S) * rng.normal()
        return read_left / (1.0 - self.scale_left), read_right / (1.0 - self.scale_right), reading

    def error(self) -> npt.NDArray[np.float64]:
        """The error state without the gyro's heading: the eight that a truth exists for."""
        n = self.kf.nominal
        return np.array(
            [
                n.x_m - self.x,
                n.y_m - self.y,
                n.heading_rad - self.heading,
                self.scale_right - n.scale_right,
                self.scale_left - n.scale_left,
                n.tread_m - self.tread,
                n.gyro_scale - self.gyro_scale,
                n.gyro_bias_rad_s - self.bias,
            ]
        )


STATES = [0, 1, 2, 3, 4, 5, 7, 8]


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
