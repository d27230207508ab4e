"""Predictive log-likelihood ratios of a model's terms in recordings that they were not fitted to."""

import math
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from drd.effects.model import Term
from drd_tools.diagnose.error_model.ranges import within
from drd_tools.diagnose.observe.constants import observe
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.noise_fit import fitted, inflated
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import discrepancies, refine
from drd_tools.diagnose.results import Ranges
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording

_Ranged = tuple[Selected, Ranges]

NOISE_ROUNDS: Final = 2  # the second with noise of which the effects are no part
CONTRADICTED_NATS: Final = -math.log(20.0)  # a term that is true has so little in one case of 20 at most


def held_out_nats(terms: Iterable[Term], held_out: Sequence[Recording]) -> dict[str, float]:
    """Log likelihood ratio of each lasting effect in all recordings together, beside the others that hold there.

    Those that do not hold, which have less than CONTRADICTED_NATS, are taken off one by one, the worst first.
    """
    kept = [_ranged(term) for term in terms if term.effect.lasting and term.effect.searched]
    found: dict[str, float] = {}
    while kept and held_out:
        # What does not hold passes for noise until it is off.
        others = [_HeldOut(recording, [selected for selected, _ in kept]) for recording in held_out]
        each = [sum(o.nats(kept, i) for o in others) for i in range(len(kept))]
        found |= {selected.id: nats for (selected, _), nats in zip(kept, each, strict=True)}
        worst = int(np.argmin(each))
        if each[worst] >= CONTRADICTED_NATS:
            break
        del kept[worst]
    return found


def _ranged(term: Term) -> _Ranged:
    stds = term.stds()
    return Selected(term.effect, term.values(), tuple(stds), np.diag(np.square(list(stds.values())))), term.seen


class _HeldOut:
    """A held-out recording, its noise fitted beside the selected effects as they are."""

    def __init__(self, recording: Recording, selection: Sequence[Selected]):
        _, audited = observe(recording)
        fixed = [Selected(c.effect, c.values, ()) for c in selection]
        problem = Problem(audited.evidence)
        for _ in range(NOISE_ROUNDS):
            near = problem.around(fixed)
            fit = refine(near, [*fixed, *(event.selected for event in audited.events)])
            noise, fix_inflation = fitted(near, fit, searched=True)
            inflation = inflated(near, fit.left, noise, searched=False)
            problem = Problem(problem.evidence, problem.path, noise, fix_inflation, inflation=inflation)
        self._problem = problem
        self._events = list(refine(problem, [event.selected for event in audited.events]).selection)
        self._known: dict[tuple[str, ...], float] = {}

    def nats(self, selection: Sequence[_Ranged], which: int) -> float:
        """Log likelihood ratio of one selected effect beside the others."""
        return self._evidence(selection) - self._evidence([*selection[:which], *selection[which + 1 :]])

    def _evidence(self, selection: Sequence[_Ranged]) -> float:
        """Log likelihood around the path as it is, or around the one without the effects: whichever is more."""
        key = tuple(selected.id for selected, _ in selection)
        if key not in self._known:
            problems = [self._problem, self._problem.around([*(c for c, _ in selection), *self._events])]
            self._known[key] = max(self._marginal(problem, selection) for problem in problems)
        return self._known[key]

    def _marginal(self, problem: Problem, selection: Sequence[_Ranged]) -> float:
        """Log marginal likelihood: nuisances, parameters as far as known, and causes' shapes integrated over. (86)"""
        residual = problem.data - problem.effect_rows(self._events)
        columns = []
        for selected, ranges in selection:
            held = problem.along(within(problem.sensitivities.motion, ranges))
            rows = held.effect_rows([selected])
            if np.isfinite(rows).all():  # of a temperature that was not recorded nothing is known
                residual = residual - rows
                columns += [
                    held.tangents([selected]) * np.sqrt(np.diag(selected.covariance)),
                    discrepancies(held, selected),
                ]
        return Marginal(np.column_stack([problem.nuisance, *columns])).nats(residual)
