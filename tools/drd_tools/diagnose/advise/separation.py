"""Distance between what two causes would do to a drive, from products that add up over the drive's parts. (92)"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from scipy.special import ndtr

from drd.effects.effect import END, START
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import DISCREPANCY_SHARE
from drd_tools.diagnose.results import Array
from drd_tools.diagnose.select.splines import CHANNELS, COVARIATE_UNITS, PERIODIC, Curve, covariates, errors_along
from drd_tools.diagnose.selected import Selected

SETTLED_NATS: Final = 5.0  # more than search.CLASS_NATS: the two are then no longer one class
AS_GOOD_AS_FREE: Final = 1e-9  # prior information on a parameter that is to be fitted, over the data's
# The ground of an interval of time is driven over again.
INTERVAL_FROM_S, INTERVAL_S = 45.0, 60.0

Named = Selected | Curve  # what may be there


class Place(NamedTuple):
    """Columns of a cause: its own effect, derivatives with respect to its parameters, other shapes of it."""

    own: int
    tangents: range
    shapes: range


@dataclass(frozen=True)
class Layout:
    """Columns in the products: the nuisances first, then each cause's, by its identity."""

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
        values = [cause.value, *np.eye(len(cause.knots))]
        rows = problem.whiten([_curve_sensitivity(problem, replace(cause, value=v)) for v in values])
        return rows[:, 0], rows[:, 1:], rows[:, :0]
    shapes = problem.units(problem.wanted_shapes(cause))
    others = np.array(shapes).reshape(len(shapes), len(problem.data)).T
    return problem.effect_rows([cause]), problem.tangents([cause]), others


def _again(selected: Selected) -> Selected:
    """Shift an interval of time to where the drive passes its ground again; all else acts throughout."""
    if selected.begin_s is None:
        return selected
    times = {START.name: INTERVAL_FROM_S}
    if selected.end_s is not None:
        times[END.name] = INTERVAL_FROM_S + min(selected.end_s - selected.begin_s, INTERVAL_S)
    return replace(selected, values={**selected.values, **times})


def _curve_sensitivity(problem: Problem, curve: Curve) -> Sensitivity:
    """Sensitivity of a curve without a name; beyond its ends it stays as it is there."""
    m, known = problem.sensitivities.motion, covariates(problem)
    if curve.covariate not in known:
        return Sensitivity()
    period = 360.0 if curve.covariate in PERIODIC else None
    x = known[curve.covariate][0] * COVARIATE_UNITS[curve.covariate][1]
    value = np.interp(x, curve.knots, curve.value, period=period)
    errors = errors_along(m)[curve.channel](value / CHANNELS[curve.channel].public)
    return problem.sensitivities.of(errors)


def squared_distance(
    products: Array, layout: Layout, true: Named, rival: Named | None, beside: Sequence[Selected]
) -> Array:
    """Squared whitened distance (n,) between what a cause does and the nearest that its rival can do, in n drives.

    `products` (n, p, p): those of the drives' columns. The rival's parameters are free, and those of the effects
    `beside`; of each there are other shapes too. None in place of the rival: nothing.
    """
    a, others = layout.places[id(true)].own, [layout.places[id(c)] for c in (*beside, rival) if c is not None]
    shapes = [(i, place.own) for place in others for i in place.shapes]
    free = [i for place in others for i in place.tangents]
    held = [*layout.nuisances, *free, *(i for i, _ in shapes)]
    size = np.einsum("nii->ni", products)
    scale = np.ones((len(products), len(held)))
    first = len(layout.nuisances) + len(free)
    for k, (i, own) in enumerate(shapes, first):
        scale[:, k] = DISCREPANCY_SHARE * np.sqrt(size[:, own] / np.maximum(size[:, i], 1e-300))
    prior = np.ones_like(scale)
    # Of unit length with what the nuisances' priors add: the solution is then well scaled.
    prior[:, len(layout.nuisances) : first] = AS_GOOD_AS_FREE * (size[:, free] + 1e-300)
    length = np.sqrt(scale**2 * size[:, held] + prior)
    scale /= length
    A = products[:, held][:, :, held] * scale[:, :, None] * scale[:, None]
    diagonal = np.arange(len(held))
    A[:, diagonal, diagonal] += prior / length**2
    b, square = products[:, held, a], size[:, a]
    if rival is not None:
        at = layout.places[id(rival)].own
        b, square = b - products[:, held, at], square - 2.0 * products[:, a, at] + size[:, at]
    b = b * scale
    explained = np.einsum("ni,ni->n", b, np.linalg.solve(A, b[:, :, None])[:, :, 0])
    return np.asarray(np.maximum(square - explained, 0.0), float)


def settling_probability(squared: Array, price_nats: float) -> Array:
    """Probability that the likelihood ratio, less a price, passes SETTLED_NATS: it is N(d^2/2, d^2). (92)"""
    d = np.sqrt(np.maximum(squared, 1e-30))
    return np.asarray(ndtr((0.5 * squared - price_nats - SETTLED_NATS) / d), float)
