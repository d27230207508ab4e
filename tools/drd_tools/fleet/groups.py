"""Changes common to a group of robots, and the cause of a robot's change: its place, its batch, or itself. (106)"""

from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.monitor.findings import Z_90
from drd_tools import robust
from drd_tools.fleet.population import Population, Step
from drd_tools.fleet.series import Integers, Log

# Mean days between changes of a robot's constant, of a floor and of a batch.
ROBOT_DAYS: Final = 2000.0
DAYS: Final = {"place": 2000.0, "batch": 2000.0}
LEAST_GROUP: Final = 3  # robots, so that one alone does not determine the median
MOST_STEPS: Final = 4  # per constant: limits a greedy search
SURE_NATS: Final = 3.0  # 20 to 1
LEAST_PART: Final = 0.1  # of a jump: smaller steps are due to effects that are common to no group, such as wear
CLIP: Final = 3.0  # sigmas from the median, for robots with changes of their own
MOSTLY: Final = 0.75  # share of a group's robots that must show its change: some have changes of their own
ALIKE: Final = 1.0  # fraction of a group's step by which a robot's may differ
NOTHING: Final = 1e-9  # fraction of the information: rounding errors
MOST_DAYS: Final = 120  # dates tried


class Score(NamedTuple):
    """Score and information of a unit step for each robot, shape (robots,)."""

    score: Array
    information: Array


def scored(log: Log, p: Population, segment: Integers, levels: Integers, left: Array, x: Array) -> Score:
    """Score and information of the regressor `x` (n,) in the residual `left` (n,), each segment's level free. (106)"""
    w = 1.0 / p.variance(log)
    own = p.spread**2 + np.where(levels, 0.0, log.constant.jump**2)
    many = len(levels)
    total = np.bincount(segment, w, many) + 1.0 / own
    wx, wr = np.bincount(segment, w * x, many), np.bincount(segment, w * left, many)
    score = np.bincount(segment, w * x * left, many) - wx * wr / total
    information = np.bincount(segment, w * x * x, many) - wx * wx / total
    robot = np.zeros(many, np.int64)
    robot[segment] = log.robot
    robots = len(log.robots)
    return Score(_sums(robot, score, robots), _sums(robot, information, robots))


def _sums(of: Integers, values: Array, many: int) -> Array:
    return np.bincount(of, values, many).astype(float)


def gain(size: float, sigma: float, jump: float) -> float:
    """Log Bayes factor of a step estimated as `size` +- `sigma` whose prior is N(0, jump^2)."""
    return float(_nats(size / sigma**2, sigma**-2, jump))


def pooled(found: Score, jump: float) -> tuple[float, float, int]:
    """Mean step of the robots, its sigma, and their number: random effects, robust against single robots. (106)

    The sigma is infinite if they do not agree.
    """
    seen = found.information > 1.0 / jump**2
    many = int(seen.sum())
    if many < LEAST_GROUP:
        return 0.0, np.inf, many
    size, variance = found.score[seen] / found.information[seen], 1.0 / found.information[seen]
    middle = float(np.median(size))
    # Two of three robots with causes of their own must not decide for the third.
    is_alike = np.abs(size - middle) < np.maximum(0.5 * abs(middle), 2.0 * np.sqrt(variance))
    is_shared = bool(is_alike.sum() >= max(LEAST_GROUP, MOSTLY * many))
    scale = robust.deviation(size)
    total = variance + max(0.0, scale**2 - float(np.median(variance)))
    size = np.clip(size, middle - CLIP * np.sqrt(total), middle + CLIP * np.sqrt(total))
    weight = 1.0 / total
    return float(weight @ size / weight.sum()), float(1.0 / np.sqrt(weight.sum())) if is_shared else np.inf, many


def stays_without_any(
    log: Log, p: Population, segment: Integers, levels: Integers, left: Array, x: Array, off: float
) -> bool:
    """Whether the 90 % interval of a group's offset excludes 0, whichever robot is left out. (107)

    `x`: 1 in the group; `left`: residual that includes the offset; both (n,). The mean of all is free: a place where
    only one robot has been, or which only one has left, is no evidence on places; the robot may be the cause.
    """
    one = np.ones(len(x))
    (of_x, xx), (of_one, ones), (_, both) = (
        scored(log, p, segment, levels, left, shape) for shape in (x, one, x + one)
    )
    every = np.array([of_x, xx, of_one, ones, (both - xx - ones) / 2.0])
    score, xx, mean, ones, shared = every.sum(1, keepdims=True) - every
    lever = shared / np.maximum(ones, NOTHING * every[3].sum())
    information = np.maximum(xx - lever * shared, NOTHING * every[1].sum())
    return bool(np.all(np.sign(off) * (score - lever * mean) > Z_90 * np.sqrt(information)))


