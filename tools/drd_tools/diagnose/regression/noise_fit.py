"""Sizes of the noise: data sheets are the priors, the selected effects' residual corrects them, robustly. (77)"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.stats import norm
from scipy.stats import t as student

from drd_tools.diagnose.error_model.linear import Linear
from drd_tools.diagnose.observe.evidence import Noise
from drd_tools.diagnose.regression.problem import Inflation, Problem
from drd_tools.diagnose.regression.refine import Fit
from drd_tools.diagnose.results import Array, Figures
from drd_tools.diagnose.selected import Selected

DEVIATION_PER_MAD: Final = 1.4826  # of a Gaussian
FEWEST_ROWS: Final = 50  # a deviation of fewer is known to 12 % or worse
# A data sheet is believed to within a factor of about this; so many rows weigh as much.
BELIEVED: Final = 1.5
ROWS_PER_PRIOR: Final = 30
SPANS_S: Final = (0.5, 2.0, 5.0, 10.0)  # of real slip and real references, which hang together over seconds
FEWEST_BLOCKS: Final = 20  # a deviation of fewer blocks is mostly scatter
LEAST_COLOUR: Final = 1.15  # less is taken for the scatter of the estimate
INFLATED_BEYOND: Final = 2.5  # sigma, of a fix
SLIPS: Final = (0.3, 0.55, 1.0, 1.8, 3.3)  # times what it was; the rounds go further
SLIP_SPREAD: Final = 1.0  # of the slip's logarithm: where robot.yaml does not say, it is a guess
# A reference that repeats itself has no noise at all; a filter has to divide by it.
LEAST_M, LEAST_RAD = 1e-5, 1e-5
# Degrees of freedom of the wheels' tails: from what real skid steer shows (3 to 4) to what is hardly a tail.
FREEDOMS: Final = (2.5, 3.0, 4.0, 6.0, 10.0)
HEAVY_NATS: Final = 50.0  # that tails must gain: simulated noise, which has none, gains less than 5
LEAST_MEDIAN: Final = 1e-9  # rows without noise
FAR: Final = 4.0  # sigmas: innovations beyond count as if they were there


def inflated(problem: Problem, left: Array, searched: bool) -> Inflation:
    """Variance inflation, at its worst scale, of what selected effects leave (r,) of the whitened data. (78)

    Before the search for effects, heavy tails may be an effect's, and so may those of a robot that is as robot.yaml
    has it: where it starts and stops, a delay that is not yet found exactly leaves some.
    """
    e = problem.evidence
    step_s = float(np.median(e.step_s))
    wheels, fixes = not_inflated(problem, left)
    moving = ~e.still if len(wheels) else np.zeros(0, bool)  # what a gyro does at rest is its own walk's size
    slow = _slow(wheels[moving], step_s)
    fix_s = float(np.median(np.diff(e.fix_time_s))) if len(fixes) > 1 else 1.0
    sizes = [_slow(fixes[:, i], fix_s) for i in range(3)]
    both = max(sizes[:2])
    has_tails = searched and e.is_far
    return Inflation(slow * tails(wheels, moving) if has_tails else slow, (both, both, sizes[2]))


def tails(rows: Array, moving: npt.NDArray[np.bool_]) -> float | Array:
    """Inflation of each row by Student's t: root of 1 + u^2/nu, 1 at rest; 1 where a Gaussian does as well. (78)"""
    seen = rows[moving]
    if len(seen) < FEWEST_ROWS:
        return 1.0
    median = max(float(np.median(np.abs(seen))), LEAST_MEDIAN)
    scales = {nu: median / float(student.ppf(0.75, nu)) for nu in FREEDOMS}
    nats = {nu: float(student.logpdf(seen, nu, scale=scale).sum()) for nu, scale in scales.items()}
    gaussian = float(norm.logpdf(seen, scale=median / float(norm.ppf(0.75))).sum())
    nu = max(nats, key=nats.__getitem__)
    if nats[nu] < gaussian + HEAVY_NATS:
        return 1.0
    return np.where(moving, np.sqrt(1.0 + (rows / scales[nu]) ** 2 / nu), 1.0)


def not_inflated(problem: Problem, left: Array) -> tuple[Array, Array]:
    """Rows of the wheels, none without a gyro, and of the fixes (m, 3), as the filter alone whitens them.

    Without wheels only the fixes' headings are there.
    """
    if not problem.evidence.has_wheels:
        headings = left[len(left) - len(problem.evidence.fix) :]
        return left[:0], np.outer(headings, (0.0, 0.0, problem.inflation.fixes[2]))
    n = len(left) - 3 * len(problem.evidence.fix)
    return left[:n] * problem.inflation.wheels, left[n:].reshape(-1, 3) * np.array(problem.inflation.fixes)


