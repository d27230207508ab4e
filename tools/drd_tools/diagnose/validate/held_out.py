"""Predictive log-likelihood ratios of a model's terms in held-out recordings."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from threadpoolctl import threadpool_limits

from drd.effects.model import Term
from drd_tools.diagnose.error_model.path import Path
from drd_tools.diagnose.error_model.ranges import within
from drd_tools.diagnose.observe.audit import Audit
from drd_tools.diagnose.observe.constants import Constants, observe
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.noise_fit import noise_beside
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import discrepancies, refine
from drd_tools.diagnose.results import Figures, Ranges
from drd_tools.diagnose.select.start import started
from drd_tools.diagnose.selected import Selected
from drd_tools.diagnose.validate.trajectory import errors_of
from drd_tools.processes import Map
from drd_tools.recordings.folder import Recording

_Ranged = tuple[Selected, Ranges]

NOISE_ROUNDS: Final = 2  # the second with noise that no longer contains the effects
CONTRADICTED_NATS: Final = -math.log(20.0)  # a true term has so little in at most one case of 20


@dataclass(frozen=True)
class Prepared:
    """A held-out recording, with everything that does not depend on a model.

    `measured`: its constants; `audited`: its evidence, including whether the robot is far from robot.yaml; `path`: its
    path before any effect; `nominal`: errors of the nominal poses.
    """

    recording: Recording
    measured: Constants
    audited: Audit
    path: Path
    nominal: Figures


def prepared(recording: Recording) -> Prepared:
    """Compute what does not depend on a model, once for all models."""
    with threadpool_limits(limits=1):
        measured, audited = observe(recording)
        problem = started(audited, measured).problem
        audited = replace(audited, evidence=problem.evidence)
        # A late reference is not an error of the pose: judge with corrected stamps.
        return Prepared(recording, measured, audited, problem.path, errors_of(measured.recording, None))


def held_out_nats(terms: Iterable[Term], held_out: Sequence[Prepared], each: Map = map) -> dict[str, float]:
    """Log likelihood ratio of each lasting effect in all recordings together, beside the others that hold there.

    Effects that do not hold, with less than CONTRADICTED_NATS, are removed one at a time, the worst first.
    """
    kept = [_ranged(term) for term in terms if term.effect.lasting and term.effect.searched]
    found: dict[str, float] = {}
    while kept and held_out:
        # The noise is refitted each time: a wrong effect inflates it until it is removed.
        nats = np.sum(list(each(partial(_nats, kept), held_out)), axis=0)
        found |= {selected.id: float(n) for (selected, _), n in zip(kept, nats, strict=True)}
        worst = int(np.argmin(nats))
        if nats[worst] >= CONTRADICTED_NATS:
            break
        del kept[worst]
    return found


def _nats(selection: Sequence[_Ranged], held_out: Prepared) -> list[float]:
    """Log likelihood ratio of each selected effect beside the others in one recording."""
    drive = _HeldOut(held_out, [selected for selected, _ in selection])
    return [drive.nats(selection, i) for i in range(len(selection))]


def _ranged(term: Term) -> _Ranged:
    stds = term.stds()
    return Selected(term.effect, term.values(), tuple(stds), np.diag(np.square(list(stds.values())))), term.seen


class _HeldOut:
    """A held-out recording, its noise fitted beside the selected effects at fixed parameters."""

    def __init__(self, held_out: Prepared, selection: Sequence[Selected]):
        audited, fixed = held_out.audited, [Selected(c.effect, c.values, ()) for c in selection]
        problem = Problem(audited.evidence, held_out.path)
        for _ in range(NOISE_ROUNDS):
            near = problem.around(fixed)
            fit = refine(near, [*fixed, *(event.selected for event in audited.events)])
            problem = problem.with_noise(*noise_beside(near, fit))
        self._problem = problem
        self._events = list(refine(problem, [event.selected for event in audited.events]).selection)
        self._known: dict[tuple[str, ...], float] = {}

    def nats(self, selection: Sequence[_Ranged], which: int) -> float:
        """Log likelihood ratio of one selected effect beside the others."""
        return self._evidence(selection) - self._evidence([*selection[:which], *selection[which + 1 :]])

    def _evidence(self, selection: Sequence[_Ranged]) -> float:
        """Log likelihood around the initial path, or around the one with the effects removed: the larger."""
        key = tuple(selected.id for selected, _ in selection)
        if key not in self._known:
            problems = [self._problem, self._problem.around([*(c for c, _ in selection), *self._events])]
            self._known[key] = max(self._marginal(problem, selection) for problem in problems)
        return self._known[key]

    def _marginal(self, problem: Problem, selection: Sequence[_Ranged]) -> float:
        """Log marginal likelihood: nuisances, parameters within their sigmas, and other shapes integrated out. (86)"""
        residual = problem.data - problem.effect_rows(self._events)
        columns = []
        for selected, ranges in selection:
            held = problem.along(partial(within, ranges=ranges))
            rows = held.effect_rows([selected])
            if np.isfinite(rows).all():  # not finite if the temperature was not recorded
                residual = residual - rows
                columns += [
                    held.tangents([selected]) * np.sqrt(np.diag(selected.covariance)),
                    discrepancies(held, selected),
                ]
        return Marginal(np.column_stack([problem.nuisance, *columns])).nats(residual)
