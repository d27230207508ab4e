"""Judge simulated drives by the truth."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Final

from drd_tools.honesty import configurations as c
from drd_tools.honesty.baselines import baselines
from drd_tools.honesty.drives import all_figures
from drd_tools.honesty.figures import Estimated, Yardstick, figures_of, nees_at_end
from drd_tools.honesty.results import Judged
from drd_tools.honesty.scenarios import CALIBRATION_DRIVES, MUJOCO, SCENARIOS, contact_simulation, simulation
from drd_tools.replay.nominal import configuration

# Seeds for which configurations other than the default are computed: they are for comparison, and not judged.
BESIDE: Final = 30


def judge_seed(name: str, seed: int, beside: int = BESIDE) -> Judged:
    """Judge one drive of a scenario, or of MuJoCo; configurations other than the default only for seeds < `beside`."""
    if name == MUJOCO:
        return _contacts(seed)
    with tempfile.TemporaryDirectory() as place:
        return _formulas(name, seed, Path(place), beside)


def _formulas(name: str, seed: int, place: Path, beside: int) -> Judged:
    one = simulation(name, seed)
    recording, yardstick = one.recording, Yardstick(one.true, True)
    drawn = c.as_simulated(configuration(recording))
    default = c.estimated(recording)
    figures = {c.DEFAULT: figures_of(default, yardstick)}
    nees = {c.DEFAULT: nees_at_end(default.poses, one.true)}
    if seed < beside and not SCENARIOS[name].stand_s:
        others = [simulation(name, seed, other).recording for other in range(CALIBRATION_DRIVES)]
        figures = all_figures(recording, c.calibrate(others, place / "wheels.yaml").file, yardstick, drawn)
    else:
        figures |= {which: figures_of(Estimated(poses), yardstick) for which, poses in baselines(recording).items()}
    if SCENARIOS[name].is_modelled:
        stated = c.estimated(replace(recording, config=drawn))
        nees[c.STATED] = nees_at_end(stated.poses, one.true)
    return Judged("simulated", name, f"seed {seed}, {one.mission}", figures, nees)


def _contacts(seed: int) -> Judged:
    one = contact_simulation(seed)
    figures = all_figures(one.recording, None, Yardstick(one.true, True))
    nees = {c.DEFAULT: nees_at_end(c.estimated(one.recording).poses, one.true)}
    return Judged("simulated", MUJOCO, f"seed {seed}, {one.mission}", figures, nees)
