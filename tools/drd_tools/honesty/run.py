"""Judge all drives of a run, in any number of processes."""

import functools
import importlib.util
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from tqdm import tqdm

from drd_tools.honesty.drives import FOLDS, ROBOTS, SHARED, drives_of, judge_fold
from drd_tools.honesty.results import Judged, Results
from drd_tools.honesty.scenarios import MUJOCO, SCENARIOS
from drd_tools.honesty.simulated import BESIDE, judge_seed
from drd_tools.processes import called

FULL_SEEDS: Final = 300
# Under a minute in total with one process.
SHORT_SEEDS: Final = 4
# Up to so many drives of a robot are all judged, even in the short form.
FEW: Final = 5

Task = Callable[[], list[Judged]]


def run(seeds: int, *, short: bool, jobs: int, shared: Path = SHARED) -> Results:
    """Judge all drives. The order of the results does not depend on `jobs`."""
    notes: list[str] = []
    tasks = [*_real(short, shared, notes), *_simulated(seeds, 0 if short else BESIDE, notes)]
    shown = tqdm(called(tasks, jobs), total=len(tasks), desc="drives", disable=None, smoothing=0.0)
    return Results(seeds, [one for judged in shown for one in judged], notes)


def _real(short: bool, shared: Path, notes: list[str]) -> Iterator[Task]:
    """Yield a task for each fold of each robot; in the short form only one fold of a robot with many drives."""
    for robot in ROBOTS:
        drives = len(drives_of(robot, shared))
        if not drives:
            notes.append(f"{robot}: no recordings beside the checkout (../shared/recordings); its rows are left out.")
        for fold in range(1 if short and drives > FEW else min(FOLDS, drives)):
            yield functools.partial(judge_fold, robot, fold, shared)


def _simulated(seeds: int, beside: int, notes: list[str]) -> Iterator[Task]:
    for name, scenario in SCENARIOS.items():
        for seed in range(max(1, math.ceil(scenario.seeds_share * seeds))):
            yield functools.partial(_one, name, seed, beside)
    if importlib.util.find_spec("mujoco") is None:
        notes.append("MuJoCo is not installed (pip install 'drd[mujoco]'); its rows are left out.")
        return
    for seed in range(seeds):
        yield functools.partial(_one, MUJOCO, seed, beside)


def _one(name: str, seed: int, beside: int) -> list[Judged]:
    return [judge_seed(name, seed, beside)]
