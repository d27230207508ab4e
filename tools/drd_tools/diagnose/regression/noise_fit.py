"""Robust estimates of the noise from the residual of the selected effects, with datasheets as priors. (77)"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd_tools.diagnose.error_model.linear import Linear, Sensitivity
from drd_tools.diagnose.observe.evidence import Evidence, Noise
from drd_tools.diagnose.regression.problem import Inflation, Problem
from drd_tools.diagnose.regression.refine import Fit
from drd_tools.diagnose.regression.residuals import (
    FEWEST_ROWS,
    HEAVY_NATS,
    colour,
    deviation,
    long_run,
    slow_deviation,
    students,
    tails,
)
from drd_tools.diagnose.results import Figures

BELIEVED: Final = 1.5  # a datasheet is right within about this factor
INFLATED_BEYOND: Final = 2.5  # sigma, of a fix
# Sizes that share one factor: the gyro's; the wheels' sideways, ahead, and against each other.
WALK: Final = ("walk_rad_per_sqrt_s",)
WAY: Final = ("lateral_m_per_sqrt_m", "forward_m_per_sqrt_m")
WHEELS: Final = (*WAY, "slip_m_per_sqrt_m")
HEADING: Final = ("heading_rad",)
# Multiples of the previous sizes, and of the headings', tried in each direction while the likelihood rises.
FACTORS: Final = (((1.0, 1.0),), ((0.55, 1.0), (0.3, 1.0)), ((1.8, 1.0), (3.3, 1.0)))
BOTH: Final = (((0.55, 1.8), (0.3, 3.3)), ((1.8, 0.55), (3.3, 0.3)))
SLIP_SPREAD: Final = 1.0  # of the slip's logarithm: a guess if robot.yaml does not state it
# A reference that repeats the same pose shows no noise, but the filter divides by it.
LEAST_M, LEAST_RAD = 1e-5, 1e-5
# Multiplied by the slip's factor. A drive that holds speeds for 0.5 s has a jitter of 0.14 s.
JITTERS_S: Final = (0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.14, 0.2)
FAR: Final = 4.0  # sigmas: innovations are clipped here


def inflated(problem: Problem, left: Array, noise: Noise) -> Inflation:
    """Variance inflation of the whitened residual (r,) of the selected effects, over its worst time scale. (78)

    `noise`: the noise of the next whitening. If the robot is as in robot.yaml, heavy tails may come from an effect:
    a delay that is not yet exact leaves some at starts and stops.
    """
    e = problem.evidence
    step_s = float(np.median(e.step_s))
    wheels, fixes = not_inflated(problem, left)
    moving = ~e.still if len(wheels) else np.zeros(0, bool)  # the gyro's noise at rest has its own size, the walk
    has_tails = e.is_far and bool(len(wheels))
    if has_tails:
        wheels = wheels * np.sqrt(problem.noise.wheels(e) / noise.wheels(e))
    slow = (long_run if has_tails else slow_deviation)(wheels[moving], step_s)
    fix_s = float(np.median(np.diff(e.fix_time_s))) if len(fixes) > 1 else 1.0
    if not has_tails:
        return Inflation(slow, _slow_fixes(fixes, fix_s))
    # The reference itself drifts at rest.
    moves = moving[e.fix_step]
    parts = (_slow_fixes(fixes[which], fix_s) for which in (moves, ~moves))
    return Inflation(slow * tails(wheels, moving), np.where(moves[:, None], *parts))


def _slow_fixes(fixes: Array, every_s: float) -> Array:
    """Inflation of x, y and heading, (3,); x and y share one."""
    x, y, heading = (slow_deviation(fixes[:, i], every_s) for i in range(3))
    return np.array([max(x, y), max(x, y), heading])


def _slip_and_jitter(problem: Problem, wheels: Array, moving: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Most likely slip factor and jitter, s, given the wheels' rows in motion. (77)"""
    e, noise = problem.evidence, problem.noise
    if not e.is_far or moving.sum() < FEWEST_ROWS:
        return deviation(wheels[moving]), noise.jitter_s
    rows, square = wheels[moving], e.speed_changes_rad2_s2[moving]
    now = noise.wheels(e)[moving]
    alone = now - noise.jitter_s**2 * square
    best, most = (1.0, 0.0), -math.inf
    for ratio in JITTERS_S:
        share = (alone + ratio**2 * square) / now
        found = students(rows / np.sqrt(share))
        nats = found.nats - 0.5 * float(np.log(share).sum()) - (HEAVY_NATS if ratio else 0.0)
        if nats > most:
            factor = deviation(rows / np.sqrt(share))
            best, most = (factor, ratio * factor), nats
    return best


def not_inflated(problem: Problem, left: Array) -> tuple[Array, Array]:
    """Whitened rows of the wheels (none without a gyro) and of the fixes (m, 3), with the inflation undone.

    Without wheels only the headings of the fixes are non-zero.
    """
    if not problem.evidence.has_wheels:
        headings = left[len(left) - len(problem.evidence.fix) :]
        return left[:0], np.outer(headings, (0.0, 0.0, float(problem.inflation.fixes[2])))
    n = len(left) - 3 * len(problem.evidence.fix)
    return left[:n] * problem.inflation.wheels, left[n:].reshape(-1, 3) * problem.inflation.fixes


