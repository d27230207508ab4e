"""The next drive: manoeuvres, one after the other, that settle the open questions in the shortest time.

Each question is "is it A or B": with A and B as found, by how much would a drive favour the true one? All drives
composed of a few manoeuvres are compared. (92)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from msgspec import structs

from drd.config.robot import Robot
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.advise.laps import LONGEST_S, Laps
from drd_tools.diagnose.advise.manoeuvres import Part, lap_s
from drd_tools.diagnose.advise.separation import INTERVAL_FROM_S, Named, expected_ratio, settling_probability
from drd_tools.diagnose.conclude.cause import Cause
from drd_tools.diagnose.conclude.conclusion import Conclusion
from drd_tools.diagnose.results import NOTHING, Alternative, NextDrive, Segment, Settled, Status
from drd_tools.diagnose.select.search import Found
from drd_tools.diagnose.selected import Selected

ENOUGH: Final = 0.9  # required probability of settling a question
WORTH: Final = 0.05  # gain in insufficient probability for which a drive may be a minute longer
HOPELESS: Final = 0.005  # a smaller one counts as none


class Question(NamedTuple):
    """Whether the finding is true or its rival; None: nothing."""

    finding: Cause
    rival: Selected | None

    @property
    def names(self) -> list[str]:
        """Both names."""
        return [self.finding.effect, NOTHING if self.rival is None else self.rival.id]

    @property
    def found(self) -> Named:
        """The finding's cause."""
        found = self.finding.selected or self.finding.curve
        assert found is not None
        return found

    @property
    def shares(self) -> tuple[float, float]:
        """Posterior probabilities of both names, normalised to 1; equal if both are unknown."""
        a, b = (self.finding.probabilities.get(name, 0.0) for name in self.names)
        return (a / (a + b), b / (a + b)) if a + b > 0.0 else (0.5, 0.5)


@dataclass(frozen=True)
class Plan:
    """A drive, with its probability of settling each question and the expected nats."""

    parts: tuple[Part, ...]
    seconds: float
    probabilities: tuple[float, ...]
    nats: tuple[float, ...]

    @property
    def settles(self) -> int:
        """Number of questions that it settles with sufficient probability."""
        return sum(p >= ENOUGH for p in self.probabilities)

    @property
    def rank(self) -> tuple[float, ...]:
        """Sort key: questions settled, then the others' probability, traded against time; larger is better."""
        return (self.settles, sum(min(p, ENOUGH) for p in self.probabilities) - WORTH * self.seconds / 60.0)

    @property
    def probability(self) -> float:
        """Probability of settling all questions that count as settled; if none does, of all questions."""
        return math.prod([p for p in self.probabilities if p >= ENOUGH] or self.probabilities)

    @property
    def least_nats(self) -> float:
        """Least nats of the settled questions; if none is settled, the most of any."""
        settled = [n for n, p in zip(self.nats, self.probabilities, strict=True) if p >= ENOUGH]
        return round(max(0.0, min(settled) if settled else max(self.nats)), 1)


def next_drive(conclusion: Conclusion, nominal: Robot) -> NextDrive | None:
    """The drive that settles the open questions of a diagnosis; None if a drive could settle none.

    Open questions are findings with alternatives that also fit, and suspected ones (against nothing). `nats` is the
    least of the pairs that it settles (if it settles none, the most of any); the alternatives are the best drives of
    one manoeuvre each, best first. Deterministic.
    """
    questions = open_questions(conclusion.causes)
    if not questions:
        return None
    best, *others = sorted(plans_for(conclusion.found, nominal, questions), key=lambda p: p.rank, reverse=True)
    outcomes = zip(questions, best.probabilities, best.nats, strict=True)
    asked = [Settled(q.names, p, round(max(n, 0.0), 1)) for q, p, n in outcomes]
    separates = [s.names for s in asked if s.probability >= ENOUGH]
    segments = [Segment(p.manoeuvre, p.laps, round(p.laps * lap_s(p.manoeuvre) / 60.0, 2)) for p in best.parts]
    stand_s = best.seconds - sum(p.laps * lap_s(p.manoeuvre) for p in best.parts)
    return NextDrive(
        manoeuvre="; then ".join(s.manoeuvre for s in segments),
        minutes=round(best.seconds / 60.0, 1),
        separates=separates,
        nats=best.least_nats,
        unsettled=[s.names for s in asked if s.names not in separates],
        alternatives=_alternatives(best, others),
        sentence=_sentence(segments, stand_s, best, asked),
        stand_s=round(stand_s, 1),
        segments=segments,
        questions=[structs.replace(s, probability=round(s.probability, 3)) for s in asked],
        probability=round(best.probability, 3),
    )