def _slow(rows: Array, every_s: float) -> float:
    """Deviation of means over some seconds, times the root of their rows: 1 where the rows are white."""
    worst = 1.0
    for span_s in SPANS_S:
        m = max(1, round(span_s / every_s))
        count = len(rows) // m
        if m < 2 or count < FEWEST_BLOCKS:
            continue
        means = rows[: count * m].reshape(count, m).sum(axis=1) / m**0.5
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
    walk = stated = e.datasheet.walk_rad_per_sqrt_s
    if len(wheels):
        slip = _scale(wheels[moving])
        # A gyro's samples may hang together: its walk is what it does over seconds.
        at_rest, step_s = wheels[e.still], float(np.median(e.step_s))
        at_rest_scale = _scale(at_rest)
        walk = noise.walk_rad_per_sqrt_s * at_rest_scale * _slow(at_rest / at_rest_scale, step_s)
    else:
        slip, fixes = _most_likely_slip(problem, fit.selection, fixes)
    position, heading = _scale(fixes[:, :2].ravel()), _scale(fixes[:, 2])
    scaled = fixes / np.array([position, position, heading])
    inflation = np.maximum(1.0, np.mean(scaled**2, axis=1) / INFLATED_BEYOND**2 * 3.0)
    if not searched and len(fixes) < FEWEST_ROWS:
        inflation = np.ones(len(inflation))
    before = problem.fix_inflation if problem.fix_inflation is not None else np.ones(len(inflation))
    return (
        replace(
            slipping(noise, slip),
            walk_rad_per_sqrt_s=walk if walk > BELIEVED * stated else stated,
            position_m=max(noise.position_m * position, LEAST_M),
            heading_rad=max(noise.heading_rad * heading, LEAST_RAD),
        ),
        np.maximum(inflation * before, 1.0),
    )


def _most_likely_slip(problem: Problem, selection: Sequence[Selected], fixes: Array) -> tuple[float, Array]:
    """Factor of the slip with which the fixes' innovations are most likely, and the whitened fixes (m, 3) with it.

    Without a gyro nothing else tells how much the wheels slip; with few fixes, or without wheels, it stays.
    """
    if not problem.evidence.has_wheels or len(fixes) < FEWEST_ROWS:
        return 1.0, fixes
    sensitivities = [problem.linear.data(), *(problem.sensitivity(c.effect, c.values) for c in selection)]
    best, most = (1.0, fixes), -math.inf
    for factor in SLIPS:
        linear = Linear(problem.evidence, problem.path, slipping(problem.noise, factor), problem.fix_inflation)
        rows = linear.whiten(sensitivities)[1]
        left = rows[:, :, 0] - rows[:, :, 1:].sum(axis=2)
        nats = linear.log_likelihood - 0.5 * float(np.minimum(left**2, FAR**2).sum())
        ratio = factor * problem.noise.slip_m_per_sqrt_m / problem.evidence.datasheet.slip_m_per_sqrt_m
        nats -= 0.5 * (math.log(ratio) / SLIP_SPREAD) ** 2
        if nats > most:
            best, most = (factor, left), nats
    return best


def ratios(problem: Problem) -> Figures:
    """Ratios of a problem's noise to what is stated."""
    noise, stated = problem.noise, problem.evidence.datasheet
    found: Figures = {"heading": noise.heading_rad / stated.heading_rad}
    if problem.evidence.has_wheels:
        found["gyro"] = noise.walk_rad_per_sqrt_s / stated.walk_rad_per_sqrt_s
        found["slip"] = noise.slip_m_per_sqrt_m / stated.slip_m_per_sqrt_m
        found["position"] = noise.position_m / stated.position_m
    return found


def slipping(noise: Noise, factor: float) -> Noise:
    """Noise with `factor` times the slip."""
    return replace(
        noise,
        slip_m_per_sqrt_m=noise.slip_m_per_sqrt_m * factor,
        lateral_m_per_sqrt_m=noise.lateral_m_per_sqrt_m * factor,
    )


def _scale(rows: Array) -> float:
    """Robust deviation of rows that should have 1, shrunk towards 1 where they are few."""
    if len(rows) < FEWEST_ROWS:
        return 1.0
    found = DEVIATION_PER_MAD * float(np.median(np.abs(rows - np.median(rows))))
    weight = len(rows) / (len(rows) + ROWS_PER_PRIOR)
    return float(np.exp(weight * np.log(max(found, 0.05))))
