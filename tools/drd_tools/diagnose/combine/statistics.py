"""Sufficient statistics of one recording for effects that it may share with other recordings of its robot. (89)"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd.effects.effect import ActsOn, Effect
from drd_tools.diagnose.error_model.ranges import seen
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import FREE, Fit, free_columns, shape_columns
from drd_tools.diagnose.results import Finding, Ranges, Window
from drd_tools.diagnose.selected import Selected, linear_names

Name = tuple[str, str]  # of a column: an effect and one of its parameters
Part = tuple[Array, Array]  # G (p, p) and b (p,)


@dataclass(frozen=True)
class SufficientStatistics:
    """One recording's information `G` (p, p) and score `b` (p,) of the columns `names`, from `rows` rows of data.

    `ranges`: range of each effect's covariate, by the effect's name; `span_s`: start and end. `own`: the effects that
    it has selected itself.
    """

    names: tuple[Name, ...]
    G: Array
    b: Array
    rows: int
    ranges: dict[str, Ranges]
    span_s: Window
    own: frozenset[str] = frozenset()

    def beside(self, effects: Collection[str]) -> "SufficientStatistics":
        """Project these effects out of the statistics, leaving the others."""
        out = columns_of(self.names, effects)
        if not out:
            return self
        kept = [i for i in range(len(self.names)) if i not in out]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self.G)[out], 1e-300))[:, None]
        A = self.G[np.ix_(out, out)] * scale * scale.T + np.eye(len(out)) / FREE**2
        share = scale * np.linalg.solve(A, scale * self.G[np.ix_(out, kept)])
        G, b = self.G[np.ix_(kept, kept)] - self.G[np.ix_(kept, out)] @ share, self.b[kept] - self.b[out] @ share
        return replace(self, names=tuple(self.names[i] for i in kept), G=G, b=b, own=self.own.difference(effects))

    def part(self, names: Sequence[Name]) -> Part:
        """Information and score of columns; 0 for those that it does not have."""
        own = [i for i, name in enumerate(names) if name in self.names]
        index = [self.names.index(names[i]) for i in own]
        G, b = np.zeros((len(names), len(names))), np.zeros(len(names))
        G[np.ix_(own, own)], b[own] = self.G[np.ix_(index, index)], self.b[index]
        return G, b

    @cached_property
    def alone(self) -> "SufficientStatistics":
        """The statistics of the effects that it has not selected, beside its own."""
        return self.beside(self.own)

    def log_bayes_factor(self, effect: str, prior: Mapping[str, tuple[float, float]]) -> float | None:
        """Log Bayes factor for an effect, nats; None if it has no columns, or is among its own effects. (89)

        `prior`: mean and standard deviation, SI, of each parameter.
        """
        names = self.alone.names
        if not prior or not all((effect, name) in names for name in prior):
            return None
        index = [names.index((effect, name)) for name in prior]
        mean, std = np.transpose(list(prior.values()))
        G, weight = self.alone.G[np.ix_(index, index)], np.diag(std**-2.0)
        score = self.alone.b[index] + weight @ mean
        nats = 0.5 * float(score @ np.linalg.solve(G + weight, score) - mean @ weight @ mean)
        return nats - 0.5 * float(np.linalg.slogdet(np.eye(len(mean)) + std[:, None] ** 2 * G)[1])


def shared() -> list[Effect]:
    """Effects whose parameters are all linear and have the same meaning in each recording."""
    return [
        e
        for e in catalogue().values()
        if e.lasting
        and e.covariate != "temperature"  # it counts from each recording's own standstill
        and e.acts_on not in (ActsOn.TIMING, ActsOn.READOUT)
        and all(q.linear for q in e.parameters)
    ]


def may_stand_for_shared(finding: Finding) -> bool:
    """Whether a finding of one run has an effect common to all runs as an alternative."""
    is_of_one = finding.is_named and not catalogue()[finding.effect].lasting
    return is_of_one and not {e.id for e in shared()}.isdisjoint(finding.also_fits)


def sufficient_statistics(problem: Problem, fit: Fit, surrogates: Collection[str] = ()) -> SufficientStatistics:
    """Score and information of the shared effects in a recording, and of its `surrogates` for them, beside the rest.

    Surrogates are linearised around their fitted parameters.
    """
    effects = [e for e in shared() if e.channel in problem.evidence.channels]
    stand_ins = [c for c in fit.selection if c.id in surrogates and c.effect not in effects]
    own = [c for c in fit.selection if c.effect in effects and set(linear_names(c.effect, c.values)) == set(c.free)]
    rest = [c for c in fit.selection if c not in own and c not in stand_ins]
    shared_names = tuple((e.id, name) for e in effects for name in e.linear())
    names = (*shared_names, *((c.id, name) for c in stand_ins for name in c.free))
    X = np.column_stack(
        [
            np.zeros((len(problem.data), 0)),
            *problem.units([(catalogue()[e], {}, name) for e, name in shared_names]),
            problem.tangents(stand_ins),
        ]
    )
    data = problem.data - problem.effect_rows(rest)
    N = np.column_stack([shape_columns(problem, [*rest, *own]), free_columns(problem, rest)])
    left = Marginal(N).projected(np.column_stack([X, data]))
    motion = problem.sensitivities.motion
    ranges: dict[str, Ranges] = {e.id: seen(motion, Selected(e, dict.fromkeys(e.linear(), 0.0), ())) for e in effects}
    span_s = float(problem.evidence.time_s[0]), float(problem.evidence.time_s[-1])
    mine = frozenset(c.id for c in (*own, *stand_ins))
    return SufficientStatistics(names, X.T @ left[:, :-1], X.T @ left[:, -1], len(data), ranges, span_s, mine)


def columns_of(names: Sequence[Name], effects: Collection[str]) -> list[int]:
    """Indices of the columns of these effects."""
    return [i for i, (effect, _) in enumerate(names) if effect in effects]
