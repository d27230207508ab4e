"""Sizes of the noise: data sheets are the priors, the selected effects' residual corrects them, robustly. (77)"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from drd_tools.diagnose.error_model.linear import Linear, Sensitivity
from drd_tools.diagnose.observe.evidence import Noise
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
from drd_tools.diagnose.results import Array, Figures

BELIEVED: Final = 1.5  # a data sheet is, to within a factor of about this
INFLATED_BEYOND: Final = 2.5  # sigma, of a fix
# Sizes that have one factor: of the gyro; of the wheels, sideways, ahead, and against each other.
WALK: Final = ("walk_rad_per_sqrt_s",)
WAY: Final = ("lateral_m_per_sqrt_m", "forward_m_per_sqrt_m")
WHEELS: Final = (*WAY, "slip_m_per_sqrt_m")
# Times what it was, then down and up from there while that is likelier; the rounds go further.
FACTORS: Final = ((1.0,), (0.55, 0.3), (1.8, 3.3))
SLIP_SPREAD: Final = 1.0  # of the slip's logarithm: where robot.yaml does not say, it is a guess
# A reference that repeats itself has no noise at all; a filter has to divide by it.
LEAST_M, LEAST_RAD = 1e-5, 1e-5
# Times the slip's factor: of speeds that a drive holds for 0.5 s the jitter is 0.14 s.
JITTERS_S: Final = (0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.14, 0.2)
FAR: Final = 4.0  # sigmas: innovations beyond count as if they were there


def inflated(problem: Problem, left: Array, noise: Noise) -> Inflation:
    """Variance inflation, at its worst scale, of what selected effects leave (r,) of the whitened data. (78)

    `noise`: what it will be whitened with. Heavy tails of a robot that is as robot.yaml has it may be an effect's:
    where it starts and stops, a delay that is not yet found exactly leaves some.
    """
    e = problem.evidence
    step_s = float(np.median(e.step_s))
    wheels, fixes = not_inflated(problem, left)
    moving = ~e.still if len(wheels) else np.zeros(0, bool)  # what a gyro does at rest is its own walk's size
    has_tails = e.is_far and bool(len(wheels))
    if has_tails:
        wheels = wheels * np.sqrt(problem.noise.wheels(e) / noise.wheels(e))
    slow = (long_run if has_tails else slow_deviation)(wheels[moving], step_s)
    fix_s = float(np.median(np.diff(e.fix_time_s))) if len(fixes) > 1 else 1.0
    if not has_tails:
        return Inflation(slow, _slow_fixes(fixes, fix_s))
    # At rest a reference drifts by itself.
    moves = moving[e.fix_step]
    parts = (_slow_fixes(fixes[which], fix_s) for which in (moves, ~moves))
    return Inflation(slow * tails(wheels, moving), np.where(moves[:, None], *parts))


def _slow_fixes(fixes: Array, every_s: float) -> Array:
    """Inflation of x and y, which are one, and of heading, (3,)."""
    x, y, heading = (slow_deviation(fixes[:, i], every_s) for i in range(3))
    return np.array([max(x, y), max(x, y), heading])


def _slip_and_jitter(problem: Problem, wheels: Array, moving: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Factor of the slip, and the jitter, s, with which the wheels' rows in motion are likeliest. (77)"""
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
    """Rows of the wheels, none without a gyro, and of the fixes (m, 3), as the filter alone whitens them.

    Without wheels only the fixes' headings are there.
    """
    if not problem.evidence.has_wheels:
        headings = left[len(left) - len(problem.evidence.fix) :]
        return left[:0], np.outer(headings, (0.0, 0.0, float(problem.inflation.fixes[2])))
    n = len(left) - 3 * len(problem.evidence.fix)
    return left[:n] * problem.inflation.wheels, left[n:].reshape(-1, 3) * problem.inflation.fixes


def fitted(problem: Problem, fit: Fit, searched: bool) -> tuple[Noise, Array]:
    """Noise, and variance inflation (m,) of each fix, from what a fit leaves of the whitened data.

    Of few fixes none is inflated before the search for effects: one by itself may be all that tells of them.
    """
    e, noise = problem.evidence, problem.noise
    wheels, fixes = not_inflated(problem, fit.left)
    moving = ~e.still & (e.left_inflation_m2 + e.right_inflation_m2 + e.gyro_inflation_rad2 == 0.0)
    walk, jitter_s = e.datasheet.walk_rad_per_sqrt_s, 0.0
    if len(wheels):
        slip, jitter_s = _slip_and_jitter(problem, wheels, moving)
        walk = _walk(problem, wheels[e.still])
    elif not e.has_wheels:
        slip = 1.0
        factor, fixes = _most_likely(problem, fixes, _selected(problem, fit), noise, WALK)
        walk = max(noise.walk_rad_per_sqrt_s * factor, e.datasheet.walk_rad_per_sqrt_s)
    else:
        slip, fixes = _most_likely(problem, fixes, _selected(problem, fit), noise, WHEELS)
    way = slip
    if (jitter_s or noise.jitter_s) and fixes.size < FEWEST_ROWS:
        way = _slip_in_the_long_run(problem, wheels[moving]) / noise.forward_m_per_sqrt_m
    elif jitter_s or noise.jitter_s:
        way, fixes = _most_likely(problem, fixes, _selected(problem, fit), noise, WAY)
    position, heading = deviation(fixes[:, :2].ravel()), deviation(fixes[:, 2])
    inflation = np.ones(len(fixes)) if problem.fix_inflation is None else problem.fix_inflation
    if searched or len(fixes) >= FEWEST_ROWS:
        inflation = _inflated_fixes(fixes / np.array([position, position, heading]), inflation)
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


