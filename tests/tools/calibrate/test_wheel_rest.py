"""Gyro noise and bias from the standstills of drives: known ones are found, too little standstill is told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from replay_folders import write_perfect
from wheel_recordings import Leg

from drd.units import RAD_PER_DEG
from drd_tools.calibrate.wheels.rest import BLOCK_S, FEWEST, Rest, at_rest
from drd_tools.calibrate.wheels.words import rest_sentences
from drd_tools.recordings.folder import Recording, read_recording

SHARED = Path(__file__).resolve().parents[3].parent / "shared/recordings"
LEGS: tuple[Leg, ...] = ((0.0, 0.0, 60.0), (0.5, 0.3, 20.0), (0.0, 0.0, 60.0))


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return read_recording(write_perfect(tmp_path_factory.mktemp("rest") / "drive", gyro=True, legs=LEGS))


def noisy(recording: Recording, deg_per_sqrt_h: float, bias_deg_s: float = 0.0, seed: int = 0) -> Recording:
    assert recording.fog is not None
    interval_s = float(np.median(np.diff(recording.fog.time_s)))
    sigma = deg_per_sqrt_h / 60.0 * RAD_PER_DEG / np.sqrt(interval_s)
    noise = np.random.default_rng(seed).normal(bias_deg_s * RAD_PER_DEG, sigma, len(recording.fog.time_s))
    return replace(recording, fog=replace(recording.fog, rate_rad_s=recording.fog.rate_rad_s + noise))


def found(*recordings: Recording) -> Rest:
    rest = at_rest(recordings)
    assert rest is not None
    return rest


@settings(deadline=None, max_examples=20)
@given(deg_per_sqrt_h=st.floats(0.01, 20.0), bias_deg_s=st.floats(-1.0, 1.0), seed=st.integers(0, 1000))
def test_a_known_noise_is_found(standing: Recording, deg_per_sqrt_h: float, bias_deg_s: float, seed: int) -> None:
    rest = found(noisy(standing, deg_per_sqrt_h, bias_deg_s, seed))
    assert rest.noise_deg_per_sqrt_h is not None
    assert abs(rest.noise_deg_per_sqrt_h - deg_per_sqrt_h) < 4.0 * rest.noise_sigma


def test_sigma_covers_the_error(standing: Recording) -> None:
    rests = [found(noisy(standing, 5.0, 0.1, seed)) for seed in range(60)]
    z = [((rest.noise_deg_per_sqrt_h or 0.0) - 5.0) / rest.noise_sigma for rest in rests]
    # 60 drives: the rms of a true z lies in 0.77 to 1.24 with 99 %.
    assert 0.7 < float(np.sqrt(np.mean(np.square(z)))) < 1.3


def test_noise_that_is_correlated_over_samples_is_not_underrated(standing: Recording) -> None:
    white = noisy(standing, 5.0)
    assert white.fog is not None
    smooth = np.convolve(white.fog.rate_rad_s, np.full(4, 0.25), mode="same")  # 0.4 s: a quarter of the variance
    rest = found(replace(white, fog=replace(white.fog, rate_rad_s=smooth)))
    assert rest.noise_deg_per_sqrt_h == pytest.approx(5.0, rel=0.25)


def test_motion_is_no_noise(standing: Recording) -> None:
    assert standing.fog is not None
    moving = np.abs(standing.fog.time_s - 70.0) < 10.0
    rate = np.where(moving, np.random.default_rng(1).normal(0.0, 1.0, len(moving)), standing.fog.rate_rad_s)
    rest = found(noisy(replace(standing, fog=replace(standing.fog, rate_rad_s=rate)), 1.0))
    assert rest.noise_deg_per_sqrt_h == pytest.approx(1.0, rel=0.2)
    assert rest.standstill_s < 120.0


def test_too_little_standstill_is_told(tmp_path: Path) -> None:
    legs: tuple[Leg, ...] = ((0.0, 0.0, FEWEST * BLOCK_S), (0.5, 0.3, 20.0))
    rest = found(read_recording(write_perfect(tmp_path / "drive", gyro=True, legs=legs)))
    assert rest.noise_deg_per_sqrt_h is None
    assert 0 < rest.differences < FEWEST
    assert "gyro noise: not determined" in rest_sentences(rest)[0]


def test_biases_that_differ_tell_the_repeatability(standing: Recording) -> None:
    biases = (-0.3, 0.1, 0.2, 0.5)
    rest = found(*(noisy(standing, 1.0, bias, k) for k, bias in enumerate(biases)))
    assert rest.bias_deg_s == pytest.approx(np.sqrt(np.mean(np.square(biases))), rel=0.05)
    assert rest.repeatability_deg_s == pytest.approx(np.std(biases, ddof=1), rel=0.1)
    alike = found(*(noisy(standing, 1.0, 0.1, k) for k in range(4)))
    assert alike.repeatability_deg_s is None
    assert found(*(noisy(standing, 1.0, bias) for bias in biases[:3])).bias_deg_s is None


def test_without_a_gyro_there_is_nothing_to_tell(standing: Recording) -> None:
    assert at_rest([replace(standing, fog=None)]) is None


@pytest.mark.recordings
def test_the_real_gyro_is_noisier_than_its_class() -> None:
    folders = sorted(SHARED.glob("warthog_*"))
    if not folders:
        pytest.skip("the shared recordings are not here")
    rest = found(*map(read_recording, folders))
    assert rest.noise_deg_per_sqrt_h is not None
    assert 3.0 < rest.noise_deg_per_sqrt_h < 10.0
    assert rest.noise_sigma < 0.1 * rest.noise_deg_per_sqrt_h
