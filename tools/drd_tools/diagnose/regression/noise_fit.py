"""Sizes of the noise: data sheets are the priors, the selected effects' residual corrects them, robustly. (77)"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln, ndtri, stdtrit

from drd_tools.diagnose.error_model.linear import Linear, Sensitivity
from drd_tools.diagnose.observe.evidence import Noise
from drd_tools.diagnose.regression.problem import Inflation, Problem
from drd_tools.diagnose.regression.refine import Fit
from drd_tools.diagnose.results import Array, Figures

DEVIATION_PER_MAD: Final = 1.4826  # of a Gaussian
FEWEST_ROWS: Final = 50  # a deviation of fewer is known to 12 % or worse
# A data sheet is believed to within a factor of about this; so many rows weigh as much.
BELIEVED: Final = 1.5
ROWS_PER_PRIOR: Final = 30
SPANS_S: Final = (0.5, 2.0, 5.0, 10.0)  # of real slip and real references, which hang together over seconds
FEWEST_BLOCKS: Final = 20  # a deviation of fewer blocks is mostly scatter
TOGETHER_S: Final = (0.3, 0.5, 1.0, 2.0, 4.0)  # of slip: from a row or two to the longest of the spans
SHARES: Final = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)  # of the variance
LEAST_COLOUR: Final = 1.15  # less is taken for the scatter of the estimate
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
# Degrees of freedom of the wheels' tails: from what real skid steer shows (3 to 4) to what is hardly a tail.
FREEDOMS: Final = (2.5, 3.0, 4.0, 6.0, 10.0)
HEAVY_NATS: Final = 50.0  # that tails must gain: simulated noise, which has none, gains less than 5
# Times the slip's factor: of speeds that a drive holds for 0.5 s the jitter is 0.14 s.
JITTERS_S: Final = (0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.14, 0.2)
LEAST_MEDIAN: Final = 1e-9  # rows without noise
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
    slow = (long_run if has_tails else _slow)(wheels[moving], step_s)
    fix_s = float(np.median(np.diff(e.fix_time_s))) if len(fixes) > 1 else 1.0
    if not has_tails:
        return Inflation(slow, _slow_fixes(fixes, fix_s))
    # At rest a reference drifts by itself.
    moves = moving[e.fix_step]
    parts = (_slow_fixes(fixes[which], fix_s) for which in (moves, ~moves))
    return Inflation(slow * tails(wheels, moving), np.where(moves[:, None], *parts))


def _slow_fixes(fixes: Array, every_s: float) -> Array:
    """Inflation of x and y, which are one, and of heading, (3,)."""
    x, y, heading = (_slow(fixes[:, i], every_s) for i in range(3))
    return np.array([max(x, y), max(x, y), heading])


class _Students(NamedTuple):
    """Student's t that rows (k,) are likeliest from, a Gaussian of nu = inf among them."""

    nu: float
    scale: float
    nats: float


def _students(rows: Array) -> _Students:
    median = max(float(np.median(np.abs(rows))), LEAST_MEDIAN)
    squares, found = rows**2, []
    for nu in FREEDOMS:
        scale = median / float(stdtrit(nu, 0.75))
        each = float(gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu)) - math.log(scale * math.sqrt(math.pi * nu))
        nats = len(rows) * each - 0.5 * (nu + 1.0) * float(np.log1p(squares / (nu * scale**2)).sum())
        found.append(_Students(nu, scale, nats))
    scale = median / float(ndtri(0.75))
    nats = -len(rows) * math.log(scale * math.sqrt(2.0 * math.pi)) - 0.5 * float(squares.sum()) / scale**2
    found.append(_Students(math.inf, scale, nats + HEAVY_NATS))
    return max(found, key=lambda one: one.nats)


def tails(rows: Array, moving: npt.NDArray[np.bool_]) -> float | Array:
    """Inflation of each row by Student's t: root of 1 + u^2/nu, 1 at rest; 1 where a Gaussian does as well. (78)"""
    seen = rows[moving]
    found = _students(seen) if len(seen) >= FEWEST_ROWS else None
    if found is None or math.isinf(found.nu):
        return 1.0
    return np.where(moving, np.sqrt(1.0 + (rows / found.scale) ** 2 / found.nu), 1.0)


