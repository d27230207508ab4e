"""Parameters that give effects a whitened distance d, and how well their nearest rivals would do."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from drd.effects.catalogue import catalogue
from drd.effects.chain import add
from drd.effects.effect import SIDES, START, ActsOn, Begins, Chance, Effect, Parameter, Values, number
from drd.effects.motion import Motion
from drd_tools.calibrate.wheels.drift import WHEELS_WANDER_S
from drd_tools.diagnose.analysis import Analysis
from drd_tools.diagnose.observe.constants import Constants
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine, refine_all
from drd_tools.diagnose.select.library import is_absent
from drd_tools.diagnose.select.search import CLASS_NATS, Search
from drd_tools.diagnose.selected import BIAS, Selected
from drd_tools.trial.overlay import Effects
from drd_tools.trial.results import TrueEffect

Random = np.random.Generator

RIVALS: Final = 3
ROUNDS: Final = 15
SIZED: Final = 0.01  # relative
SMALL: Final = 1e-4  # step away from a nonzero neutral value
FREE: Final = 1e4  # prior standard deviation, relative, of parameters that the recording alone determines
TINY: Final = 1e-12
DRAWS: Final = 5  # draws of a window, in which the robot may be at rest
EVENTS: Final = 20  # draws of an event, of which the nearest in size is used
NEAR: Final = 1.25  # factor allowed between its d and the requested one


@dataclass(frozen=True)
class Whitener:
    """Whitening of effects along a motion, as in the diagnosis, `beside` others that it found there.

    `clocks`: standard deviations, SI, of clock rates, if the calibration measures them (robot far from robot.yaml).
    """

    problem: Problem
    motion: Motion
    beside: Sequence[Selected] = ()
    clocks: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, analysis: Analysis) -> "Whitener":
        """Make one for a real recording: its fitted noise, and its motion by the nominal model and the findings."""
        found = analysis.conclusion.found
        selected = [(c.effect, c.values) for c in found.fit.selection]
        problem = found.problem.along(lambda motion: add(motion, selected)[0], is_read=True)
        beside = [_more(c) if c.is_timing else c for c in found.fit.selection]
        clocks = _clocks(analysis.measured) if problem.evidence.is_far else {}
        return cls(problem, problem.sensitivities.motion, beside, clocks)

    def detectability(self, effect: Effect, values: Values) -> float:
        """Norm of an effect's whitened sensitivity, nuisances projected out; 0 if the diagnosis ignores the effect.

        Nuisances are the reference's, with priors, and the free parameters of other effects found, without.
        """
        if effect.id in self.clocks:  # the calibration decides, given the natural wander of lags
            (q,) = effect.parameters
            return abs(number(values, q.name) - q.neutral) / self.clocks[effect.id]
        if is_absent(self.problem.evidence, effect):
            return 0.0
        rows = self.problem.effect_rows([Selected(effect, dict(values), ())])
        free = self.problem.tangents([c for c in self.beside if c.id != effect.id])
        norms = np.maximum(np.linalg.norm(free, axis=0), TINY)
        nuisance = np.hstack([self.problem.nuisance, FREE / norms * free])
        return math.sqrt(max(float(rows @ Marginal(nuisance).projected(rows)), 0.0))

    def sized(self, effect: Effect, d: float, random: Random) -> Values | None:
        """Values (SI) of detectability `d`; None if they would be implausible, or the effect is not visible at all."""
        values = dict(_shape(effect, self.motion, random))
        chosen = [q for q in effect.parameters if not q.choices and (q.linear or not effect.linear())]
        there: Values = next((c.values for c in self.beside if c.id == effect.id), {})
        # Several linear parameters shall be about equally visible.
        for q in chosen:
            alone: dict[str, float | str] = {**values, **dict.fromkeys((c.name for c in chosen), 0.0)}
            alone[q.name] = q.neutral + (SMALL if q.neutral else q.low * q.si)
            norm = self.detectability(effect, alone)
            if norm <= 0.0:
                return None
            share = random.uniform(0.3, 1.0) * (random.choice((-1.0, 1.0)) if q.signed or q.neutral else 1.0)
            if q.signed and q.name in there:  # same sign as the existing one, lest they cancel
                share = math.copysign(share, float(there[q.name]))
            values[q.name] = q.neutral + float(share) * (float(alone[q.name]) - q.neutral) / norm
        return scaled(values, chosen, d, lambda found: self.detectability(effect, found), ROUNDS, SIZED)

    def plantable(self, effect: Effect, d: float, random: Random) -> tuple[Values, float] | None:
        """Values (SI) with which a real drive shows an effect, and their detectability, about `d`; or None.

        An effect that destroys readings has no free size: the nearest of several draws is used.
        """
        if not effect.irreversible:
            draws = DRAWS if START in effect.parameters else 1
            drawn = (self.sized(effect, d, random) for _ in range(draws))
            values = next((v for v in drawn if v is not None), None)
            return None if values is None else (values, self.detectability(effect, values))
        found = self.event(effect, d, random)
        return found if found is not None and d / NEAR <= found[1] <= d * NEAR else None

    def event(self, effect: Effect, d: float, random: Random) -> tuple[Values, float] | None:
        """Draw an effect that destroys readings; return the values (SI) with detectability nearest to `d`, and it."""
        drawn = [v for _ in range(EVENTS) if (v := eventful(self.motion, effect, random)) is not None]
        sizes = [(v, size) for v in drawn if (size := self.detectability(effect, v)) > 0.0]
        return min(sizes, key=lambda pair: abs(math.log(pair[1] / d)), default=None)


def _clocks(measured: Constants) -> dict[str, float]:
    """Standard deviations, SI, of clock rates by effect, including the natural wander of lags."""
    wander = WHEELS_WANDER_S / float(np.ptp(measured.recording.encoders.time_s))
    sigma = measured.sigma._replace(lag_growth=math.hypot(measured.sigma.lag_growth, wander))
    found = {}
    for effect in catalogue().values():
        if effect.acts_on is ActsOn.TIMING and effect.begins is Begins.GROWING:
            (q,) = effect.parameters
            found[effect.id] = measured.spread(effect, q.name, sigma)
    return {name: spread for name, spread in found.items() if spread > 0.0}


def _more(selected: Selected) -> Selected:
    """Reset a delay or clock rate to neutral: readings that already have it get a little more."""
    return replace(selected, values={q.name: q.neutral * q.si for q in selected.effect.parameters})


def scaled(
    values: dict[str, Any],
    sizes: Sequence[Parameter],
    d: float,
    norm_of: Callable[[Values], float],
    rounds: int,
    tolerance: float,
) -> Values | None:
    """Scale the `sizes` among `values` (SI) together until their norm is `d`; None: not plausible, or not visible."""
    for _ in range(rounds):
        norm = norm_of(values)
        if norm <= 0.0:
            return None
        for q in sizes:
            values[q.name] = q.neutral + (values[q.name] - q.neutral) * d / norm
            if not abs(values[q.name]) <= q.high * q.si:
                return None
        if abs(norm / d - 1.0) < tolerance:
            return values
    return None


def selected_of(effects: Effects) -> list[Selected]:
    """Effects as the search selects them, with all parameters free that can be fitted, and a threshold's bias."""
    selection = [
        Selected(x, dict(v), tuple(q.name for q in x.parameters if not q.choices and not q.fixed)) for x, v in effects
    ]
    return [
        replace(c, values={**c.values, BIAS.name: 0.0}, free=(*c.free, BIAS.name))
        if c.effect.acts_on is ActsOn.READOUT and c.effect.searched
        else c
        for c in selection
    ]


