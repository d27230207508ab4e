"""Steps of long and of fast recordings: as fine as they must be, and no more of them than can be looked at."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import SLALOM, WAREHOUSE, recorded, selected, simulated

from drd.batch.logs import FogLog
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.observe import grids
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.observe.parts import cut_off
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.recordings.folder import Recording
from drd_tools.simulate.conditions import Conditions, Reference
from drd_tools.simulate.robot import DEFAULT

DRIVE = ("slalom", 120.0)


def test_what_is_too_long_is_cut_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = recorded(DRIVE, 1)
    assert cut_off(recording, gather(recording)) is None
    monkeypatch.setattr(grids, "MOST_STEPS", 300)
    e = gather(recording)
    assert len(e.time_s) == 300
    assert np.median(e.step_s) == pytest.approx(0.1)
    assert cut_off(recording, e) == "only the first 0 of 2 minutes were analysed"


@pytest.mark.parametrize(
    ("rate_hz", "step_s"), [(10.0, 0.1), (30.0, 0.1), (200.0, 0.1), (15.0, 1.0 / 15.0), (5.0, 0.2)]
)
def test_rows_of_a_fast_gyro_are_added_up(rate_hz: float, step_s: float) -> None:
    recording = recorded(DRIVE, 1)
    assert recording.fog is not None
    time_s = np.arange(1, int(119.0 * rate_hz)) / rate_hz
    rate = np.interp(time_s, recording.fog.time_s, recording.fog.rate_rad_s)
    e = gather(replace(recording, folder=Path("fast"), fog=FogLog(time_s, rate, None)))
    assert np.median(e.step_s) == pytest.approx(step_s)
    assert e.gyro_rad is not None
    assert e.gyro_rad.sum() == pytest.approx(float(rate.sum()) / rate_hz, abs=0.05)


def test_what_a_fast_gyro_lacks_is_found_as_in_a_slow_one() -> None:
    """Also what is faster than the steps."""
    fast = replace(DEFAULT, gyro_rate_hz=100.0)
    late = selected("gyro_latency", delay=0.02)
    (found,) = analyse(simulated(WAREHOUSE, 3, late, nominal=fast).recording).conclusion.causes
    assert "gyro_latency" in {found.effect, *found.also_fits}
    assert found.selected is not None
    (name,) = found.selected.free
    assert found.selected.number(name) == pytest.approx(0.02, abs=3.0 * found.selected.sigma(name))
    assert found.selected.sigma(name) < 0.005


@pytest.mark.parametrize("period_s", [0.02, 0.05, 0.1, 0.13, 1.0])
def test_without_a_gyro_steps_end_at_fixes_that_drift_and_the_path_stays(period_s: float) -> None:
    """Fixes within steps would swing it: what two neighbours share of a step, its turns trade."""
    recording = without_gyro(period_s)
    evidence = gather(recording)
    assert np.all((evidence.fix_share < 1e-6) | (evidence.fix_share > 1.0 - 1e-6))
    assert np.all(np.diff(evidence.fix_time_s) > 0.04)
    assert evidence.step_s.max() < 0.16
    assert evidence.time_s == pytest.approx(evidence.time_s[0] - evidence.step_s[0] + np.cumsum(evidence.step_s))
    problem = Problem(evidence)
    paths = []
    for _ in range(4):
        problem = problem.around([])
        paths.append(problem.path.pose)
    assert np.abs(paths[-1] - paths[-2]).max() < 1e-3 * np.abs(paths[0] - paths[1]).max() + 1e-6


def without_gyro(period_s: float) -> Recording:
    """A slalom without a gyro, the reference's clock a little fast."""
    recording = recorded(SLALOM, 3, conditions=Conditions(reference=Reference(period_s=period_s)))
    reference = recording.reference
    assert reference is not None
    return replace(recording, fog=None, reference=replace(reference, time_s=1.0004 * reference.time_s))


def test_fixes_from_before_the_wheels_do_not_shift_the_steps() -> None:
    """The first of the corrected stamps may be early, and at another phase of the steps than all that count."""
    recording = replace(recorded(SLALOM, 3), fog=None)
    reference = recording.reference
    assert reference is not None
    time_s = reference.time_s - 0.3
    time_s[0] -= 0.037
    early = replace(recording, reference=replace(reference, time_s=time_s))
    assert len(gather(early).fix) > 0.98 * len(reference.time_s)
