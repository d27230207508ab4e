"""Effects that several recordings of one robot show together, though few or none shows them alone.

The sums of their sufficient statistics are those of one regression over all recordings with common parameters. (89)
"""

import math
from collections.abc import Collection, Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.special import chdtrc

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.combine.statistics import Name, Part, SufficientStatistics, columns_of, shared
from drd_tools.diagnose.conclude.cause import sentence
from drd_tools.diagnose.conclude.conclusion import LEAST_NATS
from drd_tools.diagnose.conclude.confirm import e_value
from drd_tools.diagnose.conclude.judgement import CONFIRMING_E, FAMILY_WISE
from drd_tools.diagnose.conclude.outcome import parameters_of
from drd_tools.diagnose.results import NOTHING, Finding, Ranges, Status, Support
from drd_tools.diagnose.select.library import is_plausible
from drd_tools.diagnose.select.search import CLASS_NATS
from drd_tools.diagnose.selected import Selected

MOST: Final = 4  # effects found only in all recordings together: limits a greedy search


class Common(NamedTuple):
    """Findings common to all recordings, and the effects specific to each of them."""

    findings: list[Finding]
    own: list[frozenset[str]]


def together(statistics: Sequence[SufficientStatistics], selected: Collection[str]) -> Common:
    """Find effects common to all besides those `selected`, which are specific to each recording that shows them.

    An effect is also specific to a recording if it is clearly stronger there, or has another value.
    """
    own = [s.own.intersection(selected) for s in statistics]
    while True:
        parts = [s.beside(its) for s, its in zip(statistics, own, strict=True)]
        found, refused = _common(parts, selected)
        more = [set[str]() for _ in parts]
        for effect in refused:
            for i in _furthest(parts, effect):
                more[i].add(effect)
        # A single recording that hides an effect common to the others comes first.
        more = more if any(more) else [_unlike(s, found) for s in parts]
        if not any(more):
            return Common(found, own)
        own = [its | new for its, new in zip(own, more, strict=True)]


def _unlike(one: SufficientStatistics, found: Sequence[Finding]) -> set[str]:
    """A recording's own effects that differ from the common ones: as additional names they are worth their cost."""
    units = {(f.effect, q.name): q.si for f in found for q in catalogue()[f.effect].parameters}
    values = {(f.effect, name): a.value * units[f.effect, name] for f in found for name, a in f.parameters.items()}
    kept = [i for i, n in enumerate(one.names) if n in values or n[0] in one.own]
    names, G = [one.names[i] for i in kept], one.G[np.ix_(kept, kept)]
    left = one.b[kept] - G @ [values.get(n, 0.0) for n in names]

    def gain(effect: str) -> float:
        index = columns_of(names, [effect])
        return _gain([(G, left)], index) - _cost(len(index), one.rows)

    return {effect for effect in one.own if gain(effect) > 0.0}


def _furthest(statistics: Sequence[SufficientStatistics], effect: str) -> list[int]:
    """Index of the recording, among those that have selected an effect, whose value is furthest from the common one;
    all of these if none is clearly apart.
    """
    holders = [i for i, s in enumerate(statistics) if effect in s.own]
    if not holders:
        return []
    names = [n for n in statistics[holders[0]].names if n[0] == effect]
    parts, index = [s.part(names) for s in statistics], list(range(len(names)))
    x = _solved(*_sum(parts), index)

    def gain(i: int) -> float:
        G, b = parts[i]
        return _gain([(G, b - G @ x)], index)

    worst = max(holders, key=gain)
    return [worst] if gain(worst) > _cost(len(index), statistics[worst].rows) else holders


def _cost(parameters: int, rows: int) -> float:
    """Cost of one more effect, nats. (80)"""
    return 0.5 * parameters * math.log(rows) + math.log(len(catalogue()))