def explained(found: Score, size: float) -> float:
    """Nats that one step of `size` explains in the robots, except those with changes of their own. (106)"""
    information = np.maximum(found.information, 1e-300)
    gained = size * found.score - 0.5 * size**2 * information
    off = np.abs(found.score / information - size) / max(abs(size), 1e-300)
    return float(gained[off < ALIKE].sum())


def steps(log: Log, p: Population, segment: Integers, levels: Integers, left: Array) -> Step | None:
    """Find the surest change of a place or a batch in the residual of a model without it; None if none is sure."""
    days = np.unique(np.floor(log.day))[1:]
    days = days[:: max(1, len(days) // MOST_DAYS)]
    groups = [("place", k) for k in range(len(log.places)) if len(log.places) > 1]
    groups += [("batch", k) for k in range(len(log.batches)) if len(log.batches) > 1]
    found = [_best_step(log, p, segment, levels, left, kind, which, days) for kind, which in groups if len(days)]
    sure = [(nats, step) for nats, step in found if step is not None]
    return max(sure, key=lambda one: one[0])[1] if sure else None


def _best_step(
    log: Log, p: Population, segment: Integers, levels: Integers, left: Array, kind: str, which: int, days: Array
) -> tuple[float, Step | None]:
    """Find the date at which a group's step explains most; the step is None unless sure."""
    jump = log.constant.jump
    if kind == "place":
        # Each robot has its own level at the place, so that the place's offset is free.
        pair, segment = np.unique(2 * segment + (log.place == which), return_inverse=True)
        levels = levels[pair // 2] * 0
    nats, at = [], []
    for day in days:
        step = Step(kind, which, float(day), 0.0, 0.0, 0.0, 0)
        seen = scored(log, p, segment, levels, left, step.rows(log))
        size, sigma, robots = pooled(seen, jump)
        nats.append(explained(seen, size) if robots >= LEAST_GROUP else -np.inf)
        at.append((size, sigma, robots))
    k = int(np.argmax(nats))
    size, sigma, robots = at[k]
    if not np.isfinite(sigma):
        return -np.inf, None
    # One date of many, all equally likely a priori.
    odds = gain(size, sigma, jump) - np.log(DAYS[kind])
    step = Step(kind, which, float(days[k]), size, sigma, float(1.0 / (1.0 + np.exp(-odds))), robots)
    return nats[k], step if odds > SURE_NATS and abs(size) > LEAST_PART * jump else None


def causes(
    log: Log, p: Population, segment: Integers, levels: Integers, left: Array, robot: int, shape: Array,
    beside: Array,
) -> dict[str, float]:  # fmt: skip
    """Probabilities that a change of a robot is its own, a place's, or its batch's. (106)

    `shape`: the change's course over all recordings, shape (n,), of unit size. `beside`: the robots that change alike
    at that time, including this one, shape (robots,); `segment`, `left`: without these changes removed. A group's
    change is the same in all of its robots; those of `beside` outside the group have changes of their own.
    """
    jump, mine = log.constant.jump, log.robot == robot
    each = scored(log, p, segment, levels, left, shape)
    alone = np.maximum(0.0, _nats(each.score, each.information, jump) - np.log(ROBOT_DAYS)) * beside
    odds = {"robot": float(alone.sum() - alone[robot] + _nats(each.score, each.information, jump)[robot])}
    odds["robot"] -= float(np.log(ROBOT_DAYS))

    def of_group(inside: Array, days: float) -> float:
        found = scored(log, p, segment, levels, left, shape * inside)
        of_it = np.bincount(log.robot, inside * (shape > 0.0), len(log.robots)) > 0.0
        together = _nats(found.score.sum(), found.information.sum(), jump) - np.log(days)
        return float(together + alone[~of_it].sum())

    for place in np.unique(log.place[mine & (shape > 0.0)]) if len(log.places) > 1 else ():
        odds[f"place {log.places[place]}"] = of_group(log.place == place, DAYS["place"])
    batch = log.batch_of[robot]
    if len(log.batches) > 1:
        odds[f"batch {log.batches[batch]}"] = of_group(log.batch_of[log.robot] == batch, DAYS["batch"])
    most = max(odds.values())
    weight = {name: float(np.exp(value - most)) for name, value in odds.items()}
    return {name: value / sum(weight.values()) for name, value in weight.items()}


def _nats(score: Any, information: Any, jump: float) -> Any:
    """Log Bayes factor of a size N(0, jump^2) against 0."""
    return 0.5 * (score**2 / (information + jump**-2) - np.log1p(jump**2 * information))


def pruned(p: Population, jump: float) -> Population:
    """Drop the steps that are no longer sure, now that the robots' own changes are known."""
    sure = [
        s for s in p.steps
        if abs(s.size) > LEAST_PART * jump and gain(s.size, s.sigma, jump) - np.log(DAYS[s.kind]) > SURE_NATS
    ]  # fmt: skip
    return replace(p, steps=tuple(sure))
