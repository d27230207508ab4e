"""Analysis of one recording, from evidence to conclusion."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.effects.effect import Begins
from drd.units import RAD_PER_DEG
from drd_tools.diagnose.combine.expected import Expected, borne_out
from drd_tools.diagnose.conclude.cause import named
from drd_tools.diagnose.conclude.conclusion import Conclusion, conclude
from drd_tools.diagnose.conclude.reference import CLEARLY, apart
from drd_tools.diagnose.conclude.scatter import scatter_of
from drd_tools.diagnose.error_model.sensitivities import AHEAD, DRIFT, SIDEWAYS, SMOOTHING, YAW
from drd_tools.diagnose.observe.audit import jumped
from drd_tools.diagnose.observe.constants import Constants, observe
from drd_tools.diagnose.observe.events import Event
from drd_tools.diagnose.observe.evidence import Noise
from drd_tools.diagnose.regression.noise_fit import (
    WHEELS,
    fitted,
    inflated,
    noise_beside,
    ratios,
    scaled,
    score_with_noise,
)
from drd_tools.diagnose.regression.problem import Inflation, Problem
from drd_tools.diagnose.regression.refine import refine, refine_all
from drd_tools.diagnose.results import Amount, Figures, Scatter
from drd_tools.diagnose.select.intervals import moved
from drd_tools.diagnose.select.library import release
from drd_tools.diagnose.select.search import Found, Search, coarse_search, converged, full_search, is_rough, linearised
from drd_tools.diagnose.select.start import Start, started
from drd_tools.diagnose.selected import Selected
from drd_tools.diagnose.series import Spread
from drd_tools.recordings.folder import Recording

NOISE_ROUNDS: Final = 2  # the second fits the noise without the effects that the first mistook for noise
ROUGH_ROUNDS: Final = 4  # if the data are far from the model
SETTLING_ROUNDS: Final = 4  # later rounds add the same to the scores of all sets
GROWING_ROUNDS: Final = 8  # if the noise must be refitted after a set that explains much: limits the time
# Long-run deviation of the wheels' noise that reduces an effect of d = 8 from 32 nats to 14, the cost of some.
HIDING: Final = 1.5
LEAST_JITTER_S: Final = 0.01  # a smaller jitter changes little
FAULT_OF_UNIT: Final = {"s": "delay", "ppm": "drift"}  # by the unit of the effect that is attributed to the reference
# Errors of the reference alone: name, unit, and size of the unit in SI.
FAULT_OF_NUISANCE: Final = {
    DRIFT: ("drift", "ppm", 1e-6),
    AHEAD: ("ahead", "m", 1.0),
    SIDEWAYS: ("left", "m", 1.0),
    YAW: ("heading", "deg", RAD_PER_DEG),
    SMOOTHING: ("smoothing", "1", 1.0),
}
NOISE_CHANGED: Final = 0.1  # relative change after which the search is repeated


@dataclass(frozen=True)
class Analysis:
    """Conclusion on one recording. `null` (r,): whitened data less the nuisances, before any effect.

    `measured`: the robot's constants. `reference`: errors of the reference: `lag`, if larger than usual; `drift` of its
    clock relative to the wheels', if no gyro shows which one drifts; the position of its marker, `ahead` and `left` of
    the robot's centre, and its `heading` offset; `smoothing`; how long it was lost (`held`), and the number of `jumps`.
    """

    measured: Constants
    reference: dict[str, Amount]
    events: list[Event]
    null_problem: Problem
    null: Array
    conclusion: Conclusion

    @property
    def recording(self) -> Recording:
        """The recording with its reference's stamps corrected by its lag."""
        return self.measured.recording

    def noise_ratios(self) -> Figures:
        """Ratios of the fitted noise to the datasheets'."""
        return ratios(self.conclusion.found.problem)

    def scatter(self) -> tuple[list[Scatter], list[Spread]]:
        """Noise much larger than stated, and its course."""
        found = self.conclusion.found
        return scatter_of(found.problem, found.fit.left, self.recording.nominal)


