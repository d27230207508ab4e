"""Distance between the signals of two causes in a drive, from products that add up over the drive's parts. (92)"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from scipy.special import ndtr

from drd.arrays import Array
from drd.effects.effect import END, START
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.regression.problem import Problem, as_columns
from drd_tools.diagnose.regression.refine import DISCREPANCY_SHARE
from drd_tools.diagnose.select.splines import CHANNELS, COVARIATE_UNITS, PERIODIC, Curve, covariates, errors_along
from drd_tools.diagnose.selected import Selected

SETTLED_NATS: Final = 5.0  # more than search.CLASS_NATS: the two then no longer form a class
MOST_OCCAM: Final = 2.0  # largest mean, times d^2: determinants alone, without data, settle nothing
ROUNDS: Final = 3  # to match the size of a rival's other shapes to its own: further rounds change little
AS_GOOD_AS_FREE: Final = 1e-9  # prior information on a fitted parameter, over the data's
UNSEEN_SHARE: Final = 1e-24  # of a cause's square: less of a shape is rounding error
# When the ground of an interval effect is driven over again.
INTERVAL_FROM_S, INTERVAL_S = 45.0, 60.0

Named = Selected | Curve  # possible causes


class Place(NamedTuple):
    """Columns of a cause: its signal, the derivatives with respect to its parameters, and its other shapes."""

    own: int
    tangents: range
    shapes: range


@dataclass(frozen=True)
class Layout:
    """Layout of the columns: the nuisances first, then those of each cause, by its identity."""

    nuisances: range
    places: Mapping[int, Place]


def columns_of(problem: Problem, causes: Sequence[Named]) -> tuple[Array, Layout]:
    """Whitened columns (r, p) of nuisances and causes."""
    moved = [_again(c) if isinstance(c, Selected) else c for c in causes]
    selection = [c for c in moved if isinstance(c, Selected)]
    shapes = [w for c in selection for w in problem.wanted_shapes(c)]
    problem.units(problem.wanted_rows(selection) + problem.wanted_tangents(selection) + shapes)
    columns, at = [problem.nuisance], problem.nuisance.shape[1]
    nuisances, places = range(at), {}
    for cause, as_moved in zip(causes, moved, strict=True):
        own, tangents, others = _columns(problem, as_moved)
        first = at + 1 + tangents.shape[1]
        places[id(cause)] = Place(at, range(at + 1, first), range(first, first + others.shape[1]))
        columns += [own[:, None], tangents, others]
        at = first + others.shape[1]
    return np.concatenate(columns, axis=1), Layout(nuisances, places)


def _columns(problem: Problem, cause: Named) -> tuple[Array, Array, Array]:
    if isinstance(cause, Curve):
        # Only the size of the curve is free: the cost of its freedom is charged elsewhere.
        rows = problem.whiten([_curve_sensitivity(problem, cause)])
        return rows[:, 0], rows, rows[:, :0]
    others = as_columns(problem.units(problem.wanted_shapes(cause)), len(problem.data))
    return problem.effect_rows([cause]), problem.tangents([cause]), others


def _again(selected: Selected) -> Selected:
    """Shift an interval effect to the time when the drive passes its ground again; other effects are permanent."""
    if selected.begin_s is None:
        return selected
    times = {START.name: INTERVAL_FROM_S}
    if selected.end_s is not None:
        times[END.name] = INTERVAL_FROM_S + min(selected.end_s - selected.begin_s, INTERVAL_S)
    return replace(selected, values={**selected.values, **times})


def _curve_sensitivity(problem: Problem, curve: Curve) -> Sensitivity:
    """Sensitivity to an unnamed curve, constant beyond its ends."""
    m, known = problem.sensitivities.motion, covariates(problem)
    if curve.covariate not in known:
        return Sensitivity()
    period = 360.0 if curve.covariate in PERIODIC else None
    x = known[curve.covariate][0] * COVARIATE_UNITS[curve.covariate][1]
    value = np.interp(x, curve.knots, curve.value, period=period)
    errors = errors_along(m)[curve.channel](value / CHANNELS[curve.channel].public)
    return problem.sensitivities.of(errors)


def expected_ratio(
    products: Array, layout: Layout, true: Named, rival: Named | None, beside: Sequence[Selected]
) -> tuple[Array, Array]:
    """Mean and variance of the log likelihood ratio of the true cause to its rival, in n drives, (n,) each.

    `products` (n, p, p): of the drives' columns. The parameters of the rival and of the effects `beside` are free, and
    each has its other shapes. If the rival is None, it is "nothing".
    """
    found = layout.places[id(true)]
    other = None if rival is None else layout.places[id(rival)]
    squared, rival_size = _squared_distance(products, layout, found, other, [layout.places[id(c)] for c in beside])
    occam = _occam(products, layout, other, rival_size)
    occam -= _occam(products, layout, found, products[:, found.own, found.own])
    return np.minimum(0.5 * squared + occam, MOST_OCCAM * squared), squared


def _squared_distance(
    products: Array, layout: Layout, true: Place, rival: Place | None, beside: Sequence[Place]
) -> tuple[Array, Array]:
    """Squared distance (n,) between a cause and its rival's best fit to it, and the squared size of that fit."""
    others = [*beside, rival] if rival is not None else list(beside)
    free = [i for place in others for i in place.tangents]
    held = [*layout.nuisances, *free, *(i for place in others for i in place.shapes)]
    size = np.einsum("nii->ni", products)
    scale, prior = np.ones((2, len(products), len(held)))
    first = len(layout.nuisances) + len(free)
    scale[:, first:] = np.concatenate([_shape_scale(products, o, size[:, o.own]) for o in others] or [scale[:, :0]], 1)
    prior[:, len(layout.nuisances) : first] = AS_GOOD_AS_FREE * (size[:, free] + 1e-300)
    b, square, rival_size = products[:, held, true.own], size[:, true.own], np.zeros(len(products))
    if rival is not None:
        b = b - products[:, held, rival.own]
        square = square - 2.0 * products[:, true.own, rival.own] + size[:, rival.own]
    explained = np.zeros(len(products))
    for _ in range(ROUNDS if rival is not None else 1):
        # Scaled to unit length, including the priors, to be well conditioned.
        length = np.sqrt(scale**2 * size[:, held] + prior)
        unit = scale / length
        A = products[:, held][:, :, held] * unit[:, :, None] * unit[:, None]
        A[:, range(len(held)), range(len(held))] += prior / length**2
        x = np.linalg.solve(A, (b * unit)[:, :, None])[:, :, 0]
        explained = np.einsum("ni,ni->n", b * unit, x)
        if rival is not None:
            moves, of_shapes = (x * unit)[:, first - len(rival.tangents) : first], len(held) - len(rival.shapes)
            moves = moves + np.einsum("nks,ns->nk", _traded(products, rival), (x * unit)[:, of_shapes:])
            rival_size = _moved_size(products, rival, moves)
            scale[:, of_shapes:] = _shape_scale(products, rival, rival_size)
    return np.maximum(square - explained, 0.0), rival_size


