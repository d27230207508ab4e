"""Parameters of effects that are to be seen so well, and how well their nearest rivals would do."""

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np

from drd.effects.effect import ActsOn, Effect
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG
from drd_tools.diagnose.claim import BIAS, Claim
from drd_tools.diagnose.library import AUDITED
from drd_tools.diagnose.problem import Problem
from drd_tools.diagnose.refine import beyond, refine, refine_all
from drd_tools.diagnose.search import CLASS_NATS, Search
from drd_tools.trial.overlay import Effects

Random = np.random.Generator
Values = dict[str, float | str]

RIVALS: Final = 3
ROUNDS: Final = 15
SIZED: Final = 0.01  # relative
SMALL: Final = 1e-4  # step off a value, other than 0, that has no effect


def visibility(problem: Problem, effect: Effect, values: Values) -> float:
    """Norm of an effect's whitened signature, the reference's nuisances (with their priors) projected out."""
    rows = problem.effect_rows([Claim(effect, values, ())])
    return math.sqrt(max(float(rows @ beyond(problem.nuisance, rows)), 0.0))


def claims_of(effects: Effects) -> list[Claim]:
    """Effects as claims from their true values on, all that can be fitted free; a threshold's bias is not known."""
    claims = [Claim(x, v, tuple(q.name for q in x.parameters if not q.choices and not q.fixed)) for x, v in effects]
    return [
        replace(c, values={**c.values, BIAS.name: 0.0}, free=(*c.free, BIAS.name))
        if c.effect.acts_on is ActsOn.READOUT and c.id not in AUDITED
        else c
        for c in claims
    ]


def nearest(problem: Problem, effects: Effects) -> list[dict[str, Any]]:
    """For each of some effects: what would do best in its place without noise, another name or nothing (""), and by
    how many nats that is worse.
    """
    truth = claims_of(effects)
    search, data, names = Search(problem), problem.data, {c.id for c in truth}
    problem.data = problem.effect_rows(truth)
    try:
        right, made = search.score(refine(problem, truth)), []
        for one in truth:
            rest = refine(problem, [c for c in truth if c is not one])
            rivals = [claim for _, claim in search.ranked(rest) if claim.id not in names][:RIVALS]
            fits = refine_all(problem, [[*rest.claims, r] for r in rivals])
            scores = [(search.score(f), f.claims[-1].id) for f in fits]
            best, rival = max(scores, default=(search.score(rest), ""))
            margin = right - max(best, search.score(rest))
            made.append({"rival": rival, "margin_nats": margin, "separable": margin > CLASS_NATS})
    finally:
        problem.data = data
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
    values: Values = dict(effect.variants(motion)[0])
    moving = np.abs(motion.left_m_s)
    moving = moving[moving > 0.05]
    begin_s = float(random.uniform(0.15, 0.7)) * motion.end_s
    drawn: Values = {
        "side": ("left", "right")[int(random.integers(2))],
        "t0": begin_s,
        "t1": begin_s + float(random.uniform(0.1, 0.25)) * motion.end_s,
        "phase": float(random.uniform(0.0, 2.0 * math.pi)),
        "period": float(random.uniform(0.25, 0.6)) * motion.end_s,
        "pitch": float(random.uniform(3.0, 6.0)),
        "tau": float(np.exp(random.uniform(np.log(40.0), np.log(400.0)))),
        "coil_lag_s": float(np.exp(random.uniform(np.log(10.0), np.log(100.0)))),
        # No speed that is held: a threshold at just that is neither passed nor not.
        "speed": float(random.uniform(0.3, 0.9)) * (float(moving.max()) if len(moving) else 0.1),
    }
    own = {q.name for q in effect.parameters if not q.linear and not q.fixed}
    return values | {name: value for name, value in drawn.items() if name in own}


def eventful(motion: Motion, effect: Effect, random: Random) -> Values | None:
    """Values (SI) of an effect that destroys readings, and is seen at once or not at all; None: not in this drive."""
    moving = np.flatnonzero(np.abs(motion.speed_m_s) + motion.tread_m * np.abs(motion.rate_rad_s) > 0.2)
    rates = np.abs(motion.rate_rad_s[np.abs(motion.rate_rad_s) > 0.02])
    if not len(moving) or not len(rates):
        return None
    begin_s = float(motion.time_s[moving[int(random.uniform(0.1, 0.7) * len(moving))]])
    drawn: Values = {
        "side": ("left", "right")[int(random.integers(2))],
        "t0": begin_s,
        "t1": begin_s + float(random.uniform(3.0, 20.0)),
        "limit": float(random.uniform(0.6, 0.9) * rates.max()),
        "band": float(np.exp(random.uniform(np.log(0.05), np.log(0.5)))) * RAD_PER_DEG,
    }
    return {q.name: drawn[q.name] for q in effect.parameters}
