"""Ceiling of each case: how often the best possible method could name its effects. (93)

If two names at whitened distance d are equally likely, no method names more than a share Phi(d/2) correctly, averaged
over both: always giving the first name is right for it, and wrong for the second. The mean of the ceilings is thus the
highest expected rate if the nearest rival of each drive is equally likely; luck, or a preference for the names of a
row, can exceed it. A rival with more free parameters than the effect is less likely to have exactly those that imitate
it, and does not count. Physics that is in no catalogue is compared with the nearest name.
"""

from collections.abc import Sequence

from drd.effects.catalogue import catalogue
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording
from drd_tools.trial.distance import Rivals, ceiling, least, nearest, rival_names
from drd_tools.trial.results import Record, TrueEffect, si
from drd_tools.trial.size import selected_of


def set_ceilings(
    problem: Problem, truth: Sequence[Selected], rows: Sequence[TrueEffect], beside: Sequence[Selected] = ()
) -> None:
    """Set in the row of each true effect its nearest surrogate, the distance to it, and the ceiling.

    The other true effects, and those in `beside`, are refitted.
    """
    rivals = Rivals(problem, rival_names(problem))
    for one, row in zip(truth, rows, strict=True):
        others = [c for c in (*truth, *beside) if c is not one and c.id != one.id]
        found = nearest(problem, one, others, rivals, len(one.free))
        distances = [near.distance for near in found]
        row.nearest, row.distance = found[0]
        row.ceiling, row.least = ceiling(distances), least(distances)


def set_given(recording: Recording, rows: Sequence[TrueEffect]) -> None:
    """Set the ceilings of a recording that already contains its effects, if all have the catalogue's form."""
    if not rows or not all(map(_has_catalogue_form, rows)):
        return
    truth = selected_of([(catalogue()[row.effect], si(row)) for row in rows])
    set_ceilings(Problem(gather(recording)).around(truth), truth, rows)


def _has_catalogue_form(row: TrueEffect) -> bool:
    """Whether an effect is in the catalogue and has exactly its parameters."""
    effect = catalogue().get(row.effect)
    return effect is not None and row.parameters.keys() == {q.name for q in effect.parameters}


def ceiling_of(record: Record) -> float | None:
    """Ceiling of all names together, which is the lowest of theirs; None if nothing is missing or one is unknown.

    Exchanging one effect makes one pair of equally likely answers.
    """
    known = [e.ceiling for e in record.effects if isinstance(e.ceiling, float)]
    return min(known) if known and len(known) == len(record.effects) else None
