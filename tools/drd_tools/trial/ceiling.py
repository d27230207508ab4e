"""The ceiling of each case: how often the best of all methods could name its effects. (93)

Of two equally likely names at whitened distance d no method names more than a share Phi(d/2) right, on average of both:
one that always says the first is right there, and wrong wherever it is the second. So the mean of the ceilings is the
most that a method can expect of drives of which the nearest rival is as likely; with luck, or by leaning to the names
of a row, a rate may lie above it. A rival with more free parameters than the effect is not as likely to have just those
that imitate it, and does not count. What is in no catalogue is set against the nearest name.
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
    """Say in the row of each true effect what is nearest in its place, how near, and the ceiling.

    The other true effects, and those that are there `beside`, stay, with other parameters.
    """
    rivals = Rivals(problem, rival_names(problem))
    for one, row in zip(truth, rows, strict=True):
        others = [c for c in (*truth, *beside) if c is not one and c.id != one.id]
        found = nearest(problem, one, others, rivals, len(one.free))
        distances = [near.distance for near in found]
        row.nearest, row.distance = found[0]
        row.ceiling, row.least = ceiling(distances), least(distances)


def set_given(recording: Recording, rows: Sequence[TrueEffect]) -> None:
    """Set the ceilings of a recording that has its effects already, if all are stated as the catalogue states them."""
    if not rows or not all(map(_has_catalogue_form, rows)):
        return
    truth = selected_of([(catalogue()[row.effect], si(row)) for row in rows])
    set_ceilings(Problem(gather(recording)).around(truth), truth, rows)


def _has_catalogue_form(row: TrueEffect) -> bool:
    """Whether an effect is of the catalogue, and has all of its parameters and no other."""
    effect = catalogue().get(row.effect)
    return effect is not None and row.parameters.keys() == {q.name for q in effect.parameters}


def ceiling_of(record: Record) -> float | None:
    """Ceiling of all its names together, which is the lowest of them; None where nothing is missing, or none is known.

    One effect exchanged is one pair of equally likely answers.
    """
    known = [e.ceiling for e in record.effects if isinstance(e.ceiling, float)]
    return min(known) if known and len(known) == len(record.effects) else None
