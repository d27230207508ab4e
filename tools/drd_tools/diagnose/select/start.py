"""Starting point of a search: effects shown by logic, and the constants of a robot that is far from robot.yaml."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from drd_tools.diagnose.observe.audit import Audit
from drd_tools.diagnose.observe.constants import Constants
from drd_tools.diagnose.observe.evidence import Evidence
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.select.library import is_plausible
from drd_tools.diagnose.select.search import STRONG_NATS
from drd_tools.diagnose.selected import Selected

SECOND_ORDER_NATS: Final = 1.5  # beyond a nat or two, linear around robot.yaml is not linear around the constants
APART_S: Final = 2.0  # between fixes: four times what real drives hold speeds, and lidars average, for


class Start(NamedTuple):
    """A problem with the datasheets' noise, the effects `known` by logic, and the `constants`, if any."""

    problem: Problem
    known: list[Selected]
    constants: list[Selected]

    @property
    def held(self) -> list[Selected]:
        """The effects that every search keeps."""
        return [*self.known, *self.constants]


def started(audited: Audit, measured: Constants) -> Start:
    """Start from the constants if they explain so much that they would hide everything else; else from none. (79)

    A reference with a lag of its own is a real one.
    """
    problem = Problem(audited.evidence)
    # Discard events with the wrong sign or size.
    known = [c for c in refine(problem, [event.selected for event in audited.events]).selection if is_plausible(c)]
    constants = list(measured.selection)
    far = replace(problem.evidence, is_far=True)
    if constants and _hides_others(problem, constants, _explained_nats(problem, known, constants)):
        return Start(Problem(_apart(far), problem.path, near=problem), known, constants)
    # Without wheels only the reference's lag distinguishes real ground from a simulation.
    if not far.has_wheels and far.reference_lag_s:
        return Start(Problem(far, problem.path, near=problem), known, [])
    return Start(problem, known, [])


def _apart(e: Evidence) -> Evidence:
    """Thin out the fixes of a far robot without a gyro. (79)

    Within a second or two its drive holds and filters speeds, the reference averages, and turns are smoothed. As the
    white noise of (68), these errors would absorb part of each turn.
    """
    if e.gyro_rad is not None or not e.has_wheels:
        return e
    _, kept = np.unique(e.fix_time_s // APART_S, return_index=True)
    return e.with_fixes(kept)


def _hides_others(problem: Problem, constants: Sequence[Selected], nats: float) -> bool:
    """Whether constants that explain so much would hide other effects, or be hidden by them.

    Without a gyro the errors of held speeds absorb part of each turn beside wheels of the stated sizes, see `_apart`.
    """
    sizes = [c.number(name) for c in constants if c.effect.geometry for name in c.free]
    second_order = nats * max(map(abs, sizes), default=0.0) ** 2
    return nats > STRONG_NATS or (problem.evidence.gyro_rad is None and second_order > SECOND_ORDER_NATS)


def _explained_nats(problem: Problem, known: Sequence[Selected], constants: Sequence[Selected]) -> float:
    both = [*known, *constants]
    return refine(problem, known).cost - refine(problem.around(both), both).cost
