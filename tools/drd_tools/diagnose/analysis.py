"""The way of one recording from evidence to conclusion."""

from dataclasses import dataclass
from typing import Final

from drd_tools.diagnose.conclude.conclusion import Conclusion, conclude
from drd_tools.diagnose.observe.audit import Event, audit
from drd_tools.diagnose.observe.evidence import Noise, gather
from drd_tools.diagnose.regression.noise_fit import fitted, inflated
from drd_tools.diagnose.regression.problem import Inflation, Problem
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.results import Array, Figures
from drd_tools.diagnose.select.library import is_plausible, release
from drd_tools.diagnose.select.search import coarse_search, full_search, is_rough
from drd_tools.recordings.folder import Recording

NOISE_ROUNDS: Final = 2
ROUGH_ROUNDS: Final = 4  # where the data are far off
NOISE_CHANGED: Final = 0.1  # relative: the selected effects are then searched for again


@dataclass(frozen=True)
class Analysis:
    """Conclusion on one recording. `null` (r,): whitened data less the nuisances, before any effect."""

    recording: Recording
    events: list[Event]
    null_problem: Problem
    null: Array
    conclusion: Conclusion

    def noise_ratios(self) -> Figures:
        """Ratios of the fitted noise to the data sheets'."""
        noise, stated = self.conclusion.found.problem.noise, self.conclusion.found.problem.evidence.datasheet
        heading: Figures = {"heading": noise.heading_rad / stated.heading_rad}
        if not self.conclusion.found.problem.evidence.has_wheels:
            return heading
        return {
            "slip": noise.slip_m_per_sqrt_m / stated.slip_m_per_sqrt_m,
            "position": noise.position_m / stated.position_m,
            **heading,
        }


def analyse(recording: Recording) -> Analysis:
    """Audit, fit the noise, search, and judge what was found."""
    audited = audit(recording, gather(recording))
    known = [event.selected for event in audited.events]
    problem = Problem(audited.evidence)
    # What was seen as an event must also be of the right sign and size.
    known = [c for c in refine(problem, known).selection if is_plausible(c)]
    for _ in range(NOISE_ROUNDS):
        noise, fix_inflation = fitted(problem, refine(problem, known), searched=False)
        problem = Problem(problem.evidence, problem.path, noise, fix_inflation)
    found = coarse_search(problem, known)
    for i in range(ROUGH_ROUNDS):
        # The selected effects are off now, so that what is left tells the noise better than before.
        if i >= NOISE_ROUNDS and not is_rough(found.fit):
            break
        noise, fix_inflation = fitted(found.problem, found.fit, searched=True)
        inflation = inflated(found.problem, found.fit.left)
        if _is_near(noise, inflation, found.problem) and not is_rough(found.fit):
            break
        problem = Problem(problem.evidence, problem.path, noise, fix_inflation, inflation=inflation)
        found = coarse_search(problem, known)
    found = full_search(found, known)
    null = refine(problem, known)
    if found.problem is not problem:
        release(problem)
    conclusion = conclude(found, audited.events)
    release(found.problem)
    return Analysis(recording, audited.events, problem, null.left, conclusion)


def _is_near(noise: Noise, inflation: Inflation, problem: Problem) -> bool:
    """Whether a problem has this noise already."""
    before, was = problem.noise, problem.inflation
    pairs = (
        (noise.slip_m_per_sqrt_m, before.slip_m_per_sqrt_m),
        (noise.position_m, before.position_m),
        (noise.heading_rad, before.heading_rad),
        (inflation.wheels, was.wheels),
        *zip(inflation.fixes, was.fixes, strict=True),
    )
    return all(abs(a / b - 1.0) < NOISE_CHANGED for a, b in pairs)