def _alternatives(best: Plan, others: Sequence[Plan]) -> list[Alternative]:
    """The best drive of each other manoeuvre alone; `others`: best first."""
    single: dict[str, Plan] = {}
    for plan in others:
        if len(plan.parts) == 1 and (name := plan.parts[0].manoeuvre) != best.parts[0].manoeuvre:
            single.setdefault(name, plan)
    return [
        Alternative(name, round(p.seconds / 60.0, 1), p.settles, p.least_nats, round(p.probability, 3))
        for name, p in single.items()
    ]


def open_questions(findings: Sequence[Cause]) -> list[Question]:
    """Pairs of a finding and an effect that may be true in its place."""
    questions: list[Question] = []
    for finding in findings:
        if finding.selected is not None and not finding.selected.effect.recurs:
            continue
        rivals = finding.rivals or ((None,) if finding.status is Status.SUSPECTED else ())
        questions += [Question(finding, rival) for rival in rivals]
    return questions


def plans_for(found: Found, nominal: Robot, questions: Sequence[Question]) -> list[Plan]:
    """All candidate drives, with their probability and nats for each question."""
    laps = Laps(found, nominal, [named for q in questions for named in (q.found, q.rival) if named is not None])
    drives = list(laps.drives())
    has_part = np.array([[part in parts for part in laps.parts] for parts in drives], float)
    seconds = laps.stand_s + has_part @ np.array([part.laps * lap_s(part.manoeuvre) for part in laps.parts])
    products = np.tensordot(has_part, laps.products, axes=1) + laps.standing
    probabilities, nats = np.zeros((2, len(questions), len(drives)))
    for k, q in enumerate(questions):
        # By name: a reported finding, or rival, is no longer the fitted object.
        beside = [c for c in laps.others if c.id not in (q.finding.effect, *q.finding.also_fits)]
        for share, (true, rival, price) in zip(q.shares, _ways(found, q), strict=True):
            mean, variance = expected_ratio(products, laps.layout, true, rival, beside)
            probabilities[k] += share * settling_probability(mean - price, variance)
            nats[k] += share * (mean - price)
    made = zip(drives, seconds.tolist(), probabilities.T.tolist(), nats.T.tolist(), strict=True)
    return [Plan(parts, s, tuple(p), tuple(n)) for parts, s, p, n in made]


def _ways(found: Found, q: Question) -> list[tuple[Named, Named | None, float]]:
    """Each possible truth, its rival, and the excess of the truth's penalty over the rival's, nats."""
    problem, selected = found.problem, q.finding.selected
    mine = problem.per_parameter + problem.per_effect if selected is None else problem.penalty([selected])
    if q.rival is None:  # "nothing" has no parameters to fit: the distance is the same both ways
        return [(q.found, None, mine), (q.found, None, 0.0)]
    excess = mine - problem.penalty([q.rival])
    return [(q.found, q.rival, max(excess, 0.0)), (q.rival, q.found, max(-excess, 0.0))]


# ---- words ---------------------------------------------------------------------------------------------------------


def _sentence(segments: Sequence[Segment], stand_s: float, best: Plan, asked: Sequence[Settled]) -> str:
    told, untold = ([s for s in asked if (s.probability >= ENOUGH) is wanted] for wanted in (True, False))
    parts = [
        f"{s.manoeuvre}, {'once' if s.laps == 1 else f'{s.laps} times'} ({s.minutes:.1f} minutes)" for s in segments
    ]
    plan = "; then ".join([f"{stand_s:.0f} s standing still", *parts] if stand_s else parts)
    if not told:
        pairs = "; ".join(" from ".join(s.names) for s in untold)
        text = f"None of the simulated drives, up to {LONGEST_S / 60.0:.0f} minutes long, distinguishes {pairs}"
        if max(best.probabilities) < HOPELESS:
            return f"{text}: they look alike in all of them."
        return f"{text} with a probability of {ENOUGH:g}; the best is: {plan}. It distinguishes {_paired(untold)}."
    text = f"{plan[0].upper()}{plan[1:]}: {best.seconds / 60.0:.1f} minutes, to distinguish {_paired(told)}"
    text += f", all of them together with a probability of {best.probability:.2f}." if len(told) > 1 else "."
    names = {name for s in told for name in s.names}
    advice = (effect.advice for effect in catalogue().values() if effect.id in names and effect.advice)
    text += "".join(f" {a.format(from_s=INTERVAL_FROM_S)}" for a in dict.fromkeys(advice))
    return text + (f" It does not distinguish {_paired(untold)}." if untold else "")


def _paired(questions: Sequence[Settled]) -> str:
    return "; ".join(f"{' from '.join(q.names)} (probability {q.probability:.2f})" for q in questions)
