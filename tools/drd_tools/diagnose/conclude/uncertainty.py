"""Reported estimates of all parameters of the selected effects, with deviations that cover the truth.

The curvature at the best fit is overconfident in four ways: a parameter that was left out because it gained less than
its cost is not zero; an edge of a window may lie anywhere in a time without information on it; no form is exact; and
the ground of an interval differs from that of others by more than white noise.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.effects.effect import Begins, Parameter
from drd_tools.calibrate.wheels.drift import REFERENCE_WANDER_S, WHEELS_WANDER_S
from drd_tools.diagnose.conclude.reference import reference_deviation
from drd_tools.diagnose.observe.constants import WIDER
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, refine, refine_all, response
from drd_tools.diagnose.select.library import is_plausible
from drd_tools.diagnose.selected import Selected

PASSING_SHARE: Final = 0.04  # of an effect's size: other shapes of its cause that alter its parameters
REACHES: Final = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # in the curvature's deviations
FINE: Final = 2000  # points of a profile's integral: far finer than REACHES
USUAL: Final = 3.0  # times the geometric mean of a parameter's range
FEWEST_PLACES: Final = 3  # a profile of fewer points has no width


def reported_estimates(
    problem: Problem, fit: Fit, known: Collection[str] = (), scatter: Callable[[Selected], float] = lambda _: 1.0
) -> tuple[Selected, ...]:
    """Reported estimates of a fit's effects, in its order; effects `known` by logic stay unchanged. (87)

    `scatter`: variation of an effect's sizes from interval to interval, relative to their deviations.
    """
    scatters = [scatter(selected) for selected in fit.selection]
    fit = _widened(problem, fit, known)
    uncertain = response(problem, fit)
    shapes = uncertain.discrepancy_shapes
    covariance = uncertain.covariance + PASSING_SHARE**2 * shapes @ shapes.T
    shrunken = shrunk(fit.selection, covariance, problem.per_parameter, known)
    selection, first = [], 0
    for i, selected in enumerate(fit.selection):
        k = len(selected.free)
        own = covariance[first : first + k, first : first + k]
        first += k
        if selected.id in known or not k:
            selection.append(selected)
            continue
        deviation = np.sqrt(np.maximum(np.diag(own), 0.0))
        profiled = [_distances(problem, fit, i, name) for name in selected.free if _is_curved(selected, name)]
        widths = np.minimum(np.max([deviation, *profiled], axis=0), _most(problem, selected))
        widths *= [scatters[i] if selected.parameter(name).linear else 1.0 for name in selected.free]
        by_itself = [reference_deviation(problem, selected, name) for name in selected.free]
        widths = np.hypot(np.hypot(widths, by_itself), _by_themselves(problem, selected))
        scale = np.divide(widths, deviation, out=np.ones(k), where=deviation > 0.0)
        selection.append(replace(shrunken[i], covariance=own * scale[:, None] * scale))
    return tuple(selection)


def _by_themselves(problem: Problem, selected: Selected) -> float:
    """Deviation of a clock rate due to natural changes of the lags of wheels and reference; 0 for other effects. (87)

    It is at least the calibration's, which may rest on few turns.
    """
    effect, e = selected.effect, problem.evidence
    if not selected.is_timing or effect.begins is not Begins.GROWING or not e.has_three_clocks:
        return 0.0
    wander_s = WHEELS_WANDER_S
    if effect.channel == "gyro":  # measured against both
        wander_s = (WHEELS_WANDER_S**-2 + REFERENCE_WANDER_S**-2) ** -0.5
    calibrated = max((sigma for _, sigma in selected.prior.values()), default=0.0) / WIDER
    return max(wander_s / float(np.ptp(e.edges_s)), calibrated)


def shrunk(
    selection: Sequence[Selected], covariance: Array, cost_nats: float, known: Collection[str] = ()
) -> tuple[Selected, ...]:
    """Shrink linear parameters towards 0 if the data permit it (empirical Bayes).

    If a drive determines a sum but not its parts, the best-fitting parts are arbitrary, and would show on another
    drive. Shrinkage is therefore decided for each eigenvector of the covariance, in units of the parameters' usual
    sizes: one that gains less than the cost of a parameter has a prior of usual size. (88)
    `covariance` (k, k): of all free parameters. Effects `known` by logic and calibrated parameters stay unchanged.
    """
    named = [(i, name) for i, selected in enumerate(selection) for name in selected.free]
    index = [
        j
        for j, (i, name) in enumerate(named)
        if selection[i].id not in known and selection[i].parameter(name).linear and name not in selection[i].prior
    ]
    if not index:
        return tuple(selection)
    usual = np.array([_usual(selection[i].parameter(name)) for i, name in (named[j] for j in index)])
    x = np.array([selection[i].number(name) for i, name in (named[j] for j in index)]) / usual
    variance, V = np.linalg.eigh(covariance[np.ix_(index, index)] / usual / usual[:, None])
    y, variance = V.T @ x, np.maximum(variance, 0.0)
    sizes = np.where(0.5 * y**2 > cost_nats * variance, np.maximum(y**2 - variance, 1.0), 1.0)
    values = [dict(selected.values) for selected in selection]
    for j, at in zip(index, usual * (V @ (y * sizes / (sizes + variance))), strict=True):
        i, name = named[j]
        values[i][name] = float(at)
    shrunken = [replace(selected, values=own) for selected, own in zip(selection, values, strict=True)]
    return tuple(d if is_plausible(d) else selected for d, selected in zip(shrunken, selection, strict=True))


def _usual(q: Parameter) -> float:
    """Usual size, SI, of a parameter, from its lowest and highest."""
    return USUAL * math.sqrt(q.low * q.high) * q.si


def _most(problem: Problem, selected: Selected) -> Array:
    """Upper limits of the deviations: for a time, that of a uniform distribution over the recording."""
    edges = problem.evidence.edges_s
    anywhere_s = float(edges[-1] - edges[0]) / 12.0**0.5
    return np.array([anywhere_s if selected.parameter(name).moment else np.inf for name in selected.free])


def _widened(problem: Problem, fit: Fit, known: Collection[str]) -> Fit:
    """Free every linear parameter of the selected effects, if the result is plausible."""
    wider = tuple(
        c if c.id in known else replace(c, free=(*c.free, *(n for n in c.effect.linear() if n not in c.free)))
        for c in fit.selection
    )
    if all(w.free == c.free for w, c in zip(wider, fit.selection, strict=True)):
        return fit
    wide = refine(problem, wider)
    return wide if all(map(is_plausible, wide.selection)) else fit


def _is_curved(selected: Selected, name: str) -> bool:
    q = selected.parameter(name)
    return not q.linear and not q.is_angle and not q.choices


def _distances(problem: Problem, fit: Fit, which: int, name: str) -> Array:
    """Rms distances of an effect's free parameters from their estimates, over the profile likelihood of one."""
    selected = fit.selection[which]
    at, sigma = selected.number(name), selected.sigma(name)
    free = tuple(n for n in selected.free if n != name)
    places, sets = [at], []
    for offset in (sigma * sign * r for r in REACHES for sign in (-1.0, 1.0)):
        moved = replace(selected, values={**selected.values, name: at + offset}, free=free)
        if sigma > 0.0 and is_plausible(moved) and _is_inside(problem, moved):
            places.append(at + offset)
            sets.append([moved if j == which else c for j, c in enumerate(fit.selection)])
    fits = [fit, *refine_all(problem, sets)]
    if len(fits) < FEWEST_PLACES:
        return np.zeros(len(selected.free))
    order = np.argsort(places)
    place = np.array(places)[order]
    nats = np.array([fits[i].cost for i in order])
    square = np.array([_squares(fits[i].selection[which], selected) for i in order])
    fine = np.linspace(place[0], place[-1], FINE)
    weight = np.exp(-np.minimum(np.interp(fine, place, nats - nats.min()), 700.0))
    weight /= weight.sum()
    mean = np.array([float(weight @ np.interp(fine, place, column)) for column in square.T])
    # Linear interpolation overestimates a parabola; the profiled parameter's own square is known exactly.
    mean[selected.free.index(name)] = float(weight @ (fine - at) ** 2)
    return np.asarray(np.sqrt(mean), float)


def _squares(fitted: Selected, selected: Selected) -> list[float]:
    """Mean square distance of each parameter from the selected effect's, including its own variance."""
    return [(fitted.number(n) - selected.number(n)) ** 2 + fitted.sigma(n) ** 2 for n in selected.free]


def _is_inside(problem: Problem, selected: Selected) -> bool:
    begin_s, end_s = problem.evidence.edges_s[[0, -1]].tolist()
    return all(begin_s < at_s < end_s for at_s in (selected.begin_s, selected.end_s) if at_s is not None)