def analyse(recording: Recording, expected: Sequence[Expected] = ()) -> Analysis:
    """Audit, fit the noise, search, and judge the result. `expected`: effects from the robot's other recordings."""
    measured, audited = observe(recording)
    start = started(audited, measured)
    # Noise and effects are fitted alternately, which may converge with noise in place of an effect.
    searched = (_searched(problem, start) for problem in _first_problems(start))
    problem, found = max(searched, key=lambda s: score_with_noise(s[1].problem, s[1].fit))
    null = refine(problem, start.known)
    new = [one.selected for one in expected if one.selected.id not in {c.id for c in found.fit.selection}]
    if new:
        found = linearised(found.problem, replace(found.fit, selection=(*found.fit.selection, *new)), found.null)
    if found.problem is not problem:
        release(problem)
    conclusion = conclude(found, audited.events, {c.id for c in start.constants}, {c.id for c in new})
    conclusion = borne_out(conclusion, [one for one in expected if one.selected in new])
    release(found.problem)
    return Analysis(measured, _faults(measured, conclusion), audited.events, problem, null.left, conclusion)


def _faults(measured: Constants, conclusion: Conclusion) -> dict[str, Amount]:
    """Errors of the reference, and effects attributed to it.

    Without a gyro, the clocks drift apart as their timing shows: a fit's rate is also a scale of the wheels' travel.
    """
    faults = {"lag": Amount(measured.lag_s, measured.lag_sigma_s, "s")} if measured.lag_s else {}
    found = apart(conclusion.found.problem, conclusion.found.fit)
    nuisances, by_unit = {**found.nuisances}, {**found.by_unit}
    if conclusion.found.problem.evidence.gyro_rad is None and measured.robot.lag_growth:
        by_unit["ppm"] = -measured.robot.lag_growth, measured.sigma.lag_growth
        is_named = any(c.effect.begins is Begins.GROWING for c in named(conclusion.causes))
        nuisances[DRIFT] = (0.0, 0.0) if is_named else by_unit["ppm"]
    for nuisance, (name, unit, si) in FAULT_OF_NUISANCE.items():
        value, sigma = nuisances.get(nuisance, (0.0, 0.0))
        # Negative smoothing is impossible: no reference is sharper than the truth.
        if value > CLEARLY * sigma or (nuisance != SMOOTHING and value < -CLEARLY * sigma):
            faults[name] = Amount(value / si, sigma / si, unit)
    if measured.held_s:
        faults["held"] = Amount(measured.held_s, 0.0, "s")
    if jumps := np.count_nonzero(jumped(conclusion.found.problem.evidence)):
        faults["jumps"] = Amount(float(jumps), 0.0, "1")
    for q in (c.parameter(name) for c in conclusion.of_the_reference for name in c.free):
        value, sigma = by_unit[q.unit]
        faults[FAULT_OF_UNIT[q.unit]] = Amount(value / q.si, sigma / q.si, q.unit)
    return faults


def _first_problems(start: Start) -> Iterator[Problem]:
    """The problem with the noise that explains the whole mismatch; and with the stated noise, if that is smaller."""
    problem, held = start.problem, start.held
    for _ in range(NOISE_ROUNDS):
        near = problem.around(held) if start.constants else problem
        fit = refine(near, held)
        noise, fix_inflation = fitted(near, fit, searched=False)
        # With constants far off, correlated residuals count as noise until an effect is found; effects of the body,
        # seen only by the reference, are larger than that.
        inflation = Inflation(inflated(near, fit.left, noise).wheels) if start.constants else problem.inflation
        problem = problem.with_noise(noise, fix_inflation, inflation)
    yield problem
    if (stated := _as_stated(problem, noise)) is not None:
        yield problem.with_noise(stated, fix_inflation, inflation)


def _as_stated(problem: Problem, noise: Noise) -> Noise | None:
    """Reset the noise of a sensor that only the reference checks to the stated size, if the fit is larger; else None.

    With wheels and gyro, every row of the wheels shows the noise, and few of them an effect of some seconds.
    """
    sheet = problem.evidence.datasheet
    if problem.evidence.gyro_rad is None and noise.slip_m_per_sqrt_m > sheet.slip_m_per_sqrt_m:
        return scaled(noise, sheet.slip_m_per_sqrt_m / noise.slip_m_per_sqrt_m, WHEELS)
    if not problem.evidence.has_wheels and noise.walk_rad_per_sqrt_s > sheet.walk_rad_per_sqrt_s:
        return replace(noise, walk_rad_per_sqrt_s=sheet.walk_rad_per_sqrt_s)
    return None


