"""Order spectrum: errors that repeat with a wheel's angle at any order, such as those of a gearbox."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from drd.arrays import Array, cumulative
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import FREE, nuisance_design
from drd_tools.diagnose.selected import Selected

FEWEST_TURNS: Final = 3.0  # of a wheel: with fewer, no order can be distinguished from its own turn
LEAST_ORDER: Final = 0.2  # slower errors are smooth curves of time or place
MOST_ORDER: Final = 60.0  # a motor's shaft behind two stages of a gearbox
MOST_PERIODS: Final = 0.8  # in a typical step: of more, its mean keeps less than a quarter
OWN_ORDER: Final = 1.0  # of an eccentric wheel, an effect in the catalogue
PER_TURN: Final = 8  # grid cells in the shortest period: linear interpolation loses 5 % of its power
OVERSAMPLED: Final = 4  # frequencies per resolution width: a peak between two loses at most 5 % of its power
BACKGROUND: Final = 101  # widths: determines the median to a sixth
MOST_SPREAD: Final = 64  # bins of the steps' sizes in the norm: finer changes it by less than a percent
MOST_RIPPLES: Final = 3  # a stage of a gearbox has one
KNOTS: Final = 12  # per period, for the picture: harmonics up to the sixth
SUB: Final = 8  # parts of a step, over which a hat is averaged: a typical step has at most MOST_PERIODS
RIDGE: Final = 1e-6  # of the hats' largest product: keeps phases that no step shows near 0


@dataclass(frozen=True)
class Ripple:
    """A wheel's relative error `amplitude cos(order angle + phase)`, with sigmas.

    `gain`: nats, less its cost. `p`: probability of such a peak by chance, at any order of either wheel.
    """

    side: str
    order: float
    sigma_order: float
    amplitude: float
    sigma: float
    phase: float
    gain: float
    p: float
    folded: "Folded"


class Folded(NamedTuple):
    """The relative error about its mean, and its sigma, at phases of a period, (k,) each, for any waveform."""

    phase_rad: Array
    error: Array
    sigma: Array


class _Peak(NamedTuple):
    """The highest peak of a spectrum, over its background's mean; `tried`: number of orders in the spectrum."""

    above: float
    side: str
    order: float
    tried: float


def ripples(problem: Problem, selection: Sequence[Selected], least_nats: float, most_p: float) -> list[Ripple]:
    """Significant orders beside the selected effects, strongest first, except a wheel's own turn. (90)"""
    found: list[Ripple] = []
    if not problem.evidence.has_wheels:
        return found
    residual, columns = problem.data - problem.effect_rows(selection), nuisance_design(problem, selection)
    for _ in range(MOST_RIPPLES):
        held = Marginal(columns)
        left = held.projected(residual)
        peaks = _peaks(problem, left)
        if not peaks:
            break
        tried, peak = sum(p.tried for p in peaks), max(peaks)
        S = _waves(problem, peak.side, peak.order)
        p = min(1.0, tried * math.exp(-peak.above))
        ripple = _measured(problem, held, left, S, peak, p, math.log(tried), least_nats) if p <= most_p else None
        if ripple is None:
            break
        angle = _angle(problem, peak.side)
        if abs(peak.order - OWN_ORDER) * np.ptp(angle) > 2.0 * math.pi:
            found.append(ripple)
        columns = np.column_stack([columns, FREE * S / np.linalg.norm(S, axis=0)])
    return found


def _angle(problem: Problem, side: str) -> Array:
    """Angle of a wheel at the steps' edges, (n + 1,)."""
    e = problem.evidence
    return cumulative(e.left_m if side == "left" else e.right_m) / e.radius_m


def _waves(problem: Problem, side: str, order: float) -> Array:
    """Whitened sensitivities to the two phases of a ripple, (r, 2), integrated over each step."""
    at = order * _angle(problem, side)
    ways = [np.diff(f) * (problem.evidence.radius_m / order) for f in (np.sin(at), -np.cos(at))]
    return problem.whiten([_of(side, way) for way in ways])


def _of(side: str, distance_m: Array) -> Sensitivity:
    return Sensitivity(left_m=distance_m) if side == "left" else Sensitivity(right_m=distance_m)


