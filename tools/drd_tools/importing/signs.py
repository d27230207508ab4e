"""Checks of signs and sides: whose turning or travel is reversed, as far as a third source can show."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from drd.arrays import Array
from drd_tools.importing.checks import OK, UNKNOWN, WRONG, Finding
from drd_tools.importing.matching import LEAST_CORRELATION, Match

# Least net share of travel along the reference's heading that determines a direction.
ONE_WAY: Final = 0.5
# Least excess of the sum's correlation with the robot's turning over the difference's.
CLEARLY_MORE: Final = 0.3
# Proposal that corrects the sign, whichever is set.
TURN_ROUND: Final = {"sign": "the other"}


@dataclass(frozen=True)
class Witnesses:
    """Evidence on signs; None where the data do not show them.

    `gyro_wheels`: the gyro's turning against the wheels'. `gyro_reference`, `wheels_reference`: against the
    reference's. `up`: by gravity, a turn to the left counts up (+1) or down. `forward`: the wheels' travel against
    the reference's along its own heading.
    """

    gyro_wheels: Match | None = None
    gyro_reference: Match | None = None
    wheels_reference: Match | None = None
    up: int | None = None
    forward: float | None = None


def check_sign(seen: Witnesses) -> Finding:
    """Check whether counter-clockwise is the gyro's positive. Wheels alone cannot show it, as they may be swapped."""
    numbers: dict[str, float] = {}
    votes: list[tuple[int, str]] = []
    for name, found in (("reference", seen.gyro_reference), ("wheels", seen.gyro_wheels)):
        if found is not None and found.is_clear:
            numbers[f"correlation_{name}"] = found.correlation
            votes.append((found.sign, f"correlation with the {name} {found.correlation:+.2f}"))
    if seen.up is not None:
        numbers["up"] = float(seen.up)
        votes.append((seen.up, f"by gravity, turning to the left counts {'up' if seen.up > 0 else 'down'}"))
    told = "; ".join(text for _, text in votes)
    is_sure = seen.up is not None or "correlation_reference" in numbers
    if not votes:
        return Finding("sign", UNKNOWN, "nothing in the data shows the gyro's sign", numbers)
    if len({sign for sign, _ in votes}) == 1:
        sign = votes[0][0]
        if sign > 0:
            doubt = "" if is_sure else " (unless the sides are swapped as well)"
            return Finding("sign", OK, f"counter-clockwise is positive: {told}{doubt}", numbers)
        if is_sure:
            return Finding("sign", WRONG, f"clockwise is positive: {told}", numbers, TURN_ROUND)
        text = f"gyro and wheels turn in opposite directions ({told}): the gyro's sign, or left and right swapped"
        return Finding("sign", UNKNOWN, text, numbers)
    return _disputed(votes, told, numbers)


def _disputed(votes: list[tuple[int, str]], told: str, numbers: dict[str, float]) -> Finding:
    """Resolve contradictory evidence: trust the reference and gravity, since the wheels may be wrong."""
    sure = {sign for sign, text in votes if "wheels" not in text}
    if len(sure) > 1:
        return Finding("sign", UNKNOWN, f"the evidence is contradictory, check both by hand: {told}", numbers)
    sign = sure.pop()
    verdict, words = (OK, "counter-clockwise") if sign > 0 else (WRONG, "clockwise")
    text = f"{words} is positive, and the wheels turn the wrong way: {told}"
    return Finding("sign", verdict, text, numbers, TURN_ROUND if sign < 0 else {})


def check_sides(seen: Witnesses, mean_forward_m_s: float) -> Finding:
    """Check whether left and right are swapped, or both wheels' signs are wrong.

    The reference shows it directly; otherwise a gyro whose sign is known from gravity. Swapped sides invert the yaw
    rate but not the speed; wrong signs invert both.
    """
    turning, by = _turning(seen)
    if turning is None:
        return Finding("sides", UNKNOWN, "neither a reference nor a gyro of known sign shows which side is left")
    numbers = {"turning": float(turning), "mean_speed_m_s": mean_forward_m_s}
    if seen.forward is not None:
        numbers["forward_share"] = seen.forward
    # Without a reference, assume that robots mostly drive forwards.
    told = f"mean speed {mean_forward_m_s:+.2f} m/s"
    ahead: float | None = mean_forward_m_s if turning < 0 else 1.0
    is_sure = seen.forward is not None and abs(seen.forward) > ONE_WAY
    if is_sure:
        ahead, told = seen.forward, f"travel along the reference's heading {seen.forward:+.2f} of the wheels' own"
    verdict, text, proposal = _sides(turning, ahead is not None and ahead > 0.0, is_sure)
    return Finding("sides", verdict, f"{text}, by {by}; {told}", numbers, proposal)


