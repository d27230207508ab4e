"""Effects that a recording does not show alone, but that other recordings of the robot lead to expect. (89)"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from drd.effects.catalogue import catalogue
from drd_tools.diagnose.combine.means import scatter, weighted
from drd_tools.diagnose.combine.pool import STRONG_ODDS
from drd_tools.diagnose.combine.statistics import SufficientStatistics
from drd_tools.diagnose.conclude.cause import Cause, sentence
from drd_tools.diagnose.conclude.conclusion import Conclusion
from drd_tools.diagnose.conclude.confirm import LARGEST_NATS
from drd_tools.diagnose.conclude.outcome import names_of
from drd_tools.diagnose.results import NOTHING, Finding, Result, Status, Support
from drd_tools.diagnose.selected import Selected

FEWEST: Final = 2  # other recordings that show an effect: a single one may be wrong


class Expected(NamedTuple):
    """An effect with the prior from other recordings, the number of these, its Bayes factor and posterior odds."""

    selected: Selected
    others: int
    bayes_factor: float
    odds: float


def expected(results: Sequence[Result], statistics: Sequence[SufficientStatistics]) -> list[tuple[Expected, ...]]:
    """For each recording, the effects not found in it that others and its own data support by odds of 20 to 1."""
    return [_of_one(i, results, statistics) for i in range(len(results))]


def borne_out(conclusion: Conclusion, expected: Sequence[Expected]) -> Conclusion:
    """Judge a conclusion's expected effects by their odds, instead of by this recording alone."""
    by_name = {one.selected.id: one for one in expected}
    causes = [_supported(c, by_name[c.effect]) if c.effect in by_name else c for c in conclusion.causes]
    return replace(conclusion, causes=causes)


def _supported(cause: Cause, expected: Expected) -> Cause:
    assert cause.selected is not None
    others = (
        f"{expected.others} other recordings show it; the odds that it is in this one too are {expected.odds:.0f} to 1."
    )
    nothing = 1.0 / (1.0 + expected.odds)
    return replace(
        cause,
        status=Status.SUPPORTED,
        rivals=(),
        # A Bayes factor with a prior from other data is an e-value, and its inverse a p-value.
        support=Support(
            cause.gain_nats,
            min(1.0, 1.0 / expected.bayes_factor),
            expected.bayes_factor,
            expected.odds / expected.bayes_factor,
        ),
        sentence=f"{sentence(cause.selected, cause.explains, ())} {others}",
        probabilities={cause.effect: 1.0 - nothing, NOTHING: nothing},
    )


def _of_one(i: int, results: Sequence[Result], statistics: Sequence[SufficientStatistics]) -> tuple[Expected, ...]:
    said, own = names_of(results[i].findings), statistics[i]
    others, theirs = ([*all_of[:i], *all_of[i + 1 :]] for all_of in (results, statistics))
    found = (
        _judged(effect, others, theirs, own)
        for effect in dict.fromkeys(e for e, _ in own.alone.names)
        if effect not in said
    )
    return tuple(one for one in found if one is not None and one.odds >= STRONG_ODDS)


def _judged(
    effect: str, others: Sequence[Result], statistics: Sequence[SufficientStatistics], own: SufficientStatistics
) -> Expected | None:
    """Odds of an effect in a recording with its `own` statistics; None if too few of the others show it.

    Others count as being without it if their `statistics` contradict it.
    """
    findings = [f for r in others for f in r.findings if f.effect == effect and f.status is not Status.SUSPECTED]
    if len(findings) < FEWEST or not all(a.std > 0.0 for f in findings for a in f.parameters.values()):
        return None
    prior = _prior(effect, findings)
    nats, *of_others = (one.log_bayes_factor(effect, prior) for one in (own, *statistics))
    without = sum(n is not None and n < -math.log(STRONG_ODDS) for n in of_others)
    if nats is None or len(findings) <= without:
        return None
    bayes_factor = math.exp(min(nats, LARGEST_NATS))
    values = {name: value for name, (value, _) in prior.items()}
    selected = Selected(catalogue()[effect], values, tuple(values), prior=prior)
    return Expected(selected, len(findings), bayes_factor, bayes_factor * (len(findings) + 1) / (without + 1))


def _prior(effect: str, findings: Sequence[Finding]) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation (SI) of each parameter in one more recording."""
    made = {}
    for q in catalogue()[effect].parameters:
        amounts = [f.parameters[q.name] for f in findings]
        value, std = weighted(amounts, beyond := scatter(amounts))
        made[q.name] = value * q.si, math.sqrt(std**2 + beyond) * q.si
    return made