def noise_beside(problem: Problem, fit: Fit) -> tuple[Noise, Array, Inflation]:
    """Noise, variance inflation of each fix and of the rows, beside the effects that a search found."""
    noise, fix_inflation = fitted(problem, fit, searched=True)
    return noise, fix_inflation, inflated(problem, fit.left, noise)


def fitted(problem: Problem, fit: Fit, searched: bool) -> tuple[Noise, Array]:
    """Noise, and variance inflation (m,) of each fix, from a fit's whitened residual.

    Few fixes are not inflated before the search for effects: a single one may be the only evidence.
    """
    e, noise = problem.evidence, problem.noise
    wheels, fixes = not_inflated(problem, fit.left)
    moving = _compared(e)
    walk, jitter_s, of_heading = e.datasheet.walk_rad_per_sqrt_s, 0.0, 1.0
    if len(wheels):
        slip, jitter_s = _slip_and_jitter(problem, wheels, moving)
        walk = _walk(problem, wheels[e.still])
    elif not e.has_wheels:
        slip = 1.0
        factor, of_heading, fixes = _most_likely(problem, fixes, _selected(problem, fit), noise, WALK)
        walk = max(noise.walk_rad_per_sqrt_s * factor, e.datasheet.walk_rad_per_sqrt_s)
    else:
        slip, of_heading, fixes = _most_likely(problem, fixes, _selected(problem, fit), noise, WHEELS)
    way = slip
    if (jitter_s or noise.jitter_s) and fixes.size < FEWEST_ROWS:
        way = _slip_in_the_long_run(problem, wheels[moving]) / noise.forward_m_per_sqrt_m
    elif jitter_s or noise.jitter_s:
        way, of_heading, fixes = _most_likely(problem, fixes, _selected(problem, fit), noise, WAY)
    inflation = np.ones(len(fixes)) if problem.fix_inflation is None else problem.fix_inflation
    fixes = fixes * np.sqrt(inflation)[:, None] * np.array([1.0, 1.0, of_heading])
    position, heading = deviation(fixes[:, :2].ravel()), deviation(fixes[:, 2])
    if searched or len(fixes) >= FEWEST_ROWS:
        inflation = _inflated_fixes(fixes / np.array([position, position, heading]))
    position_m = max(noise.position_m * position, LEAST_M)
    systematic_m2 = e.datasheet.position_m**2 - position_m**2
    return (
        replace(
            scaled(noise, way, WAY),
            slip_m_per_sqrt_m=noise.slip_m_per_sqrt_m * slip,
            walk_rad_per_sqrt_s=walk,
            position_m=position_m,
            heading_rad=max(noise.heading_rad * heading, LEAST_RAD),
            jitter_s=jitter_s,
            ahead_m=math.sqrt(systematic_m2) if systematic_m2 > position_m**2 else 0.0,
        ),
        inflation,
    )


def _compared(e: Evidence) -> npt.NDArray[np.bool_]:
    """Steps (n,) in motion in which no sensor was lost."""
    is_lost = e.left_inflation_m2 + e.right_inflation_m2 + e.gyro_inflation_rad2 > 0.0
    return ~e.still & ~is_lost


def _inflated_fixes(white: Array) -> Array:
    """Inflation (m,) of outlying fixes, given the whitened fixes (m, 3)."""
    inflation: Array = np.maximum(1.0, np.mean(white**2, axis=1) / INFLATED_BEYOND**2 * 3.0)
    return inflation


def _slip_in_the_long_run(problem: Problem, rows: Array) -> float:
    """Long-run slip of a wheel, m/sqrt(m), from its rows in motion (k,). (77)

    It stands for the slip common to both wheels, which few fixes do not determine.
    """
    step_s = float(np.median(problem.evidence.step_s))
    return problem.noise.slip_m_per_sqrt_m * _raised_by_jitter(problem) * long_run(rows, step_s)


def _walk(problem: Problem, at_rest: Array) -> float:
    """The gyro's walk from its rows at rest, over seconds (samples may be correlated); as stated if plausible."""
    stated, step_s = problem.evidence.datasheet.walk_rad_per_sqrt_s, float(np.median(problem.evidence.step_s))
    scale = deviation(at_rest)
    walk = problem.noise.walk_rad_per_sqrt_s * scale * slow_deviation(at_rest / scale, step_s, drifts=True)
    return walk if walk > BELIEVED * stated else stated


