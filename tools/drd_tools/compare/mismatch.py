"""Recorded minus simulated sensor increments of each channel, step by step."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.effects.chain import add
from drd.effects.effect import Errors
from drd.effects.model import Term
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.error_model.path import Path, within_steps
from drd_tools.diagnose.error_model.sensitivities import Sensitivities
from drd_tools.diagnose.observe.evidence import Evidence

# Errors of a reference that are no fault of the robot: prior sigmas, as in the diagnosis.
LATENCY_S: Final = 0.010
YAW_DEG: Final = 2.0
SIDEWAYS_M: Final = 0.05


@dataclass(frozen=True)
class Kind:
    """A channel. `angle`: its increments are rad, else m. `reference`, `gyro`: whether it needs one."""

    id: str
    title: str
    angle: bool
    reference: bool
    gyro: bool
    text: str


KINDS: Final = (
    Kind("gyro", "gyro", True, True, True, "the gyro's turn less the reference's"),
    Kind("wheels_gyro", "wheels' turn against gyro", True, False, True, "the turn by the wheels less the gyro's"),
    Kind("wheels_turn", "wheels' turn", True, True, False, "the turn by the wheels less the reference's"),
    Kind("distance", "distance", False, True, False, "mean travel of both wheels less the reference's travel ahead"),
    Kind("left", "left wheel", False, True, False, "travel that the left counter told less what the path asks for"),
    Kind("right", "right wheel", False, True, False, "travel that the right counter told less what the path asks for"),
    Kind("sideways", "sideways", False, True, False, "the reference's travel to the left, none by the model"),
)


def kinds_of(e: Evidence) -> list[Kind]:
    """Channels that a recording has."""
    has_gyro, has_reference = e.gyro_rad is not None, len(e.fix) > 1
    return [k for k in KINDS if (has_gyro or not k.gyro) and (has_reference or not k.reference)]


@dataclass(frozen=True)
class Standstill:
    """Gyro bias measured in the standstill at the start, and the time of the measurement; 0 and 0 if there is none."""

    bias_rad_s: float
    seen_s: float


def standstill(e: Evidence, effects_rad: Array | float = 0.0) -> Standstill:
    """Measure the bias once, as the estimator does. `effects_rad` (n,): the model's part of the gyro's increments."""
    if e.gyro_rad is None:
        return Standstill(0.0, 0.0)
    still = e.travel_m == 0.0
    still[1:] &= e.travel_m[:-1] == 0.0
    known = still & (e.time_s < e.time_s[0] + e.standstill_s)
    seen_s = float(e.step_s[known].sum())
    if seen_s == 0.0:
        return Standstill(0.0, 0.0)
    return Standstill(float((e.gyro_rad - effects_rad)[known].sum()) / seen_s, seen_s)


def modelled(e: Evidence, path: Path, terms: Sequence[Term]) -> Sensitivity:
    """Increments that a model's effects add along the path."""
    if not terms:
        return Sensitivity()
    sensitivities = Sensitivities.on(e, path)
    bias_rad_s = standstill(e).bias_rad_s  # limits and dead bands act on the sum of rate and bias
    motion = replace(sensitivities.motion, rate_rad_s=sensitivities.motion.rate_rad_s + bias_rad_s)
    changed, lateral_m_s = add(motion, [(term.effect, term.values()) for term in terms])
    return sensitivities.of(
        Errors(
            changed.rate_rad_s - motion.rate_rad_s,
            changed.left_m_s - motion.left_m_s,
            changed.right_m_s - motion.right_m_s,
            lateral_m_s,
        )
    )


def mismatches(e: Evidence, path: Path, model: Sensitivity, bias_rad_s: float) -> dict[str, Array]:
    """Recorded minus simulated increments of each channel, (n,) each, rad or m. (65)"""
    forward, sideways, turn = path.steps()
    half = 0.5 * e.tread_m
    shorter, aside = within_steps(e, turn)
    left = e.left_m + shorter - (forward - half * turn) - model.left_m
    right = e.right_m + shorter - (forward + half * turn) - model.right_m
    wheels_turn = (right - left) / e.tread_m
    found = {
        "left": left,
        "right": right,
        "distance": 0.5 * (left + right),
        "wheels_turn": wheels_turn,
        "sideways": sideways - aside - model.lateral_m,
    }
    if e.gyro_rad is not None:
        found["gyro"] = e.gyro_rad - bias_rad_s * e.step_s - turn - model.gyro_rad
        found["wheels_gyro"] = wheels_turn - found["gyro"]
    return found


def white(e: Evidence) -> dict[str, Array]:
    """Variance of each channel's increments by the datasheets, (n,) each, without the reference's."""
    sheet, D = e.datasheet, e.tread_m
    slip2 = sheet.slip_m_per_sqrt_m**2
    found = {
        "left": slip2 * np.abs(e.left_m),
        "right": slip2 * np.abs(e.right_m),
        "distance": 0.25 * slip2 * e.travel_m,
        "wheels_turn": slip2 * e.travel_m / D**2,
        "sideways": 0.5 * sheet.lateral_m_per_sqrt_m**2 * e.travel_m,
    }
    if e.gyro_rad is not None:
        found["gyro"] = sheet.gyro(e)
        found["wheels_gyro"] = found["wheels_turn"] + found["gyro"]
    return found


@dataclass(frozen=True)
class ReferenceError:
    """An error of the reference. `sigma`: its prior, in `unit`."""

    name: str
    sigma: float
    unit: str


LATE: Final = ReferenceError("late", 1000.0 * LATENCY_S, "ms")
TURNED: Final = ReferenceError("turned", YAW_DEG, "deg")
DISPLACED: Final = ReferenceError("displaced to the left", 100.0 * SIDEWAYS_M, "cm")


def reference_errors(e: Evidence, path: Path) -> dict[str, list[tuple[ReferenceError, Array]]]:
    """Changes of the increments, (n,) each, by one sigma of the reference's lag, rotation and displacement."""
    if not len(e.fix):
        return {}
    forward, _, turn = path.steps()
    late_turn, late_m = (LATENCY_S * _change(travel, e.step_s) for travel in (turn, forward))
    half = 0.5 * e.tread_m
    lever = (DISPLACED, SIDEWAYS_M * turn)
    return {
        "gyro": [(LATE, late_turn)],
        "wheels_turn": [(LATE, late_turn)],
        "distance": [(LATE, late_m), lever],
        "left": [(LATE, late_m - half * late_turn), lever],
        "right": [(LATE, late_m + half * late_turn), lever],
        "sideways": [(TURNED, -np.radians(YAW_DEG) * forward)],
    }


def _change(travel: Array, step_s: Array) -> Array:
    """Change of the rate over each step, (n,); the rate at an edge is the mean of both neighbours'."""
    rate = travel / step_s
    edges = np.concatenate([rate[:1], 0.5 * (rate[1:] + rate[:-1]), rate[-1:]])
    return np.diff(edges)