def _inflated_fixes(white: Array, before: Array) -> Array:
    """Inflation (m,) of fixes that are far off, (m, 3), and have been inflated `before`."""
    inflation: Array = np.maximum(1.0, np.mean(white**2, axis=1) / INFLATED_BEYOND**2 * 3.0) * before
    return inflation


def _slip_in_the_long_run(problem: Problem, rows: Array) -> float:
    """The slip of a wheel over many seconds, m/sqrt(m), as its rows in motion (k,) have it. (77)

    What wheels slip against each other they slip together: few fixes do not tell by themselves how much that is.
    """
    step_s = float(np.median(problem.evidence.step_s))
    return problem.noise.slip_m_per_sqrt_m * _raised_by_jitter(problem) * long_run(rows, step_s)


def _walk(problem: Problem, at_rest: Array) -> float:
    """The gyro's walk by its rows at rest, over seconds: its samples may hang together. As stated, if it may be."""
    stated, step_s = problem.evidence.datasheet.walk_rad_per_sqrt_s, float(np.median(problem.evidence.step_s))
    scale = deviation(at_rest)
    walk = problem.noise.walk_rad_per_sqrt_s * scale * slow_deviation(at_rest / scale, step_s, drifts=True)
    return walk if walk > BELIEVED * stated else stated


def _most_likely(
    problem: Problem, fixes: Array, known: list[Sensitivity], noise: Noise, sizes: Sequence[str]
) -> tuple[float, Array]:
    """Factor of some sizes of the noise with which the fixes' innovations are most likely, what is `known` taken off,
    and the whitened fixes (m, 3) with it.

    Without a gyro nothing else tells how much the wheels slip; with few fixes it stays.
    """
    if fixes.size < FEWEST_ROWS:
        return 1.0, fixes
    sensitivities = [problem.linear.data(), *known]
    best, most = (1.0, fixes), -math.inf
    for factors in FACTORS:
        for factor in factors:
            tried = scaled(noise, factor, sizes)
            linear = Linear(problem.evidence, problem.path, tried, problem.fix_inflation, problem.linear)
            rows = linear.rows(sensitivities)[len(problem.evidence.step_s) :].reshape(-1, 3, len(sensitivities))
            left = rows[:, :, 0] - rows[:, :, 1:].sum(axis=2)
            nats = _nats(linear, left)
            if nats <= most:
                break
            best, most = (factor, left), nats
    return best


def _selected(problem: Problem, fit: Fit) -> list[Sensitivity]:
    return [problem.sensitivity(c.effect, c.values) for c in fit.selection]


def by_direction(problem: Problem, fit: Fit) -> Problem:
    """The problem, without a gyro with the wheels' noise of each direction as it is likeliest by itself. (77)

    One factor for all is as large as the largest, that sideways of real robots: with it hardly any constant of theirs
    is seen in one drive, and nothing that it hides is taken for another effect. Where many drives tell of what they
    have in common, each should tell all that it can.
    """
    e = problem.evidence
    if e.gyro_rad is not None or not e.has_wheels or len(e.fix) < FEWEST_ROWS:
        return problem
    # Where an effect and the reference's own faults cancel, neither may be taken off without the other.
    faults = [s * (sigma * x) for (_, sigma, s), x in zip(problem.nuisances, fit.nuisance, strict=True)]
    known, noise, fixes = [*_selected(problem, fit), *faults], problem.noise, not_inflated(problem, fit.left)[1]
    for size in WHEELS:
        factor, _ = _most_likely(problem, fixes, known, noise, [size])
        noise = scaled(noise, factor, [size])
    return problem.with_noise(noise, problem.fix_inflation, problem.inflation)


def score_with_noise(problem: Problem, fit: Fit) -> float:
    """Score of a fit, nats, that is comparable between noises: the fixes' and, with a gyro, that of the wheels' rows,
    whatever their colour. (77), (78)
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
    """Log likelihood of what is left of the whitened fixes (m, 3), and of slip or walk before any data. (77)"""
    noise, sheet = linear.noise, linear.evidence.datasheet
    ratio = noise.forward_m_per_sqrt_m / sheet.slip_m_per_sqrt_m
    if not linear.evidence.has_wheels:
        ratio = noise.walk_rad_per_sqrt_s / sheet.walk_rad_per_sqrt_s
    nats = linear.log_likelihood - 0.5 * float(np.minimum(left**2, FAR**2).sum())
    return nats - 0.5 * (math.log(ratio) / SLIP_SPREAD) ** 2


def ratios(problem: Problem) -> Figures:
    """Ratios of a problem's noise to what is stated; of the wheels' with their jitter, which nobody states."""
    noise, stated = problem.noise, problem.evidence.datasheet
    found: Figures = {"heading": noise.heading_rad / stated.heading_rad}
    found["gyro"] = noise.walk_rad_per_sqrt_s / stated.walk_rad_per_sqrt_s
    if problem.evidence.has_wheels:
        found["slip"] = noise.slip_m_per_sqrt_m / stated.slip_m_per_sqrt_m * _raised_by_jitter(problem)
        found["position"] = noise.position_m / stated.position_m
    return found


def _raised_by_jitter(problem: Problem) -> float:
    """Deviation of the wheels' rows in motion over that without jitter."""
    noise, moving = problem.noise, ~problem.evidence.still
    if not noise.jitter_s:
        return 1.0
    whole, alone = (n.wheels(problem.evidence)[moving].sum() for n in (noise, replace(noise, jitter_s=0.0)))
    return math.sqrt(whole / alone)


def scaled(noise: Noise, factor: float, sizes: Sequence[str]) -> Noise:
    """Noise with `factor` times some of its sizes."""
    changed: Any = {name: getattr(noise, name) * factor for name in sizes}
    return replace(noise, **changed)
