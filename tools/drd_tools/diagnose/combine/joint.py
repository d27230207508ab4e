"""Effects that several recordings of one robot show together, though none shows them alone.

Each recording gives the sufficient statistics of the lasting, linear effects, its nuisances and its own effects
projected out. Their sums are those of one regression over all recordings, with the parameters in common. (89)
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import chdtrc

from drd.effects.catalogue import catalogue
from drd.effects.effect import ActsOn, Effect
from drd_tools.diagnose.conclude.cause import sentence
from drd_tools.diagnose.conclude.conclusion import LEAST_NATS
from drd_tools.diagnose.conclude.confirm import e_value
from drd_tools.diagnose.conclude.judgement import CONFIRMING_E, FAMILY_WISE
from drd_tools.diagnose.conclude.outcome import parameters_of
from drd_tools.diagnose.error_model.ranges import seen
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, nuisance_design
from drd_tools.diagnose.results import NOTHING, Array, Finding, Ranges, Status, Support, Window
from drd_tools.diagnose.select.library import is_plausible
from drd_tools.diagnose.select.search import CLASS_NATS
from drd_tools.diagnose.selected import Selected

Part = tuple[Array, Array]  # G (p, p) and b (p,)

MOST: Final = 4  # effects that only all recordings show: limits a greedy search


@dataclass(frozen=True)
class SufficientStatistics:
    """One recording's information `G` (p, p) and score `b` (p,) of the columns `names`, from `rows` rows of data.

    `ranges`: where each effect's covariate was, by the effect's name; `span_s`: from when to when. An effect that it
    selected itself has no column.
    """

    names: tuple[tuple[str, str], ...]
    G: Array
    b: Array
    rows: int
    ranges: dict[str, Ranges]
    span_s: Window

    def log_bayes_factor(self, effect: str, prior: Mapping[str, tuple[float, float]]) -> float | None:
        """Log of the likelihood with an effect over that without it, nats; None where it has no columns. (89)

        `prior`: mean and standard deviation, SI, of each parameter.
        """
        if not prior or not all((effect, name) in self.names for name in prior):
            return None
        index = [self.names.index((effect, name)) for name in prior]
        mean, std = np.transpose(list(prior.values()))
        G, weight = self.G[np.ix_(index, index)], np.diag(std**-2.0)
        score = self.b[index] + weight @ mean
        nats = 0.5 * float(score @ np.linalg.solve(G + weight, score) - mean @ weight @ mean)
        return nats - 0.5 * float(np.linalg.slogdet(np.eye(len(mean)) + std[:, None] ** 2 * G)[1])


def shared() -> list[Effect]:
    """Effects whose parameters are all linear and mean the same in each recording."""
    return [
        e
        for e in catalogue().values()
        if e.lasting
        and e.covariate != "temperature"  # it counts from each recording's own standstill
        and e.acts_on not in (ActsOn.TIMING, ActsOn.READOUT)
        and all(q.linear for q in e.parameters)
    ]


def sufficient_statistics(problem: Problem, fit: Fit) -> SufficientStatistics:
    """Score and information of the shared effects in a recording, beside its own."""
    selected = {c.id for c in fit.selection}
    effects = [e for e in shared() if e.id not in selected and e.channel in problem.evidence.channels]
    names = tuple((e.id, name) for e in effects for name in e.linear())
    X = np.column_stack(
        [np.zeros((len(problem.data), 0)), *problem.units([(catalogue()[e], {}, name) for e, name in names])]
    )
    data = problem.data - problem.effect_rows(fit.selection)
    left = Marginal(nuisance_design(problem, fit.selection)).projected(np.column_stack([X, data]))
    motion = problem.sensitivities.motion
    ranges: dict[str, Ranges] = {e.id: seen(motion, Selected(e, dict.fromkeys(e.linear(), 0.0), ())) for e in effects}
    span_s = float(problem.evidence.time_s[0]), float(problem.evidence.time_s[-1])
    return SufficientStatistics(names, X.T @ left[:, :-1], X.T @ left[:, -1], len(data), ranges, span_s)


def together(statistics: Sequence[SufficientStatistics], selected: set[str]) -> list[Finding]:
    """Findings of effects that no recording shows by itself."""
    every = dict.fromkeys(n for s in statistics for n in s.names)
    names = [n for n in every if n[0] not in selected and sum(n in s.names for s in statistics) > 0.5 * len(statistics)]
    parts = [_chosen(s, names) for s in statistics]
    rows, chosen, refused = sum(s.rows for s in statistics), dict[str, list[str]](), set[str]()
    while len(chosen) < MOST:
        ranked = [r for r in _ranked(parts, names, list(chosen), rows) if r[1] not in refused]
        if not ranked or ranked[0][0] <= 0.0:
            break
        best = ranked[0][1]
        also = [name for score, name in ranked[1:] if score > ranked[0][0] - CLASS_NATS]
        if _finding(statistics, parts, names, list(chosen), best, also) is None:
            refused.add(best)
        else:
            chosen[best] = also
    # Each beside all others, as the model has them.
    beside = {name: [other for other in chosen if other != name] for name in chosen}
    found = (_finding(statistics, parts, names, beside[name], name, also) for name, also in chosen.items())
    return [finding for finding in found if finding is not None]


def united(seen: Sequence[Ranges]) -> Ranges:
    """Union of the ranges of several recordings; a drive may show an effect at one value only."""
    covariates = sorted({name for one in seen for name in one})
    ends = {name: [one[name] for one in seen if name in one] for name in covariates}
    return {name: (min(low for low, _ in found), max(high for _, high in found)) for name, found in ends.items()}


def _chosen(one: SufficientStatistics, names: Sequence[tuple[str, str]]) -> Part:
    """Information and score of columns; a recording says nothing of those that it has not."""
    own = [i for i, name in enumerate(names) if name in one.names]
    index = [one.names.index(names[i]) for i in own]
    G, b = np.zeros((len(names), len(names))), np.zeros(len(names))
    G[np.ix_(own, own)], b[own] = one.G[np.ix_(index, index)], one.b[index]
    return G, b


def _index(names: Sequence[tuple[str, str]], effects: Sequence[str]) -> list[int]:
    return [i for i, (effect, _) in enumerate(names) if effect in effects]


def _solved(G: Array, b: Array, index: list[int]) -> Array:
    """Least-squares parameters of the columns `index`, the others 0."""
    x = np.zeros(len(b))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(G)[index], 1e-300))
    scaled = G[np.ix_(index, index)] * scale[:, None] * scale
    x[index] = scale * np.linalg.lstsq(scaled, scale * b[index], rcond=1e-8)[0]
    return x


def _sum(parts: Sequence[Part]) -> Part:
    return np.sum([G for G, _ in parts], axis=0), np.sum([b for _, b in parts], axis=0)


def _gain(parts: Sequence[Part], index: list[int]) -> float:
    G, b = _sum(parts)
    return 0.5 * float(b @ _solved(G, b, index))


def _ranked(
    parts: Sequence[Part], names: Sequence[tuple[str, str]], chosen: Sequence[str], rows: int
) -> list[tuple[float, str]]:
    """Score of each effect beside those chosen, nats; best first. Those that gain next to nothing are left out."""
    before = _gain(parts, _index(names, chosen))
    found = []
    for effect in dict.fromkeys(e for e, _ in names if e not in chosen):
        own = _index(names, [effect])
        gain = _gain(parts, _index(names, [*chosen, effect])) - before
        if gain >= LEAST_NATS:
            found.append((gain - 0.5 * len(own) * math.log(rows) - math.log(len(catalogue())), effect))
    return sorted(found, reverse=True)


def _finding(
    statistics: Sequence[SufficientStatistics],
    parts: Sequence[Part],
    names: Sequence[tuple[str, str]],
    chosen: Sequence[str],
    best: str,
    also: Sequence[str],
) -> Finding | None:
    """Finding of one effect; None where its gain over the recordings' scatter is too small, or its value absurd."""
    effect, index, own = catalogue()[best], _index(names, [*chosen, best]), _index(names, [best])
    G, b = _sum(parts)
    x, scatter = _solved(G, b, index), _scatter(parts, index)
    covariance = np.asarray(np.linalg.pinv(G[np.ix_(index, index)], rcond=1e-8, hermitian=True) * scatter, float)
    at = [index.index(i) for i in own]
    selected = Selected(effect, {names[i][1]: float(x[i]) for i in own}, effect.linear(), covariance[np.ix_(at, at)])
    gain = (_gain(parts, index) - _gain(parts, _index(names, chosen))) / scatter
    p = min(1.0, float(chdtrc(len(own), 2.0 * gain)) * len(catalogue()))
    if not is_plausible(selected) or gain < LEAST_NATS or p > FAMILY_WISE:
        return None
    e = e_value((_unseen(parts, index, own, 0) / scatter, _unseen(parts, index, own, 1) / scatter))
    return Finding(
        effect=best,
        status=Status.CONFIRMED if e >= CONFIRMING_E else Status.SUPPORTED,
        also_fits=tuple(also),
        acts_on=effect.channel,
        parameters=parameters_of(selected)[0],
        windows=((min(s.span_s[0] for s in statistics), max(s.span_s[1] for s in statistics)),),
        seen=united([s.ranges[best] for s in statistics if best in s.ranges]),
        covariate=effect.covariate,
        evidence=Support(gain, p, e),
        explains=None,
        sentence=sentence(selected, None, also) + f" No recording shows it alone; all {len(statistics)} together do.",
        probabilities=_alike(best, also, e),
    )


