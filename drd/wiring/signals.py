"""Checks of each sensor alone: a dead encoder, repeated values, a gyro whose reading never changes."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.samples import GyroSample, Side, WheelSample
from drd.units import DEG_PER_RAD
from drd.wiring.findings import Finding, Statement, fault, good, unknown
from drd.wiring.windows import Windows

# A dead counter may catch stray pulses: below this share of the other side's travel it counts as standing still.
STILL_SHARE: Final = 0.01
ENOUGH_M: Final = 0.5
ENOUGH_TREADS: Final = 2.0
TURNED_DEG: Final = 45.0
# A wheel that stands while the other turns is the centre of the circle: at least this share of the motion must then be
# turning, in this ratio to the gyro. Turning on the spot with a dead counter would give twice the turn.
PIVOT_EXPLAINED: Final = 0.9
PIVOT_RATIO: Final = (0.7, 2.0)
SAMPLES: Final = 20
# Counts per sample above which a step of zero is not slow motion.
FAST_COUNTS: Final = 5.0
HELD_SHARE: Final = 0.3
LONGEST_HELD: Final = 10
# Windows of the wheels' turn that differ by so much cannot have one rate; a rate below the second is no turning.
CHANGE_DEG: Final = 20.0
STILL_DEG_S: Final = 1.0


def dead_sides(
    travels_m: Array, windows: Windows, tread_m: float, still_m: float, said: Statement, has_gyro: bool
) -> Finding:
    """Whether both counters count; distinguish a dead one from a parked robot and a turn about the stationary wheel.

    `travels_m`: of both wheels, (k, 2), regardless of the gyro; `windows`: motion seen by both sensors.
    """
    sides = {side: travels_m[:, side.value] for side in Side}
    distance_m = {side: float(np.abs(steps).sum()) for side, steps in sides.items()}
    reach_m = {side: float(np.ptp(np.cumsum(np.append(0.0, steps)))) for side, steps in sides.items()}
    still = [side for side in Side if reach_m[side] <= max(still_m, STILL_SHARE * max(reach_m.values()))]
    distances = f"left moved {distance_m[Side.LEFT]:.2f} m, right {distance_m[Side.RIGHT]:.2f} m"
    if not still:
        return good("encoders", f"{distances}, forward plus backward")
    if len(still) == 2:
        return _parked(windows, distances, said)
    side, other = still[0], Side(1 - still[0].value)
    name = side.name.lower()
    text = f"{distances}: the {name} counter does not count"
    remedy = f"Check the {name} encoder's supply, cable and shaft, and encoders.{name}."
    if said.drove:
        return fault("encoders", f"{text} although you drove", remedy)
    seen_m = windows.left_m if other is Side.LEFT else windows.right_m
    if float(np.abs(seen_m).sum()) < max(ENOUGH_M, ENOUGH_TREADS * tread_m) or not has_gyro:
        return unknown("encoders", text, "Drive a few metres straight ahead and state --drove forward.")
    turn, gyro = seen_m / tread_m, np.abs(windows.gyro_rad)
    ratio = float(gyro @ np.abs(turn)) / float(gyro @ gyro + 1e-12)
    explained = 1.0 - float(((np.abs(turn) - ratio * gyro) ** 2).sum()) / float(turn @ turn)
    gyro_deg, turn_deg = float(gyro.sum()) * DEG_PER_RAD, float(np.abs(turn).sum()) * DEG_PER_RAD
    told = f"the wheels alone give {turn_deg:.0f} deg of turning, the gyro {gyro_deg:.0f} deg"
    if explained > PIVOT_EXPLAINED and PIVOT_RATIO[0] < ratio < PIVOT_RATIO[1]:
        pivot = f"{text}; {told}, which a turn about the {name} wheel would also give"
        return unknown("encoders", pivot, "Drive a few metres straight ahead.")
    return fault("encoders", f"{text} while the robot moves: {told}", remedy)


def _parked(windows: Windows, distances: str, said: Statement) -> Finding:
    turned_deg = float(np.abs(windows.gyro_rad).sum()) * DEG_PER_RAD
    if turned_deg < TURNED_DEG and not (said.drove or said.turned):
        told = f"{distances}, the gyro turned {turned_deg:.0f} deg: the robot is parked"
        return unknown("encoders", told, "Push or drive it: straight ahead, then to the left.")
    text = f"{distances}, while the gyro turned {turned_deg:.0f} deg"
    remedy = "Neither counter counts: are the encoders powered, and do their frames change?"
    if said.drove or said.turned:
        return fault("encoders", f"{text} and you stated that the robot moved", remedy)
    return unknown("encoders", f"{text}: both are dead, or the robot was turned with its wheels at rest", remedy)


def held(side: Side, samples: Sequence[WheelSample], resolution_m: float) -> Finding:
    """Whether the counter's value repeats in several samples while its wheel turns."""
    check = f"{side.name.lower()} values"
    column = 2 + side.value
    steps = np.abs(np.array([sample[column] for sample in samples]))
    moved = np.flatnonzero(steps > 0.01 * resolution_m)
    before, after, pause = steps[moved[:-1]], steps[moved[1:]], np.diff(moved) - 1
    # Around a held value the steps are similar and large; before and after a stop they are small.
    least, most = np.minimum(before, after), np.maximum(before, after)
    fast = (least >= FAST_COUNTS * resolution_m) & (least >= 0.5 * most) & (pause <= LONGEST_HELD)
    if fast.sum() < SAMPLES:
        return unknown(check, "the wheel hardly moved", "Drive for ten seconds or more.")
    share = float(pause[fast].sum() / (pause[fast] + 1).sum())
    text = f"{100.0 * share:.0f} % of the samples repeat the previous one while the wheel turns"
    if share < HELD_SHARE:
        return good(check, text)
    remedy = (
        "The device sends more often than it measures: make it measure faster, or send (encoders.rate_hz) less often."
    )
    return fault(check, text, remedy)


def gyro_alive(samples: Sequence[GyroSample], windows: Windows, said: Statement, tread_m: float) -> Finding:
    """Whether the gyro's reading varies at all."""
    rates: npt.NDArray[np.float64] = np.array([sample.rate_rad_s for sample in samples]) * DEG_PER_RAD
    low, high = float(rates.min()), float(rates.max())
    if len(rates) < SAMPLES:
        return unknown("gyro", f"only {len(rates)} samples", "Observe for longer.")
    if low < high:
        return good("gyro", f"rates from {low:+.3g} to {high:+.3g} deg/s")
    text = f"all {len(rates)} samples are {low:.4g} deg/s"
    turns_deg = (windows.right_m - windows.left_m) / tread_m * DEG_PER_RAD
    # With a low-noise gyro, a steady circle looks the same, so the turn must vary.
    if float(np.ptp(turns_deg)) > CHANGE_DEG or (said.turned and abs(low) < STILL_DEG_S):
        remedy = "The gyro is dead, or fog.protocol or fog.axis is wrong."
        wheels_deg = float(np.abs(turns_deg).sum())
        return fault("gyro", f"{text}, while the wheels turned {wheels_deg:.0f} deg, not steadily", remedy)
    return unknown("gyro", text, "Turn the robot: does the reading change?")
