"""Tied pairs of names, and how often a drive that was advised settles them, by simulation.

`python -m tied_pairs --seeds 40` (in tests/) prints, for drives of several lengths, the share of simulated drives that
settle a pair beside the probability that was stated; with `--diagnose` the share in which the whole diagnosis says so.
"""

import argparse
import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from drd.effects.catalogue import catalogue
from drd_tools.diagnose.advise.manoeuvres import Part, drive
from drd_tools.diagnose.advise.next_drive import Plan, Question, plans_for
from drd_tools.diagnose.advise.separation import SETTLED_NATS
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.conclude.cause import Cause
from drd_tools.diagnose.conclude.conclusion import Conclusion
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, refine, refine_all
from drd_tools.diagnose.results import Status, Support
from drd_tools.diagnose.select.library import library_of
from drd_tools.diagnose.select.search import Found
from drd_tools.diagnose.select.splines import Curve
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording
from drd_tools.simulate.conditions import Conditions, Reference
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth


def selected(name: str, **values: float) -> Selected:
    """An effect at values in SI."""
    effect = catalogue()[name]
    return Selected(effect, values, tuple(q.name for q in effect.parameters if q.name in values and not q.fixed))


@cache
def recorded(reference: str = "full") -> tuple[Recording, Problem]:
    """A recording in which nothing is missing, one minute long."""
    truth = make_truth(make_drive("slalom", 60.0))
    recording = simulate(truth, DEFAULT, (), Conditions(reference=Reference.parse(reference))).recording
    return recording, Problem(gather(recording))


def as_if(name: str, true: Selected, problem: Problem) -> Selected:
    """An effect that imitates another in a recording as well as it can."""
    problem = problem.with_data(problem.effect_rows([true]))
    library, best = library_of(problem), (-math.inf, true)
    for candidate in (c for c in library.candidates if c.effect.id == name):
        columns = library.columns[:, list(candidate.columns)].astype(float)
        gain, found = candidate.fitted(columns.T @ columns, columns.T @ problem.data)
        if found is not None and gain - candidate.penalty > best[0]:
            best = (gain - candidate.penalty, found)
    return refine(problem, [best[1]]).selection[0]


def finding(
    of: Selected | None, *rivals: Selected, status: Status = Status.CONFIRMED, curve: Curve | None = None
) -> Cause:
    """A cause whose rivals fit equally well."""
    return Cause(of, status, rivals, (), Support(50.0, 0.001, 1e6), 0.9, "", {}, curve)


def tied(true: Selected, *names: str, problem: Problem | None = None) -> Cause:
    """A cause, and effects that imitate it in the recording."""
    problem = recorded()[1] if problem is None else problem
    return finding(true, *(as_if(name, true, problem) for name in names))


def diagnosed(*findings: Cause, reference: str = "full") -> Conclusion:
    """The diagnosis with these findings."""
    problem = recorded(reference)[1]
    fit = Fit(tuple(f.selected for f in findings if f.selected is not None), 0.0, np.zeros(0), problem.data)
    found = Found(problem, fit, 0.0)
    return Conclusion(list(findings), found, [], {}, [], 0.0)


class Checked(NamedTuple):
    """A plan for one question: shares of simulated drives that settle it if either effect is true, and the mean."""

    plan: Plan
    shares: tuple[float, ...]

    @property
    def share(self) -> float:
        return sum(self.shares) / len(self.shares)


def checked(question: Question, plan: Plan, seeds: Sequence[int], whole: bool = False) -> Checked:
    """Simulate a plan with each effect of a question true; `whole`: let the whole diagnosis decide."""
    first, second = question.finding.selected, question.rival
    assert first is not None
    of_each = []
    for true, other in ((first, second), (second, first)):
        settled = [_is_settled(plan.parts, true, other, seed, whole) for seed in seeds]
        of_each.append(sum(settled) / len(settled))
    return Checked(plan, tuple(of_each))


def _is_settled(parts: Sequence[Part], true: Selected | None, other: Selected | None, seed: int, whole: bool) -> bool:
    effects = () if true is None else ((true.effect, true.values),)
    truth = drive(parts, DEFAULT.standstill_at_start_s)
    recording = simulate(truth, DEFAULT, effects, Conditions(), seed).recording
    if whole:
        named = [{c.effect, *c.also_fits} for c in analyse(recording).conclusion.causes]
        wrong = other is not None and any(other.id in names for names in named)
        return not wrong and (true is None or any(true.id in names for names in named))
    problem = Problem(gather(recording))
    if true is None or other is None:  # of the size found: the likelihood ratio compares one size with none
        found = true or other
        assert found is not None
        with_it = refine(problem.with_data(problem.data - problem.effect_rows([found])), []).cost
        ratio = refine(problem, []).cost - with_it
        ratio = ratio - problem.penalty([found]) if true is not None else -ratio
    else:
        right, wrong_fit = refine_all(problem, [[true], [other]])
        ratio = wrong_fit.cost - right.cost - max(0.0, problem.penalty([true]) - problem.penalty([other]))
    return ratio > SETTLED_NATS


PAIRS = (
    (selected("tread_error", k=0.01), "turn_scrub"),
    (selected("turn_scrub", k=0.01), "tread_error"),
    (selected("wheel_radius_error", left=0.002, right=0.002), "wheel_radius_speed"),
    (selected("gyro_scale_error", k=0.0003), "gyro_scale_asymmetry"),
    (selected("gyro_warmup", b=math.radians(0.012), tau=175.0), "gyro_bias_temperature_rate"),
    (selected("tread_error", k=0.001), ""),
)
LEVELS = (0.3, 0.6, 0.9)


def question(true: Selected, rival: str) -> tuple[Conclusion, Question]:
    """A diagnosis with one open question; without a rival: whether the finding is real at all."""
    cause = tied(true, rival) if rival else finding(true, status=Status.SUSPECTED)
    return diagnosed(cause), Question(cause, cause.rivals[0] if rival else None)


def nearest(plans: Sequence[Plan], level: float) -> Plan:
    """The plan with a stated probability nearest to a level, the shortest if several."""
    return min(plans, key=lambda p: (round(abs(p.probabilities[0] - level), 2), p.seconds))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--diagnose", action="store_true", help="ask the whole diagnosis (3 s for each drive)")
    chosen = parser.parse_args()
    print(f"{'pair':50} {'minutes':>7} {'stated':>6} {'settled':>7}  first, second true")
    for true, rival in PAIRS:
        conclusion, asked = question(true, rival)
        plans = plans_for(conclusion.found, DEFAULT, [asked])
        for plan in dict.fromkeys(nearest(plans, level) for level in LEVELS):
            found = checked(asked, plan, range(chosen.seeds), chosen.diagnose)
            pair, minutes = " from ".join(asked.names), plan.seconds / 60.0
            print(
                f"{pair:50} {minutes:7.1f} {plan.probabilities[0]:6.2f} {found.share:7.2f}  {found.shares}", flush=True
            )
            print(f"    {', '.join(f'{p.laps} x {p.manoeuvre}' for p in plan.parts)}", flush=True)


if __name__ == "__main__":
    main()