def _alike(best: str, also: Sequence[str], e: float) -> dict[str, float]:
    """Probabilities where nothing tells names from one another, and data unseen tell all from nothing by odds of e."""
    nothing = 1.0 / (1.0 + e)
    return {**dict.fromkeys([best, *also], (1.0 - nothing) / (1 + len(also))), NOTHING: nothing}


def _scatter(parts: Sequence[Part], index: list[int]) -> float:
    """Ratio of the scatter of the recordings' own values to that of their noise, at least 1 (Birge 1932)."""
    x = _solved(*_sum(parts), index)
    apart = sum(float(own @ G @ own) for G, b in parts for own in [_solved(G, b, index) - x])
    return max(1.0, apart / (len(index) * (len(parts) - 1)))


def _unseen(parts: Sequence[Part], index: list[int], own: list[int], half: int) -> float:
    """Log likelihood ratio on every other recording, the parameters being those of the rest."""
    train, test = parts[half::2], parts[1 - half :: 2]
    G, b = _sum(train)
    x = _solved(G, b, index)
    rest = _solved(G, b, [i for i in index if i not in own])

    def nats(values: Array) -> float:
        return sum(float(p[1] @ values) - 0.5 * float(values @ p[0] @ values) for p in test)

    return nats(x) - nats(rest)