def _common(statistics: Sequence[SufficientStatistics], selected: Collection[str]) -> tuple[list[Finding], set[str]]:
    """Findings of effects besides those `selected`, and the names whose common value is rejected."""
    every, alike = dict.fromkeys(n for s in statistics for n in s.names), {e.id for e in shared()}.difference(selected)
    names = [n for n in every if n[0] in alike and sum(n in s.names for s in statistics) > 0.5 * len(statistics)]
    parts = [s.part(names) for s in statistics]
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
    # Estimate each beside all others, as in the model.
    beside = {name: [other for other in chosen if other != name] for name in chosen}
    found = (_finding(statistics, parts, names, beside[name], name, also) for name, also in chosen.items())
    return [finding for finding in found if finding is not None], refused


def united(seen: Sequence[Ranges]) -> Ranges:
    """Union of the ranges of several recordings; a drive may show an effect at one value only."""
    covariates = sorted({name for one in seen for name in one})
    ends = {name: [one[name] for one in seen if name in one] for name in covariates}
    return {name: (min(low for low, _ in found), max(high for _, high in found)) for name, found in ends.items()}


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


def _ranked(parts: Sequence[Part], names: Sequence[Name], chosen: Sequence[str], rows: int) -> list[tuple[float, str]]:
    """Score of each effect beside those chosen, nats; best first. Negligible gains are left out."""
    before = _gain(parts, columns_of(names, chosen))
    found = []
    for effect in dict.fromkeys(e for e, _ in names if e not in chosen):
        own = columns_of(names, [effect])
        gain = _gain(parts, columns_of(names, [*chosen, effect])) - before
        if gain >= LEAST_NATS:
            found.append((gain - _cost(len(own), rows), effect))
    return sorted(found, reverse=True)


def _finding(
    statistics: Sequence[SufficientStatistics],
    parts: Sequence[Part],
    names: Sequence[Name],
    chosen: Sequence[str],
    best: str,
    also: Sequence[str],
) -> Finding | None:
    """Finding of one effect; None if its gain over the recordings' scatter is too small, or its value implausible."""
    effect, index, own = catalogue()[best], columns_of(names, [*chosen, best]), columns_of(names, [best])
    G, b = _sum(parts)
    x, scatter = _solved(G, b, index), _scatter(parts, index)
    covariance = np.asarray(np.linalg.pinv(G[np.ix_(index, index)], rcond=1e-8, hermitian=True) * scatter, float)
    at = [index.index(i) for i in own]
    selected = Selected(effect, {names[i][1]: float(x[i]) for i in own}, effect.linear(), covariance[np.ix_(at, at)])
    gain = (_gain(parts, index) - _gain(parts, columns_of(names, chosen))) / scatter
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
        sentence=sentence(selected, None, also),
        probabilities=_alike(best, also, e),
    )


def _alike(best: str, also: Sequence[str], e: float) -> dict[str, float]:
    """Probabilities of indistinguishable names, with odds e from unseen data that it is any of them."""
    nothing = 1.0 / (1.0 + e)
    return {**dict.fromkeys([best, *also], (1.0 - nothing) / (1 + len(also))), NOTHING: nothing}


def _scatter(parts: Sequence[Part], index: list[int]) -> float:
    """Ratio of the scatter of the recordings' own values to that of their noise, at least 1 (Birge 1932)."""
    x = _solved(*_sum(parts), index)
    apart = sum(float(own @ G @ own) for G, b in parts for own in [_solved(G, b, index) - x])
    return max(1.0, apart / (len(index) * (len(parts) - 1)))


def _unseen(parts: Sequence[Part], index: list[int], own: list[int], half: int) -> float:
    """Log likelihood ratio on every other recording, with the parameters of the rest."""
    train, test = parts[half::2], parts[1 - half :: 2]
    G, b = _sum(train)
    x = _solved(G, b, index)
    rest = _solved(G, b, [i for i in index if i not in own])

    def nats(values: Array) -> float:
        return sum(float(p[1] @ values) - 0.5 * float(values @ p[0] @ values) for p in test)

    return nats(x) - nats(rest)
