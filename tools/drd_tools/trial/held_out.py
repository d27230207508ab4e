"""What a diagnosis is worth on another drive of the same robot, beside an oracle that knows what is true."""

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

import drd
from drd.effects.motion import Motion
from drd.model import DRIVERS, Amount, Term
from drd_tools.diagnose import outcome
from drd_tools.diagnose.diagnose import Diagnosis
from drd_tools.diagnose.evidence import gather
from drd_tools.diagnose.outcome import SLOWEST_M_S
from drd_tools.diagnose.problem import Claim, Problem
from drd_tools.diagnose.refine import beyond
from drd_tools.recordings.folder import Recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.result import table
from drd_tools.trial.overlay import Effects
from drd_tools.trial.unknown import HIDDEN

Array = npt.NDArray[np.float64]
Seen = Mapping[str, Sequence[float]]
_Ranged = tuple[Claim, Seen]


def judged(result: Diagnosis, truth: Effects, other: Recording) -> dict[str, Any]:
    """`other`'s mismatch before, with what was found, and with what is true (the oracle), all with values as they are.

    `residual`: squared whitened innovations, the reference's own nuisances fitted. `path_m`: rms distance of the
    dead-reckoned path from the reference; with hidden physics there is no oracle for it.
    """
    problem = Problem(gather(other))
    home = result.conclusion.found.problem.signatures.motion
    claims = [(f.claim, outcome.seen(home, f.claim)) for f in result.conclusion.findings if f.claim is not None]
    true: list[_Ranged] = [(Claim(effect, values, ()), {}) for effect, values in truth]
    before = _squares(problem, ())
    found: dict[str, Any] = {
        "rows": len(problem.data),
        "residual": {
            "before": before,
            "after": _corrected(problem, claims) if claims else before,
            "oracle": _corrected(problem, true) if true else before,
        },
    }
    model = outcome.model_of(result.conclusion, result.recording, drd.__version__).terms
    path_m = {"before": _path_m(other, ())}
    path_m["after"] = _path_m(other, model) if model else path_m["before"]
    if not any(effect.id in HIDDEN for effect, _ in truth):
        path_m["oracle"] = _path_m(other, [_term(*pair) for pair in truth]) if truth else path_m["before"]
    return {**found, "path_m": path_m}


def _corrected(problem: Problem, claims: Sequence[_Ranged]) -> float:
    """Around the path as it is, or around the one without the claims: whichever is nearer to the truth."""
    return min(_squares(p, claims) for p in (problem, problem.around([claim for claim, _ in claims])))


def _squares(problem: Problem, claims: Sequence[_Ranged]) -> float:
    residual = problem.data - sum((_rows(problem, *ranged) for ranged in claims), np.zeros(len(problem.data)))
    return float(residual @ beyond(problem.nuisance, residual))


def _rows(problem: Problem, claim: Claim, seen: Seen) -> Array:
    """What a claim explains, its driver held to the range in which it was seen, as model.yaml has it."""
    if not seen:
        return problem.effect_rows([claim])
    held = copy(problem)
    held.signatures = copy(problem.signatures)
    held.signatures.motion = _within(problem.signatures.motion, seen)
    return held.whiten([held.signature(claim.effect, claim.values)])[:, 0]


def _within(m: Motion, seen: Seen) -> Motion:
    """The motion with drivers held to their ranges; the wheels' speeds follow."""
    for driver, ends in seen.items():
        low, high = (end * DRIVERS[driver].si for end in ends)
        if driver in ("time", "acceleration", "temperature"):
            name = {"time": "time_s", "acceleration": "acceleration_m_s2", "temperature": "temperature_c"}[driver]
            m = replace(m, **{name: np.clip(getattr(m, name), low, high)})
            continue
        v, w = m.speed_m_s, m.rate_rad_s
        if driver == "speed":
            v = np.clip(v, low, high)
        elif driver == "yaw_rate":
            w = np.clip(w, low, high)
        elif driver == "lateral_acceleration":
            w = np.divide(np.clip(v * w, low, high), v, out=w.copy(), where=np.abs(v) > SLOWEST_M_S)
        elif driver == "curvature":
            bend = np.abs(w) / np.maximum(np.abs(v), SLOWEST_M_S)
            v = np.copysign(np.abs(w) / np.clip(bend, max(low, SLOWEST_M_S), high), v)
        ahead, half_turn = v - m.speed_m_s, 0.5 * m.tread_m * (w - m.rate_rad_s)
        left, right = m.left_m_s + ahead - half_turn, m.right_m_s + ahead + half_turn
        m = replace(m, speed_m_s=v, rate_rad_s=w, left_m_s=left, right_m_s=right)
    return m


def _term(effect: Any, values: Any) -> Term:
    return Term(
        effect,
        {q.name: v if isinstance(v := values[q.name], str) else Amount(float(v) / q.si) for q in effect.parameters},
    )


def _path_m(recording: Recording, terms: Sequence[Term]) -> float:
    log = recording.reference
    assert log is not None
    rows = table(replay_folder(replace(recording, terms=tuple(terms))))
    x, y = (np.interp(log.time_s, rows[:, 0], rows[:, k]) for k in (1, 2))
    return math.sqrt(float(np.mean((x - log.x_m) ** 2 + (y - log.y_m) ** 2)))
