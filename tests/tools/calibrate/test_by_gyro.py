"""Tread and radii by a gyro, where no reference tells them."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_drives import FAR, LEFT, RIGHT, SLALOM, TREAD, WHEELS_S, recorded

from drd_tools.calibrate.wheels.by_gyro import fit_by_gyro

DRIVES = 12


def test_tread_and_difference_are_those_of_wheels_whose_mean_radius_is_the_nominal_one() -> None:
    left, right = 1.0 / (1.0 - LEFT), 1.0 / (1.0 - RIGHT)
    mean = 0.5 * (left + right)
    z = []
    for seed in range(DRIVES):
        found = fit_by_gyro(recorded(("field", 200.0), seed, *FAR), WHEELS_S, 0.0)
        assert found is not None
        assert found.tread == pytest.approx((1.0 + TREAD) / mean, rel=0.01)
        z.append((found.tread - (1.0 + TREAD) / mean) / found.tread_sigma)
        z.append((found.difference - (right - left) / mean) / found.difference_sigma)
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 2.0


def test_a_robot_as_its_yaml_has_it_has_a_tread_of_one() -> None:
    found = fit_by_gyro(recorded(SLALOM, 1), 0.0, 0.0)
    assert found is not None
    assert abs(found.tread - 1.0) < 3.0 * found.tread_sigma < 0.01
    assert abs(found.difference) < 3.0 * found.difference_sigma < 0.01


def test_a_robot_that_stands_or_has_no_gyro_tells_nothing() -> None:
    assert fit_by_gyro(recorded(("stand", 60.0), 1), 0.0, 0.0) is None
    assert fit_by_gyro(replace(recorded(SLALOM, 1), fog=None), 0.0, 0.0) is None
