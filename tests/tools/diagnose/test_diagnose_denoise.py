"""Smoothing that follows what changes and not what is noise."""

import numpy as np
import pytest

from drd_tools.diagnose.error_model.denoise import denoised

SIGMA, WIDTH = 0.01, 3.0


def test_what_is_constant_keeps_little_of_its_noise() -> None:
    rng = np.random.default_rng(1)
    noise = SIGMA * rng.standard_normal((20, 3000))
    smooth = np.array([denoised(1.2 + row, SIGMA, WIDTH) - 1.2 for row in noise])
    # Of Gaussian weights of 3 and of 48 samples: 0.31 and 0.08 of the noise are left.
    assert smooth.std() < 0.12 * SIGMA
    # What a sample's own noise does to its smoothed value: 0.133 with the narrow window.
    assert float((smooth * noise).mean() / SIGMA**2) < 0.03


@pytest.mark.parametrize("length", [4, 30, 400])
def test_a_change_that_is_seen_is_followed(length: int) -> None:
    rng = np.random.default_rng(2)
    ramp = np.clip((np.arange(2000) - 1000) / length, 0.0, 1.0)
    error = denoised(ramp + SIGMA * rng.standard_normal(2000), SIGMA, WIDTH) - ramp
    narrow = np.convolve(ramp, np.exp(-0.5 * (np.arange(-20, 21) / WIDTH) ** 2), "same") / (WIDTH * np.sqrt(2 * np.pi))
    worst = float(np.abs(narrow - ramp)[50:-50].max())
    assert np.abs(error[50:-50]).max() < 1.5 * worst + 3.0 * SIGMA


def test_without_noise_nothing_but_the_narrowest_window_is_used() -> None:
    values = np.cumsum(np.random.default_rng(3).standard_normal(500))
    twice = denoised(values, 0.0, WIDTH)
    assert np.abs(twice - values).max() < np.abs(denoised(values, 100.0, WIDTH) - values).max()


def test_short_series_are_smoothed_too() -> None:
    assert denoised(np.ones(5), SIGMA, WIDTH) == pytest.approx(1.0)