def _searched(problem: Problem, start: Start) -> tuple[Problem, Found]:
    """Search and fit the noise alternately; the problem before any effect, with the last noise, and the result."""
    problem = problem if start.constants else converged(problem, start.known)
    searched = _with_its_noise(problem, start, coarse_search(problem, start.known, start.constants))
    return _with_hidden(searched, start)


def _with_its_noise(problem: Problem, start: Start, found: Found) -> tuple[Problem, Found]:
    """Fit the noise beside the effects found and continue the search, alternately; then search to the end."""
    known, constants = start.known, start.constants
    for i in range(GROWING_ROUNDS if constants else ROUGH_ROUNDS):
        # With the selected effects removed, the residual shows the noise better than before.
        is_due = is_rough(found.fit) or found.is_noise_due
        if i >= NOISE_ROUNDS and not is_due:
            break
        noise, fix_inflation, inflation = noise_beside(found.problem, found.fit)
        if _is_near(noise, inflation, found.problem) and not is_due:
            break
        problem = problem.with_noise(noise, fix_inflation, inflation)
        problem = problem if constants else converged(problem, known)
        found = coarse_search(problem, known, constants, found)
    return problem, full_search(found, start.held)


def _with_hidden(searched: tuple[Problem, Found], start: Start) -> tuple[Problem, Found]:
    """Continue a search with an effect of an interval that the long-run variance hides, if one is likelier. (78)

    A slip of half a minute is part of the long-run variance until it is removed, and gains nothing beside it.
    """
    problem, found = searched
    its, long_run = found.problem, float(np.median(found.problem.inflation.wheels))
    if not start.constants or long_run < HIDING:
        return searched
    less = its.inflation._replace(wheels=math.sqrt(long_run))
    plain = linearised(problem.with_noise(its.noise, its.fix_inflation, less), found.fit, found.null)
    candidates = [found, *_with_intervals(plain)]
    if len(candidates) == 1:
        return searched
    best = max(candidates, key=lambda candidate: _settled_score(searched, candidate))
    return searched if best is found else _with_its_noise(problem, start, best)


def _with_intervals(found: Found) -> list[Found]:
    """The effects found, with one more: each that is limited to an interval and worth its cost, in its best one."""
    problem, fit = found.problem, found.fit
    best: dict[str, Selected] = {}
    for _, one in Search(problem).ranked(fit):
        if one.interval_s is not None:
            best.setdefault(one.id, one)
    made = []
    for one in best.values():
        near = [one, *moved([one], float(np.ptp(problem.evidence.edges_s)))]
        fits = refine_all(problem, [[*fit.selection, other] for other in near])
        made.append(replace(found, fit=min(fits, key=lambda tried: tried.cost)))
    return made


def _settled_score(searched: tuple[Problem, Found], candidate: Found) -> float:
    """Score of a candidate with its own noise, fitted in some rounds from that of the search.

    The noise converges slowly: of two sets, the one with more rounds would seem likelier.
    """
    problem, found = searched
    made = linearised(found.problem, candidate.fit, candidate.null)
    for _ in range(SETTLING_ROUNDS):
        made = linearised(problem.with_noise(*noise_beside(made.problem, made.fit)), made.fit, made.null)
    return score_with_noise(made.problem, made.fit)


def _is_near(noise: Noise, inflation: Inflation, problem: Problem) -> bool:
    """Whether a problem already has nearly this noise."""
    before, was = problem.noise, problem.inflation
    pairs = (
        (noise.slip_m_per_sqrt_m, before.slip_m_per_sqrt_m),
        (noise.position_m, before.position_m),
        (noise.heading_rad, before.heading_rad),
        (noise.jitter_s + LEAST_JITTER_S, before.jitter_s + LEAST_JITTER_S),
    )
    sizes = ((inflation.wheels, was.wheels), *zip(np.transpose(inflation.fixes), np.transpose(was.fixes), strict=True))
    same = all(np.ndim(a) == np.ndim(b) and np.abs(a / b - 1.0).sum() <= NOISE_CHANGED * np.size(a) for a, b in sizes)
    return same and all(abs(a / b - 1.0) < NOISE_CHANGED for a, b in pairs)
