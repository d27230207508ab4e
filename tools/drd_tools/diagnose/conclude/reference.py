"""Delays and clock rates that may be the reference's own, and the offset between wheels and reference. (87)"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from scipy.special import ndtr

from drd.arrays import Array
from drd.effects.effect import Begins
from drd_tools.calibrate.wheels.drift import REFERENCE_WANDER_S
from drd_tools.diagnose.conclude.confirm import LARGEST_NATS
from drd_tools.diagnose.error_model.sensitivities import DRIFT, LATENCY
from drd_tools.diagnose.observe.lags import MOST_DRIFT
from drd_tools.diagnose.regression.chain import delays_s
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, joint_covariance
from drd_tools.diagnose.selected import Selected

REFERENCE_S: Final = 0.05  # usual delay of motion capture over a network
CLEARLY: Final = 3.0  # sigmas: of a reported fault
BARELY: Final = 3.0  # to 1: odds below are "barely worth mentioning" (Jeffreys 1961)


def reference_deviation(problem: Problem, selected: Selected, name: str) -> float:
    """Deviation of a delay or clock rate due to those of the reference, if no gyro separates them; else 0."""
    if not selected.is_timing or problem.evidence.gyro_rad is not None:
        return 0.0
    lasts_s = float(np.ptp(problem.evidence.edges_s))
    return {"s": REFERENCE_S, "ppm": REFERENCE_WANDER_S / lasts_s}.get(selected.parameter(name).unit, 0.0)


class Apart(NamedTuple):
    """Offsets between wheels and reference, each with its deviation.

    `nuisances`: by name, SI; DRIFT is the growth of the reference's own lag, s/s. `by_unit`: total offset, whatever its
    cause, by the parameter's unit: delay of the wheels at the middle of the drive, s, and rate at which the
    reference's clock departs from theirs, s/s.
    """

    nuisances: Mapping[str, tuple[float, float]]
    by_unit: Mapping[str, tuple[float, float]]


def apart(problem: Problem, fit: Fit) -> Apart:
    """Offsets between wheels and reference in a fit."""
    free = [(selected, name) for selected in fit.selection for name in selected.free]
    x = np.concatenate([fit.nuisance, [selected.number(name) for selected, name in free]])
    covariance = joint_covariance(problem, fit)

    def summed(of_reference: Mapping[str, float], of_times: Mapping[str, float]) -> tuple[float, float]:
        """Weighted sum, with its deviation, of nuisances, by name, and of delays and clock rates, by unit."""
        nuisances = [of_reference.get(name, 0.0) * size for name, size, _ in problem.nuisances]
        times = [of_times.get(c.parameter(name).unit, 0.0) * c.is_timing for c, name in free]
        w = np.array([*nuisances, *times])
        return float(w @ x), math.sqrt(max(float(w @ covariance @ w), 0.0))

    return Apart(
        nuisances={name: summed({name: 1.0}, {}) for name, _, _ in problem.nuisances},
        by_unit={
            "s": summed({LATENCY: -1.0}, {"s": 1.0, "ppm": -_middle_s(problem)}),
            "ppm": summed({DRIFT: 1.0}, {"ppm": 1.0}),
        },
    )


def _middle_s(problem: Problem) -> float:
    return float(problem.evidence.edges_s[[0, -1]].mean())


def over_the_reference(problem: Problem, estimates: Sequence[Selected]) -> tuple[list[Selected], list[float]]:
    """The estimates, and for each the odds that it is more than the reference's own delay or clock rate.

    The odds are infinite for other effects, and with a gyro. If the growth of a delay may equally be the reference's,
    the delay is that at the middle of the drive, which no growth changes.
    """
    timed = [_by_timing(problem, c) for c in estimates]
    named = [c for c in timed if _odds(problem, c) >= BARELY]
    fitted, kept = (_at_the_middle(problem, several) for several in (estimates, named))
    found = [_later(c, *(fitted - kept).tolist()) for c in timed]
    return found, [_odds(problem, c) for c in found]


def _by_timing(problem: Problem, selected: Selected) -> Selected:
    """A clock rate without a gyro, from the growth of the lag, if that was measured; leave any other effect unchanged.

    In a fit, it is also a scale of the wheels' travel, and N takes a part of the growth.
    """
    robot = problem.evidence.robot
    if selected.effect.begins is not Begins.GROWING or problem.evidence.gyro_rad is not None or not robot.lag_growth:
        return selected
    return replace(selected, values={**selected.values, **(selected.effect.calibrated(robot) or {})})


def _at_the_middle(problem: Problem, selection: Sequence[Selected]) -> Array:
    """Delays of gyro and wheels, s, that have grown until the middle of the drive."""
    grown = [c for c in selection if c.effect.begins is Begins.GROWING]
    return np.array([late_s[0] for late_s in delays_s(grown, np.full(2, _middle_s(problem)))])


def _later(selected: Selected, gyro_s: float, wheels_s: float) -> Selected:
    """Lengthen a delay by these; leave any other effect unchanged."""
    if not selected.is_timing or selected.effect.begins is Begins.GROWING:
        return selected
    more_s = wheels_s if selected.effect.channel == "wheels" else gyro_s
    at = {q.name: max(selected.number(q.name) + more_s, 0.0) for q in selected.effect.parameters if q.unit == "s"}
    return replace(selected, values={**selected.values, **at})


def _odds(problem: Problem, selected: Selected) -> float:
    return max((_odds_of(problem, selected, name) for name in selected.free), default=math.inf)


def _odds_of(problem: Problem, selected: Selected, name: str) -> float:
    if not reference_deviation(problem, selected, name):
        return math.inf
    q, sigma = selected.parameter(name), selected.sigma(name)
    if sigma == 0.0:
        return math.inf
    high = MOST_DRIFT if q.unit == "ppm" else q.high * q.si
    x = min(abs(selected.number(name)), high)  # larger values are no more likely the reference's
    low = -high if q.signed else 0.0
    either = float(ndtr((high - x) / sigma) - ndtr((low - x) / sigma)) / (high - low)
    return either * sigma * math.sqrt(2.0 * math.pi) * math.exp(min(0.5 * (x / sigma) ** 2, LARGEST_NATS))