def _slip_and_jitter(problem: Problem, wheels: Array, moving: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Factor of the slip, and the jitter, s, with which the wheels' rows in motion are likeliest. (77)"""
    e, noise = problem.evidence, problem.noise
    if not e.is_far or moving.sum() < FEWEST_ROWS:
        return _scale(wheels[moving]), noise.jitter_s
    rows, square = wheels[moving], e.speed_changes_rad2_s2[moving]
    now = noise.wheels(e)[moving]
    alone = now - noise.jitter_s**2 * square
    best, most = (1.0, 0.0), -math.inf
    for ratio in JITTERS_S:
        share = (alone + ratio**2 * square) / now
        found = _students(rows / np.sqrt(share))
        nats = found.nats - 0.5 * float(np.log(share).sum()) - (HEAVY_NATS if ratio else 0.0)
        if nats > most:
            factor = _scale(rows / np.sqrt(share))
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


def _slow(rows: Array, every_s: float, drifts: bool = False) -> float:
    """Deviation of means over some seconds, times the root of their rows: 1 where the rows are white.

    `drifts`: of each mean from the one before, which is the Allan deviation: what changes over minutes is no noise.
    """
    worst = 1.0
    for span_s in SPANS_S:
        m = max(1, round(span_s / every_s))
        count = len(rows) // m
        if m < 2 or count < FEWEST_BLOCKS:
            continue
        means = rows[: count * m].reshape(count, m).sum(axis=1) / m**0.5
        if drifts:
            means = np.diff(means) / 2.0**0.5
        found = DEVIATION_PER_MAD * float(np.median(np.abs(means - np.median(means))))
        # The scatter of such an estimate must not pass for colour.
        worst = max(worst, found / (1.0 + 2.5 * 1.17 / (2.0 * count) ** 0.5))
    return worst if worst > LEAST_COLOUR else 1.0


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
    position, heading = _scale(fixes[:, :2].ravel()), _scale(fixes[:, 2])
    white = fixes / np.array([position, position, heading])
    inflation = np.maximum(1.0, np.mean(white**2, axis=1) / INFLATED_BEYOND**2 * 3.0)
    if not searched and len(fixes) < FEWEST_ROWS:
        inflation = np.ones(len(inflation))
    position_m = max(noise.position_m * position, LEAST_M)
    systematic_m2 = e.datasheet.position_m**2 - position_m**2
    before = problem.fix_inflation if problem.fix_inflation is not None else np.ones(len(inflation))
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
        np.maximum(inflation * before, 1.0),
    )


def _slip_in_the_long_run(problem: Problem, rows: Array) -> float:
    """The slip of a wheel over many seconds, m/sqrt(m), as its rows in motion (k,) have it. (77)

    What wheels slip against each other they slip together: few fixes do not tell by themselves how much that is.
    """
    step_s = float(np.median(problem.evidence.step_s))
    return problem.noise.slip_m_per_sqrt_m * _raised_by_jitter(problem) * long_run(rows, step_s)


def _walk(problem: Problem, at_rest: Array) -> float:
    """The gyro's walk by its rows at rest, over seconds: its samples may hang together. As stated, if it may be."""
    stated, step_s = problem.evidence.datasheet.walk_rad_per_sqrt_s, float(np.median(problem.evidence.step_s))
    scale = _scale(at_rest)
    walk = problem.noise.walk_rad_per_sqrt_s * scale * _slow(at_rest / scale, step_s, drifts=True)
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
        nats += _colour(rows, float(np.median(e.step_s))).nats
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


class _Colour(NamedTuple):
    """Long-run deviation of rows, as their likeliest spectrum has it, and its log likelihood but for a constant."""

    long_run: float
    nats: float


def long_run(rows: Array, every_s: float) -> float:
    """Long-run deviation of rows over their own, as white noise and one that hangs together for some time. (78)"""
    return max(_colour(rows, every_s).long_run, 1.0) if len(rows) >= FEWEST_ROWS else 1.0


def _colour(rows: Array, every_s: float) -> _Colour:
    """The likeliest spectrum (Whittle 1953): all rows tell it, where blocks of seconds are few."""
    power = np.abs(np.fft.rfft(rows - rows.mean())[1:]) ** 2 / len(rows)
    if not power.any():  # rows that are all the same, as of a sensor that says nothing
        return _Colour(1.0, 0.0)
    found = _Colour(1.0, -math.inf)
    omega = np.pi * np.arange(1, len(power) + 1) / (0.5 * len(rows))
    for together_s in (0.0, *TOGETHER_S):
        phi = math.exp(-every_s / together_s) if together_s else 0.0
        spectrum = (1.0 - phi**2) / np.abs(1.0 - phi * np.exp(-1j * omega)) ** 2
        for share in SHARES if together_s else (0.0,):
            S = 1.0 - share + share * spectrum
            level = float(np.mean(power / S))
            nats = -float(np.log(S).sum()) - len(S) * math.log(level) - (math.log(len(rows)) if share else 0.0)
            if nats > found.nats:
                found = _Colour(math.sqrt((1.0 - share + share * (1.0 + phi) / (1.0 - phi)) * level), nats)
    return found


def _scale(rows: Array) -> float:
    """Robust deviation of rows that should have 1, shrunk towards 1 where they are few."""
    if len(rows) < FEWEST_ROWS:
        return 1.0
    found = DEVIATION_PER_MAD * float(np.median(np.abs(rows - np.median(rows))))
    weight = len(rows) / (len(rows) + ROWS_PER_PRIOR)
    return float(np.exp(weight * np.log(max(found, 0.05))))
