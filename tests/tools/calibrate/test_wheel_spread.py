"""The spread between recordings: none where noise explains all, the true one where it does not."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from wheel_recordings import TOUR, Truth, write_drive

from drd_tools.calibrate.wheels.drive import make_drive
from drd_tools.calibrate.wheels.fit import fit_wheels
from drd_tools.calibrate.wheels.spread import spread, wheel_spread
from drd_tools.recordings.folder import read_recording


@given(st.lists(st.tuples(st.floats(-10.0, 10.0), st.floats(1e-6, 4.0)), min_size=2, max_size=12))
def test_the_spread_solves_its_equation(pairs: list[tuple[float, float]]) -> None:
    values, variances = np.array(pairs).T
    s = spread(values, variances)
    weights = 1.0 / (variances + s**2)
    left = float(weights @ (values - weights @ values / weights.sum()) ** 2)
    if s > 0.0:
        assert left == pytest.approx(len(values) - 1, rel=1e-3)
    else:
        assert left <= (len(values) - 1) * (1.0 + 1e-9)


@given(st.floats(0.1, 5.0), st.floats(0.0, 1.0), st.integers(0, 1000))
def test_the_unit_does_not_matter_and_many_values_tell_the_truth(unit: float, s: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    values = random.normal(0.0, s, 400) + random.normal(0.0, 0.3, 400)
    found = spread(values, np.full(400, 0.09))
    assert found == pytest.approx(s, abs=0.15)
    assert spread(unit * values, np.full(400, 0.09 * unit**2)) == pytest.approx(unit * found, rel=1e-3, abs=1e-5)


def test_one_value_has_none() -> None:
    assert math.isnan(spread(np.ones(1), np.ones(1)))


def test_drives_on_other_ground_have_a_spread_of_the_tread(tmp_path: Path) -> None:
    truth = Truth(slip_m_per_sqrt_m=0.001, position_sigma_m=0.003, heading_sigma_rad=0.002)
    treads = (1.0, 1.04, 1.08, 1.12)
    folders = [write_drive(tmp_path / f"{k}", TOUR, replace(truth, tread=t), k) for k, t in enumerate(treads)]
    drives = [make_drive(read_recording(folder)) for folder in folders]
    left, right, tread = wheel_spread(drives, fit_wheels(drives))
    assert tread == pytest.approx(np.std(treads, ddof=1) / np.mean(treads), rel=0.2)
    assert max(left, right) < 0.01
    alone = wheel_spread(drives[:1], fit_wheels(drives[:1]))
    assert all(map(math.isnan, alone))
