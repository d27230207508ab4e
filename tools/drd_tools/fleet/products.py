"""Score and information of a recording over all effects and nuisances, and estimates of the robot's constants.

They come from the whitened regression of a diagnosis (74), linearised around its model, with its fitted noise.
"""

import json
import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, discrepancies, nuisance_design, precisions
from drd_tools.diagnose.select.intervals import is_of_interval
from drd_tools.diagnose.select.library import Parameters, is_seen, units_of, variants
from drd_tools.diagnose.selected import Selected, shape_of

TOLD: Final = 0.5  # of a parameter's prior standard deviation: above this, the recording does not determine it
WIDER: Final = 10.0  # times the prior's sigma, so that it does not shrink a value: the fleet has its own prior
RCOND: Final = 1e-8  # for the columns of a variant


class Constant(NamedTuple):
    """Effect and parameter of the catalogue for a robot's constant, and its unit."""

    effect: str
    parameter: str
    unit: str


# Errors relative to robot.yaml's: radius 1 - nominal / true, tread true / nominal - 1, scale of the gyro's rate.
CONSTANTS: Final = {
    "radius_left": Constant("wheel_radius_error", "left", "1"),
    "radius_right": Constant("wheel_radius_error", "right", "1"),
    "tread": Constant("tread_error", "k", "1"),
    "lag_s": Constant("encoder_latency", "delay", "s"),
    "gyro_scale": Constant("gyro_scale_error", "k", "1"),
    "bias_per_c": Constant("gyro_bias_temperature", "b1", "rad/s/degC"),
}
EFFECTS: Final = {constant.effect for constant in CONSTANTS.values()}


# ---- all effects and nuisances -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Column:
    """A column (r,) of the regression: a unit of a linear parameter, or the whole effect if `parameter` is ""."""

    kind: str
    effect: str
    parameter: str
    shape: Parameters
    rows: Array


def products(problem: Problem, fit: Fit) -> list[dict[str, Any]]:
    """Rows of the table of products, see `schema`: effects found with their shape, others with the best variant's.

    Effects with an interval of time are included only if they were found: each drive has its own.
    """
    columns = list(_columns(problem, fit))
    X = np.column_stack([np.zeros((len(problem.data), 0)), *(c.rows for c in columns)])
    information, score, square = X.T @ X, X.T @ problem.data, float(problem.data @ problem.data)
    return [
        {
            "at": i,
            "kind": c.kind,
            "effect": c.effect,
            "parameter": c.parameter,
            "shape": json.dumps(c.shape, sort_keys=True),
            "score": float(score[i]),
            "information": information[i].tolist(),
            "square": square,
            "rows": len(problem.data),
        }
        for i, c in enumerate(columns)
    ]


def _columns(problem: Problem, fit: Fit) -> Iterator[Column]:
    marginal = Marginal(nuisance_design(problem, fit.selection))
    left = marginal.projected((problem.data - problem.effect_rows(fit.selection))[:, None])[:, 0]

    def gain(columns: Sequence[Column]) -> float:
        """Gain of columns beside the fit and the nuisances, nats."""
        X = np.column_stack([c.rows for c in columns])
        G, b = marginal.beside(X.T @ X, marginal.columns.T @ X), X.T @ left
        return 0.5 * float(b @ np.linalg.lstsq(G, b, rcond=RCOND)[0])

    for effect in catalogue().values():
        found = [c for c in fit.selection if c.id == effect.id]
        for selected in found:
            yield from _of_shape(problem, effect, shape_of(effect, selected.values))
        if not found and effect.searched and effect.channel in problem.evidence.channels and not is_of_interval(effect):
            made = [list(_of_shape(problem, effect, shape)) for shape in variants(problem, effect)]
            seen = [columns for columns in made if columns]
            yield from max(seen, key=gain, default=[])
    for (name, _, _), rows in zip(problem.nuisances, problem.nuisance.T, strict=True):
        yield Column("nuisance", name, "", {}, rows)


def _of_shape(problem: Problem, effect: Effect, shape: Parameters) -> Iterator[Column]:
    """Columns of one shape of an effect; none if the drive does not show it."""
    units = units_of(effect, shape)
    sensitivities = [problem.unit(effect, s, name) for s, name in units]
    if all(map(is_seen, sensitivities)):
        for (s, name), rows in zip(units, problem.whiten(sensitivities).T, strict=True):
            yield Column("effect", effect.id, name, s, rows)


# ---- the robot's constants -----------------------------------------------------------------------------------------


def constants(problem: Problem, fit: Fit, same: Collection[str] = ()) -> list[dict[str, Any]]:
    """Name, value, sigma and unit of each constant that the recording determines, whether a finding or not.

    They are estimated jointly, by one Gauss-Newton step from the fit, with the nuisances and the other effects found,
    except those that the drive cannot distinguish from a constant (`same`), which the constants replace.
    """
    selection = [
        *_with_constants(problem, fit),
        *(c for c in fit.selection if c.id not in EFFECTS and c.id not in same),
    ]
    T = problem.tangents(selection)
    # No discrepancy of the constants' own effects: they imitate each other (a radius that changes in turns is a tread).
    others = [c for c in selection if c.id not in EFFECTS]
    soft = np.column_stack([problem.nuisance, *(discrepancies(problem, c) for c in others)])
    marginal, precision = Marginal(soft), np.concatenate([np.zeros(0), *map(precisions, selection)]) / WIDER**2
    at = np.array([c.number(name) for c in selection for name in c.free])
    left = problem.data - problem.effect_rows(selection)
    G = marginal.beside(T.T @ T, soft.T @ T) + np.diag(precision)
    scale = 1.0 / np.sqrt(np.diag(G))
    covariance = np.linalg.inv(G * scale[:, None] * scale) * scale[:, None] * scale
    value = at + covariance @ (T.T @ marginal.projected(left[:, None])[:, 0] - precision * at)
    places = [(c.id, name) for c in selection for name in c.free]
    rows = []
    for name, constant in CONSTANTS.items():
        i = places.index(constant[:2]) if constant[:2] in places else -1
        sigma = math.sqrt(covariance[i, i]) if i >= 0 else math.inf
        if i >= 0 and sigma < TOLD / WIDER / math.sqrt(precision[i]):
            rows.append({"name": name, "value": float(value[i]), "sigma": sigma, "unit": constant.unit})
    return rows


def _with_constants(problem: Problem, fit: Fit) -> list[Selected]:
    """Effects of the constants with their values in the fit, or of size 0, each constant free."""
    made = []
    for effect in (catalogue()[name] for name in dict.fromkeys(c.effect for c in CONSTANTS.values())):
        free = tuple(c.parameter for c in CONSTANTS.values() if c.effect == effect.id)
        found = next((c for c in fit.selection if c.id == effect.id), None)
        if found is not None:
            made.append(replace(found, free=tuple(dict.fromkeys([*found.free, *free]))))
        elif effect.channel in problem.evidence.channels:
            made.append(Selected(effect, {q.name: 0.0 for q in effect.parameters}, free))
    return made
