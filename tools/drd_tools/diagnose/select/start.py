"""Where a search sets out: what logic has shown, and the constants of a robot that is far from robot.yaml."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from drd_tools.diagnose.observe.audit import Audit
from drd_tools.diagnose.observe.constants import Constants
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.select.library import is_plausible
from drd_tools.diagnose.select.search import STRONG_NATS
from drd_tools.diagnose.selected import Selected


class Start(NamedTuple):
    """A problem with the data sheets' noise, the effects that are `known` from logic, and the `constants`, if any."""

    problem: Problem
    known: list[Selected]
    constants: list[Selected]

    @property
    def held(self) -> list[Selected]:
        """The effects that stay in any search."""
        return [*self.known, *self.constants]


def started(audited: Audit, measured: Constants) -> Start:
    """The constants where they explain so much that nothing can be seen before they are off; else none. (79)

    A reference that is late by itself is a real one.
    """
    problem = Problem(audited.evidence)
    # An event of the wrong sign or size is none.
    known = [c for c in refine(problem, [event.selected for event in audited.events]).selection if is_plausible(c)]
    constants = list(measured.selection)
    far = replace(problem.evidence, is_far=True)
    if constants and _explained_nats(problem, known, constants) > STRONG_NATS:
        return Start(Problem(far, problem.path, near=problem), known, constants)
    # Without wheels nothing else tells real ground from a model of it.
    if not far.has_wheels and far.reference_lag_s:
        return Start(Problem(far, problem.path, near=problem), known, [])
    return Start(problem, known, [])


def _explained_nats(problem: Problem, known: Sequence[Selected], constants: Sequence[Selected]) -> float:
    both = [*known, *constants]
    return refine(problem, known).cost - refine(problem.around(both), both).cost