def _sides(turning: int, is_ahead: bool, is_sure: bool) -> tuple[str, str, dict[str, str]]:
    if turning > 0 and is_ahead:
        return OK, "left and right are as they should be", {}
    if turning > 0:
        text = (
            "the wheels turn the right way and run backwards: sides swapped and both signs wrong, or the reference's "
        )
        return UNKNOWN, text + "heading is half a turn off", {}
    if is_ahead:
        return WRONG, "left and right are swapped", {"swap": "yes"}
    if is_sure:
        return WRONG, "both wheels' signs are wrong", {"reverse": "both"}
    return UNKNOWN, "the wheels turn the wrong way and mostly run backwards: sides swapped, or both signs wrong", {}


def _turning(seen: Witnesses) -> tuple[int | None, str]:
    """Sign of the wheels' turning relative to the best evidence, and the name of the latter."""
    if seen.wheels_reference is not None and seen.wheels_reference.is_clear:
        return seen.wheels_reference.sign, f"the reference (correlation {seen.wheels_reference.correlation:+.2f})"
    if seen.up is not None and seen.gyro_wheels is not None and seen.gyro_wheels.is_clear:
        correlation = seen.up * seen.gyro_wheels.correlation
        return seen.up * seen.gyro_wheels.sign, f"the gyro, its sign by gravity (correlation {correlation:+.2f})"
    return None, ""


def check_one_side(difference: Match | None, total: Match | None, other: str) -> Finding | None:
    """Check whether one wheel's sign is wrong: then the robot's turning follows the sum of both, not their difference.

    `difference`, `total`: matches of right minus left, and right plus left, with `other`. None if all is well.
    """
    if total is None or not total.is_clear:
        return None
    rest = abs(difference.correlation) if difference is not None else 0.0
    # On a circle, speed and turning begin and end together: then the sum resembles the robot's turning too.
    if rest >= LEAST_CORRELATION or abs(total.correlation) - rest < CLEARLY_MORE:
        return None
    side = "left" if total.gain > 0.0 else "right"
    numbers = {"correlation_sum": total.correlation, "correlation_difference": rest}
    text = (
        f"one side's sign is wrong: the {other} go with the sum of both wheels (correlation {total.correlation:+.2f}) "
    )
    text += f"rather than with their difference ({rest:.2f}); the {side} one if the {other}'s sign is right"
    return Finding("one side", WRONG, text, numbers, {"reverse": side})


def forward_share(time_s: Array, travel_m: Array, reference: tuple[Array, Array, Array, Array]) -> float | None:
    """Signed ratio of the reference's travel along its own heading to the wheels' travel; None if they hardly move.

    `travel_m`: the wheels' mean travel since the start, shape (n,). `reference`: time_s, x_m, y_m, heading_rad.
    """
    at_s, x_m, y_m, heading = reference
    inside = (at_s >= time_s[0]) & (at_s <= time_s[-1])
    if inside.sum() < 3:
        return None
    at_s, x_m, y_m, heading = (column[inside] for column in (at_s, x_m, y_m, heading))
    middle = 0.5 * (heading[1:] + heading[:-1])
    along_m = np.diff(x_m) * np.cos(middle) + np.diff(y_m) * np.sin(middle)
    wheels_m = np.diff(np.interp(at_s, time_s, travel_m))
    # Position noise has no direction; weighting by the wheels' steps reduces it.
    square = float((wheels_m**2).sum())
    return float((along_m * wheels_m).sum()) / square if math.sqrt(square) > 0.01 else None
