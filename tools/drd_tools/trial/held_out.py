"""Benefit of a diagnosis on another drive of the same robot, compared with an oracle that knows the truth."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

import drd
from drd.arrays import Array
from drd.effects.effect import Effect, Values
from drd.effects.model import Amount, Term
from drd_tools.diagnose.analysis import Analysis
from drd_tools.diagnose.conclude import outcome
from drd_tools.diagnose.conclude.cause import named
from drd_tools.diagnose.error_model.ranges import seen, within
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.results import Ranges
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.result import table
from drd_tools.trial.overlay import Effects
from drd_tools.trial.results import Mismatch, OtherDrive
from drd_tools.trial.unknown import HIDDEN

_Ranged = tuple[Selected, Ranges]


def judged(result: Analysis, truth: Effects, other: Recording) -> OtherDrive:
    """Mismatch of `other` uncorrected, with the effects found, and with the true ones (the oracle), none refitted.

    In the residual the reference's own nuisances are fitted. With hidden physics there is no oracle of the path.
    """
    problem = Problem(gather(other))
    home = result.conclusion.found.problem.sensitivities.motion
    selection = [(selected, seen(home, selected)) for selected in named(result.conclusion.causes)]
    true: list[_Ranged] = [(Selected(effect, values, ()), {}) for effect, values in truth]
    before = _squares(problem, ())
    after, oracle = (_corrected(problem, chosen) if chosen else before for chosen in (selection, true))
    recording = result.recording
    terms = outcome.terms_found(outcome.findings_of(result.conclusion))
    model = outcome.model_of(terms, recording, recording.name, drd.__version__).terms
    before_m = _path_m(other, ())
    path_m = Mismatch(before_m, _path_m(other, model) if model else before_m)
    if not any(effect.id in HIDDEN for effect, _ in truth):
        path_m.oracle = _path_m(other, [_term(*pair) for pair in truth]) if truth else before_m
    return OtherDrive(len(problem.data), Mismatch(before, after, oracle), path_m)


def _corrected(problem: Problem, selection: Sequence[_Ranged]) -> float:
    """Squares around the nominal path or around the one without the selected effects, whichever are smaller."""
    return min(_squares(p, selection) for p in (problem, problem.around([selected for selected, _ in selection])))


def _squares(problem: Problem, selection: Sequence[_Ranged]) -> float:
    residual = problem.data - sum((_rows(problem, *ranged) for ranged in selection), np.zeros(len(problem.data)))
    return float(residual @ Marginal(problem.nuisance).projected(residual))


def _rows(problem: Problem, selected: Selected, seen: Ranges) -> Array:
    """Rows that a selected effect explains, with its covariate clipped to the observed range, as in model.yaml."""
    return problem.along(partial(within, ranges=seen)).effect_rows([selected])


def _term(effect: Effect, values: Values) -> Term:
    return Term(
        effect,
        {q.name: v if isinstance(v := values[q.name], str) else Amount(float(v) / q.si) for q in effect.parameters},
    )


def _path_m(recording: Recording, terms: Sequence[Term]) -> float:
    log = recording.reference
    assert log is not None
    rows = table(replay_folder(replace(recording, terms=tuple(terms))))
    x, y = (np.interp(log.time_s, rows[:, 0], rows[:, k]) for k in (1, 2))
    return math.sqrt(float(np.mean((x - log.x_m) ** 2 + (y - log.y_m) ** 2)))