def _peaks(problem: Problem, left: Array) -> list[_Peak]:
    """The highest peak of each wheel in projected data (r,)."""
    score, found = problem.adjoint(left), []
    for side, of_step in (("left", score[:, 1]), ("right", score[:, 2])):
        angle, weight = _angle(problem, side), -np.diff(of_step, prepend=0.0, append=0.0)
        width = 2.0 * math.pi / max(float(np.ptp(angle)), 1e-9)
        if 1.0 / width < FEWEST_TURNS:
            continue
        orders, above = _spectrum(angle, weight)
        if len(orders):
            best = int(np.argmax(above))
            near = orders[best] + np.linspace(-0.5, 0.5, 41) * width
            power = np.abs(np.exp(1j * np.outer(near, angle)) @ weight)
            order = float(near[np.argmax(power)])
            found.append(_Peak(float(above[best]), side, order, len(orders) / OVERSAMPLED))
    return found


def _spectrum(angle: Array, weight: Array) -> tuple[Array, Array]:
    """Orders (k,) and their power over the background's mean (k,), from weights at angles (n + 1,)."""
    step = np.abs(np.diff(angle))
    most = min(MOST_ORDER, 2.0 * math.pi * MOST_PERIODS / float(np.average(step, weights=step)))
    size = 2.0 * math.pi / (PER_TURN * most)
    count = 2 ** math.ceil(math.log2(OVERSAMPLED * float(np.ptp(angle)) / size))
    place = (angle - angle.min()) / size
    cell = place.astype(int)
    share = place - cell
    grid = np.bincount(cell, weight * (1.0 - share), count) + np.bincount(cell + 1, weight * share, count)
    orders = np.arange(count // 2 + 1) * (2.0 * math.pi / (count * size))
    seen = (orders >= LEAST_ORDER) & (orders <= most)
    orders, power = orders[seen], np.abs(np.fft.rfft(grid)[seen]) ** 2
    # Sensitivity of the steps to a unit of each order: small if steps contain whole periods.
    number, edges = np.histogram(step, MOST_SPREAD)
    norm = (2.0 - 2.0 * np.cos(np.outer(orders, 0.5 * (edges[1:] + edges[:-1])))) @ number
    power = np.divide(power, norm, out=np.zeros_like(power), where=norm > 0.0)
    background = median_filter(power, BACKGROUND * OVERSAMPLED, mode="reflect") / math.log(2.0)  # of an exponential
    return orders, np.divide(power, background, out=np.zeros_like(power), where=background > 0.0)


def _measured(
    problem: Problem, held: Marginal, left: Array, S: Array, peak: _Peak, p: float, cost: float, least_nats: float
) -> Ripple | None:
    """Amplitude, phase and gain of a peak with whitened sensitivities S (r, 2); None if it gains too little.

    `cost`: of the choice among all orders, nats.
    """
    G, b = held.beside(S.T @ S, held.columns.T @ S), S.T @ left
    if not np.linalg.det(G) > 0.0:
        return None
    covariance = np.linalg.inv(G)
    x = covariance @ b
    amplitude = float(np.hypot(*x))
    sigma = float(np.sqrt(x @ covariance @ x)) / amplitude
    gain = 0.5 * float(b @ x) - cost - 2.0 * problem.per_parameter
    if gain < least_nats:
        return None
    # The sigma of a line's frequency is sqrt(12) / span times that of its phase (Rife and Boorstyn 1974).
    sigma_order = math.sqrt(12.0) * sigma / amplitude / float(np.ptp(_angle(problem, peak.side)))
    phase, folded = math.atan2(-x[1], x[0]), _folded(problem, held, left, peak)
    return Ripple(peak.side, peak.order, sigma_order, amplitude, sigma, phase, gain, p, folded)


def _folded(problem: Problem, held: Marginal, left: Array, peak: _Peak) -> Folded:
    """The error at each phase of a period, from a regression on hats."""
    angle, knots = _angle(problem, peak.side), np.linspace(0.0, 2.0 * math.pi, KNOTS + 1)
    within = (np.arange(SUB) + 0.5) / SUB
    at = np.mod(peak.order * (angle[:-1, None] + np.diff(angle)[:, None] * within), 2.0 * math.pi)
    hats = np.eye(KNOTS)[:, [*range(KNOTS), 0]]  # a ring
    travel_m = problem.evidence.radius_m * np.diff(angle)
    S = problem.whiten([_of(peak.side, travel_m * np.interp(at, knots, hat).mean(axis=1)) for hat in hats])
    G = held.beside(S.T @ S, held.columns.T @ S)
    about_mean = np.eye(KNOTS) - 1.0 / KNOTS  # the mean is the wheel's radius
    covariance = about_mean @ np.linalg.inv(G + RIDGE * np.diag(G).max() * np.eye(KNOTS)) @ about_mean
    return Folded(knots[:-1], covariance @ (S.T @ left), np.sqrt(np.diag(covariance)))