def _most_likely(
    problem: Problem, fixes: Array, known: list[Sensitivity], noise: Noise, sizes: Sequence[str]
) -> tuple[float, float, Array]:
    """Most likely factors of some noise sizes and of the fixes' headings', given the fixes' innovations without the
    `known` sensitivities, and the fixes (m, 3) whitened with them.

    Without a gyro nothing else shows how much the wheels slip. The factors are 1 if fixes are few. Headings too exact
    and wheels that slip too much explain each other, so that both are also changed at once; but not on real ground,
    where the wheels' noise stands for all that is as small as their tolerances, see `by_direction`.
    """
    if fixes.size < FEWEST_ROWS:
        return 1.0, 1.0, fixes
    sensitivities = [problem.linear.data(), *known]
    best, most = (1.0, 1.0, fixes), -math.inf
    for factors in FACTORS if problem.evidence.is_far else FACTORS + BOTH:
        for factor, of_heading in factors:
            tried = scaled(scaled(noise, factor, sizes), of_heading, HEADING)
            linear = Linear(problem.evidence, problem.path, tried, problem.fix_inflation, problem.linear)
            rows = linear.rows(sensitivities)[len(problem.evidence.step_s) :].reshape(-1, 3, len(sensitivities))
            left = rows[:, :, 0] - rows[:, :, 1:].sum(axis=2)
            nats = _nats(linear, left)
            if nats <= most:
                break
            best, most = (factor, of_heading, left), nats
    return best


def _selected(problem: Problem, fit: Fit) -> list[Sensitivity]:
    return [problem.sensitivity(c.effect, c.values) for c in fit.selection]


def by_direction(problem: Problem, fit: Fit) -> Problem:
    """The problem with, if there is no gyro, separately fitted wheel noise in each direction. (77)

    A common factor is that of the largest, which on real robots is sideways. In one drive it hides small errors of
    the constants, so that they are not mistaken for other effects. Where many drives determine what they have in
    common, each should contribute all its information.
    """
    e = problem.evidence
    if e.gyro_rad is not None or not e.has_wheels or len(e.fix) < FEWEST_ROWS:
        return problem
    # An effect and the reference's own errors may cancel: neither may be subtracted without the other.
    faults = [s * (sigma * x) for (_, sigma, s), x in zip(problem.nuisances, fit.nuisance, strict=True)]
    known, noise, fixes = [*_selected(problem, fit), *faults], problem.noise, not_inflated(problem, fit.left)[1]
    for size in WHEELS:
        factor, _, _ = _most_likely(problem, fixes, known, noise, [size])
        noise = scaled(noise, factor, [size])
    return problem.with_noise(noise, problem.fix_inflation, problem.inflation)


def score_with_noise(problem: Problem, fit: Fit) -> float:
    """Score of a fit, nats, comparable between noise sizes: from the fixes and, with a gyro, the wheels' rows under
    their most likely spectrum. (77), (78)
    """
    e = problem.evidence
    wheels, fixes = not_inflated(problem, fit.left)
    nats = _nats(problem.linear, fixes) - problem.penalty(fit.selection)
    moving = ~e.still
    if len(wheels) and moving.sum() >= FEWEST_ROWS:
        rows = np.clip(wheels[moving], -FAR, FAR)
        nats += colour(rows, float(np.median(e.step_s))).nats
        nats -= 0.5 * float(np.log(problem.noise.wheels(e)[moving]).sum())
    return nats


def _nats(linear: Linear, left: Array) -> float:
    """Log likelihood of the fixes' whitened residual (m, 3), plus the log prior of slip or walk. (77)"""
    noise, sheet = linear.noise, linear.evidence.datasheet
    ratio = noise.forward_m_per_sqrt_m / sheet.slip_m_per_sqrt_m
    if not linear.evidence.has_wheels:
        ratio = noise.walk_rad_per_sqrt_s / sheet.walk_rad_per_sqrt_s
    nats = linear.log_likelihood - 0.5 * float(np.minimum(left**2, FAR**2).sum())
    return nats - 0.5 * (math.log(ratio) / SLIP_SPREAD) ** 2


def ratios(problem: Problem) -> Figures:
    """Ratios of a problem's noise to the stated one; the wheels' includes their jitter, which is never stated."""
    noise, stated = problem.noise, problem.evidence.datasheet
    found: Figures = {"heading": noise.heading_rad / stated.heading_rad}
    found["gyro"] = noise.walk_rad_per_sqrt_s / stated.walk_rad_per_sqrt_s
    if problem.evidence.has_wheels:
        found["slip"] = noise.slip_m_per_sqrt_m / stated.slip_m_per_sqrt_m * _raised_by_jitter(problem)
        found["position"] = noise.position_m / stated.position_m
    return found


def _raised_by_jitter(problem: Problem) -> float:
    """Ratio of the deviations of the wheels' rows in motion with and without jitter."""
    noise, moving = problem.noise, _compared(problem.evidence)
    if not noise.jitter_s or not moving.any():
        return 1.0
    whole, alone = (n.wheels(problem.evidence)[moving].sum() for n in (noise, replace(noise, jitter_s=0.0)))
    return math.sqrt(whole / alone)


def scaled(noise: Noise, factor: float, sizes: Sequence[str]) -> Noise:
    """Multiply some sizes of the noise by `factor`."""
    changed: Any = {name: getattr(noise, name) * factor for name in sizes}
    return replace(noise, **changed)
