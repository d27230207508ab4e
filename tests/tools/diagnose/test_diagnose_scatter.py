"""Noise that is larger than stated: said with which covariate it goes, and when. (78)"""

from pathlib import Path

import diagnosis_files
import numpy as np
import pytest
from diagnosis_drives import WAREHOUSE, problem
from msgspec.structs import replace

from drd.arrays import Array
from drd_tools.diagnose import files
from drd_tools.diagnose.conclude.scatter import is_loud, scatter_of
from drd_tools.diagnose.regression.noise_fit import WHEELS, scaled
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.report.page import write_report
from drd_tools.diagnose.results import Scatter
from drd_tools.simulate.robot import DEFAULT


def loud(seed: int, times: float = 5.0) -> tuple[Problem, Array, Array]:
    """A problem of loud wheels, white rows of so much noise as it has, and the turn rate at those of the wheels."""
    p = problem(WAREHOUSE, seed)
    p.noise = scaled(p.noise, times, WHEELS)
    m = p.sensitivities.motion
    rate = np.interp(p.evidence.time_s, m.time_s, np.abs(m.rate_rad_s))
    return p, np.random.default_rng(seed).standard_normal(len(p.data)), rate


def wheels(told: list[Scatter]) -> Scatter:
    (found,) = (s for s in told if s.channel == "slip")
    return found


@pytest.mark.parametrize("seed", range(3))
def test_noise_that_is_everywhere_the_same_goes_with_nothing(seed: int) -> None:
    p, left, _ = loud(seed)
    found = wheels(scatter_of(p, left, DEFAULT)[0])
    assert found.ratio == pytest.approx(5.0)
    assert (found.covariate, found.window, found.levels) == (None, None, ())
    assert found.sentence.startswith("the wheel noise is 5 times the stated value")


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_turning_is_told_as_such(seed: int) -> None:
    p, left, rate = loud(seed)
    left[: len(rate)] *= np.where(rate > np.radians(5.0), 4.0, 1.0)
    found = wheels(scatter_of(p, left, DEFAULT)[0])
    assert found.covariate in ("turn_rate", "curvature")
    assert (found.nats or 0.0) > 10.0
    assert max(found.levels, key=lambda row: row.ratio) is found.levels[-1]
    assert found.levels[-1].ratio > 2.5 * found.levels[0].ratio
    assert "largest" in found.sentence


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_a_while_is_told_with_its_time(seed: int) -> None:
    p, left, rate = loud(seed)
    time_s = p.evidence.time_s
    left[: len(rate)] *= np.where((time_s > 60.0) & (time_s < 85.0), 4.0, 1.0)
    found = wheels(scatter_of(p, left, DEFAULT)[0])
    assert found.window == pytest.approx((60.0, 85.0), abs=6.0)
    assert (found.window_ratio or 0.0) > 2.0 * found.ratio
    assert found.window is not None
    assert f"larger from {found.window[0]:.0f} to {found.window[1]:.0f} s" in found.sentence


def test_noise_as_stated_is_no_finding() -> None:
    p, left, _ = loud(0, 1.5)
    assert scatter_of(p, left, DEFAULT) == ([], [])
    assert [is_loud(p), is_loud(loud(0)[0])] == [False, True]


def test_what_robot_yaml_does_not_state_is_said_to_be_as_usual() -> None:
    p, left, _ = loud(0)
    told = scatter_of(p, left, DEFAULT.__class__(wheel_radius_m=0.1, tread_m=0.5))[0]
    assert "robot.yaml states none" in wheels(told).sentence


def test_the_files_and_the_page_tell_it(tmp_path: Path) -> None:
    p, left, rate = loud(0)
    left[: len(rate)] *= np.where(rate > np.radians(5.0), 4.0, 1.0)
    told, courses = scatter_of(p, left, DEFAULT)
    diagnosis, series = diagnosis_files.one_finding()
    folder = diagnosis_files.write(tmp_path, (diagnosis, series))
    result, drawn = files.load(folder)
    result, drawn = replace(result, scatter=tuple(told)), replace(drawn, scatter=courses)
    files.save(folder, result, drawn)
    assert files.load(folder)[0].scatter == result.scatter
    write_report(folder)
    page = (folder / "report.html").read_text()
    assert "The wheel noise is" in page
    assert (folder / "scatter_slip.png").exists()