def _moved_size(products: Array, place: Place, moves: Array) -> Array:
    """Squared size of a cause after its parameters have moved by (n, k)."""
    columns = [place.own, *place.tangents]
    x = np.concatenate([np.ones((len(moves), 1)), moves], axis=1)
    return np.asarray(np.maximum(np.einsum("ni,nij,nj->n", x, products[:, columns][:, :, columns], x), 0.0), float)


def _shape_scale(products: Array, place: Place, size: Array) -> Array:
    """Factors (n, s) that scale a cause's other shapes to their size in (75), from the cause's squared size."""
    own, size = products[:, place.shapes, place.shapes], size[:, None]
    ratio = np.divide(size, own, out=np.zeros(own.shape), where=own > UNSEEN_SHARE * size)
    return np.asarray(DISCREPANCY_SHARE * np.sqrt(ratio), float)


def _traded(products: Array, place: Place) -> Array:
    """Projection coefficients (n, k, s) of a cause's other shapes on its tangents."""
    tangents, shapes = list(place.tangents), list(place.shapes)
    T = products[:, tangents][:, :, tangents]
    least = AS_GOOD_AS_FREE * np.einsum("nii->n", T) + 1e-300
    return np.asarray(
        np.linalg.solve(T + least[:, None, None] * np.eye(len(tangents)), products[:, tangents][:, :, shapes]), float
    )


def _occam(products: Array, layout: Layout, place: Place | None, size: Array) -> Array:
    """Half the log determinant (n,) of nuisances and other shapes, these projected off the parameters. (74)"""
    nuisances = list(layout.nuisances)
    soft = products[:, nuisances][:, :, nuisances]
    if place is not None and len(place.shapes):
        shapes, tangents, k = list(place.shapes), list(place.tangents), len(nuisances)
        columns, traded = [*nuisances, *shapes], _traded(products, place)
        soft = products[:, columns][:, :, columns]
        of_nuisances = products[:, nuisances][:, :, tangents] @ traded
        soft[:, :k, k:] -= of_nuisances
        soft[:, k:, :k] -= of_nuisances.transpose(0, 2, 1)
        soft[:, k:, k:] -= products[:, shapes][:, :, tangents] @ traded
        scale = np.concatenate([np.ones((len(soft), k)), _shape_scale(products, place, size)], axis=1)
        soft = soft * scale[:, :, None] * scale[:, None]
    return np.asarray(0.5 * np.linalg.slogdet(soft + np.eye(soft.shape[1]))[1], float)


def settling_probability(mean: Array, variance: Array) -> Array:
    """Probability that a log likelihood ratio of this mean and variance exceeds SETTLED_NATS. (92)"""
    return np.asarray(ndtr((mean - SETTLED_NATS) / np.sqrt(np.maximum(variance, 1e-30))), float)