def set_rivals(problem: Problem, effects: Effects, rows: Sequence[TrueEffect]) -> None:
    """Set in each effect's row its best surrogate without noise, and by how many nats that is worse."""
    truth = selected_of(effects)
    problem = problem.with_data(problem.effect_rows(truth))
    search, names = Search(problem), {c.id for c in truth}
    right = search.score(refine(problem, truth))
    for one, row in zip(truth, rows, strict=True):
        rest = refine(problem, [c for c in truth if c is not one])
        rivals = [selected for _, selected in search.ranked(rest) if selected.id not in names][:RIVALS]
        fits = refine_all(problem, [[*rest.selection, r] for r in rivals])
        best, row.rival = max([(search.score(f), f.selection[-1].id) for f in fits], default=(search.score(rest), ""))
        row.margin_nats = right - max(best, search.score(rest))
        row.separable = row.margin_nats > CLASS_NATS


def _shape(effect: Effect, motion: Motion, random: Random) -> Values:
    """Draw values (SI) of the nonlinear parameters, off the grid on which the search begins."""
    begin_s = float(random.uniform(0.15, 0.7)) * motion.end_s
    side = SIDES[int(random.integers(2))]
    end_s = begin_s + float(random.uniform(0.1, 0.25)) * motion.end_s
    # Each case draws all of them, so that an effect's values do not depend on those of others.
    chance = Chance(side, begin_s, end_s, *map(float, random.random(6)))
    return {**effect.variants(motion)[0], **effect.drawn(motion, chance)}


def eventful(motion: Motion, effect: Effect, random: Random) -> Values | None:
    """Draw values (SI) of an effect that destroys readings, visible at once or never; None: not in this drive."""
    moving = np.flatnonzero(np.abs(motion.speed_m_s) + motion.tread_m * np.abs(motion.rate_rad_s) > 0.2)
    if not len(moving) or not (np.abs(motion.rate_rad_s) > 0.02).any():
        return None
    begin_s = float(motion.time_s[moving[int(random.uniform(0.1, 0.7) * len(moving))]])
    side = SIDES[int(random.integers(2))]
    end_s = begin_s + float(random.uniform(3.0, 20.0))
    large, small = map(float, random.random(2))
    return dict(effect.drawn(motion, Chance(side, begin_s, end_s, large=large, small=small)))
