"""Parameters of effects that are to be seen so well, and how well their nearest rivals would do."""

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np

from drd.effects.effect import SIDES, ActsOn, Chance, Effect
from drd.effects.motion import Motion
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine, refine_all
from drd_tools.diagnose.select.search import CLASS_NATS, Search
from drd_tools.diagnose.selected import BIAS, Selected
from drd_tools.trial.overlay import Effects

Random = np.random.Generator
Values = dict[str, float | str]

RIVALS: Final = 3
ROUNDS: Final = 15
SIZED: Final = 0.01  # relative
SMALL: Final = 1e-4  # step off a value, other than 0, that has no effect


def visibility(problem: Problem, effect: Effect, values: Values) -> float:
    """Norm of an effect's whitened sensitivity, the reference's nuisances (with their priors) projected out."""
    rows = problem.effect_rows([Selected(effect, values, ())])
    return math.sqrt(max(float(rows @ Marginal(problem.nuisance).projected(rows)), 0.0))


def selected_of(effects: Effects) -> list[Selected]:
    """Effects as effects from their true values on, all that can be fitted free; a threshold's bias is not known."""
    selection = [
        Selected(x, v, tuple(q.name for q in x.parameters if not q.choices and not q.fixed)) for x, v in effects
    ]
    return [
        replace(c, values={**c.values, BIAS.name: 0.0}, free=(*c.free, BIAS.name))
        if c.effect.acts_on is ActsOn.READOUT and c.effect.searched
        else c
        for c in selection
    ]


def nearest(problem: Problem, effects: Effects) -> list[dict[str, Any]]:
    """For each of some effects: what would do best in its place without noise, another name or nothing (""), and by
    how many nats that is worse.
    """
    truth = selected_of(effects)
    problem = problem.with_data(problem.effect_rows(truth))
    search, names = Search(problem), {c.id for c in truth}
    right, made = search.score(refine(problem, truth)), []
    for one in truth:
        rest = refine(problem, [c for c in truth if c is not one])
        rivals = [selected for _, selected in search.ranked(rest) if selected.id not in names][:RIVALS]
        fits = refine_all(problem, [[*rest.selection, r] for r in rivals])
        scores = [(search.score(f), f.selection[-1].id) for f in fits]
        best, rival = max(scores, default=(search.score(rest), ""))
        margin = right - max(best, search.score(rest))
        made.append({"rival": rival, "margin_nats": margin, "separable": margin > CLASS_NATS})
    return made


def sized(problem: Problem, motion: Motion, effect: Effect, d: float, random: Random) -> Values | None:
    """Values (SI) with which the visibility is `d`; None where they would be implausible, or nothing is seen at all."""
    values = _shape(effect, motion, random)
    chosen = [q for q in effect.parameters if not q.choices and (q.linear or not effect.linear())]
    # Of several linear parameters each is to be seen about as well.
    for q in chosen:
        alone: Values = {**values, **dict.fromkeys((c.name for c in chosen), 0.0)}
        alone[q.name] = q.neutral + (SMALL if q.neutral else q.low * q.si)
        norm = visibility(problem, effect, alone)
        if norm <= 0.0:
            return None
        share = random.uniform(0.3, 1.0) * (random.choice((-1.0, 1.0)) if q.signed or q.neutral else 1.0)
        values[q.name] = q.neutral + float(share) * (float(alone[q.name]) - q.neutral) / norm
    for _ in range(ROUNDS):
        norm = visibility(problem, effect, values)
        if norm <= 0.0:
            return None
        for q in chosen:
            values[q.name] = q.neutral + (float(values[q.name]) - q.neutral) * d / norm
            if not abs(float(values[q.name])) <= q.high * q.si:
                return None
        if abs(norm / d - 1.0) < SIZED:
            return values
    return None


def _shape(effect: Effect, motion: Motion, random: Random) -> Values:
    """Values (SI) of the parameters that are not linear, off the grid on which the search begins."""
    begin_s = float(random.uniform(0.15, 0.7)) * motion.end_s
    side = SIDES[int(random.integers(2))]
    end_s = begin_s + float(random.uniform(0.1, 0.25)) * motion.end_s
    # Each case draws all of them, so that one effect's values do not depend on what others have.
    chance = Chance(side, begin_s, end_s, *map(float, random.random(6)))
    return {**effect.variants(motion)[0], **effect.drawn(motion, chance)}


def eventful(motion: Motion, effect: Effect, random: Random) -> Values | None:
    """Values (SI) of an effect that destroys readings, and is seen at once or not at all; None: not in this drive."""
    moving = np.flatnonzero(np.abs(motion.speed_m_s) + motion.tread_m * np.abs(motion.rate_rad_s) > 0.2)
    if not len(moving) or not (np.abs(motion.rate_rad_s) > 0.02).any():
        return None
    begin_s = float(motion.time_s[moving[int(random.uniform(0.1, 0.7) * len(moving))]])
    side = SIDES[int(random.integers(2))]
    end_s = begin_s + float(random.uniform(3.0, 20.0))
    large, small = map(float, random.random(2))
    return dict(effect.drawn(motion, Chance(side, begin_s, end_s, large=large, small=small)))
