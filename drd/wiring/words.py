"""Findings about gyro and wheels together, as sentences with numbers."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from drd.arrays import Array
from drd.samples import GyroSample, WheelSample
from drd.units import DEG_PER_RAD, NS_PER_S
from drd.wiring.findings import Finding, Statement, fault, good, unknown
from drd.wiring.fit import Fit
from drd.wiring.hypotheses import Seen, Wiring
from drd.wiring.windows import Lag

# Ratios of counts, and their likely causes.
CAUSES: Final = {
    4.0: "four counts per configured one: quadrature edges",
    2.0: "two counts per configured one: both edges, or quadrature",
    0.5: "half the configured counts: one edge instead of two",
    0.25: "a quarter of the configured counts: lines instead of quadrature edges",
    DEG_PER_RAD: "the factor between degrees and radians",
    1.0 / DEG_PER_RAD: "the factor between degrees and radians",
}
NEAR: Final = 0.12
NOTABLE_S: Final = 0.05
STRAIGHT: Final = "drive straight ahead and state --drove forward (or backward)"
LEFT: Final = "turn to the left and state --turned left (or right)"


def no_data(gyro: Sequence[GyroSample], wheels: Sequence[WheelSample], has_gyro: bool) -> list[Finding]:
    """Faults of the sensors that have sent no samples."""
    found = []
    if has_gyro and not gyro:
        found.append(fault("gyro", "no sample", "Is it powered, and are fog.port, fog.baud and fog.protocol correct?"))
    if not wheels:
        remedy = "Are the bus, its bit rate, encoders.layout and the node ids correct? Both sides must report."
        found.append(fault("encoders", "no sample of both wheels", remedy))
    return found


def data(gyro: Sequence[GyroSample] | None, wheels: Sequence[WheelSample]) -> Finding:
    """Number and rate of the samples."""
    parts = [_rate("wheel", wheels)] if gyro is None else [_rate("gyro", gyro), _rate("wheel", wheels)]
    return good("data", ", ".join(parts))


def _rate(name: str, samples: Sequence[Any]) -> str:
    span_s = (samples[-1].t_ns - samples[0].t_ns) / NS_PER_S
    rate = f" ({(len(samples) - 1) / span_s:.1f} Hz)" if span_s > 0.0 else ""
    return f"{len(samples)} {name} samples{rate}"


def compared(turned_rad: float, fit: Fit) -> str:
    """The evidence for the signs: the gyro's turn over the wheels'."""
    ratio = 1.0 / fit.ratio
    sigma = fit.ratio_sigma * ratio**2
    return f"over {turned_rad * DEG_PER_RAD:.0f} deg of turning, gyro = {ratio:+.3g} +- {sigma:.1g} times the wheels"


def wheels_alone(turn_rad: Array, travel_m: Array) -> str:
    """The evidence without a gyro: net motion."""
    net_deg, net_m = float(turn_rad.sum()) * DEG_PER_RAD, float(travel_m.sum())
    return f"net motion by the wheels: {net_m:+.2f} m forward, {net_deg:+.0f} deg to the left"


def directions_good(seen: Seen, said: Statement, evidence: str) -> Finding:
    """Finding without a contradiction; it asks for what only the user knows."""
    missing = _missing(seen, said)
    if seen.one_inverted is None and seen.opposite is None and len(missing) == 2:
        return unknown("directions", f"no gyro to compare with; {evidence}", f"To decide, {'; '.join(missing)}.")
    remedy = f"To rule out two faults that cancel each other, {'; '.join(missing)}." if missing else ""
    return good("directions", evidence, remedy)


def directions_fault(possible: list[Wiring], seen: Seen, said: Statement, evidence: str) -> Finding:
    """Fault of a reversed sensor or swapped sides; several explanations may be possible."""
    if seen.one_inverted:
        has_gyro = seen.opposite is not None
        sums = "sum follows the gyro, not their difference" if has_gyro else "sum moves as their difference should"
        what = f"the wheels' {sums}: one side counts backwards"
        evidence = evidence.replace("times the wheels", "times the wheels with one side reversed")
    elif seen.opposite:
        what = "gyro and wheels turn in opposite directions"
    else:
        what = "the motion of the wheels, or of gyro and wheels, contradicts your statements"
    missing = _missing(seen, said) if len(possible) > 1 else []
    decide = f" To decide, {'; '.join(missing)}." if missing else ""
    return fault("directions", f"{what}: {evidence}", f"{_either(possible)}{decide}")


def _missing(seen: Seen, said: Statement) -> list[str]:
    """Statements that the user has not yet made, or that the drive does not support."""
    missing = []
    if seen.wheel_travel is None:
        missing.append("drive straight one way only, the robot went back and forth" if said.drove else STRAIGHT)
    if seen.gyro_turn is None and seen.wheel_turn is None:
        missing.append("turn to one side only, the robot turned to both" if said.turned else LEFT)
    return missing


def _either(possible: list[Wiring]) -> str:
    texts = [f"{wiring.words()} ({_action(wiring)})" for wiring in possible]
    text = f"{'Either ' if len(texts) > 1 else ''}{', or '.join(texts)}."
    return text[0].upper() + text[1:]


def _action(wiring: Wiring) -> str:
    actions = ["change fog.positive"] * wiring.gyro + ["exchange encoders.left and encoders.right"] * wiring.swapped
    if wiring.left and wiring.right:
        actions.append("change reversed on both sides")
    elif wiring.left or wiring.right:
        side = "left" if wiring.left != wiring.swapped else "right"
        actions.append(f"change encoders.{side}.reversed")
    return ", ".join(actions)


def turn_more(turned_rad: float) -> str:
    """Evidence where the gyro turned too little to determine the signs."""
    return f"the gyro turned only {turned_rad * DEG_PER_RAD:.0f} deg: turn to the left, half a turn or more"


def claims_to_turn(wheels_rad: float, gyro_rad: float, possible: list[Wiring], said: Statement) -> Finding:
    """Fault if the wheels report pure turning and the gyro none."""
    text = f"the wheels turned {wheels_rad * DEG_PER_RAD:.0f} deg, the gyro {gyro_rad * DEG_PER_RAD:.0f} deg"
    sides = " or ".join(f"{wiring.words()} ({_action(wiring)})" for wiring in possible)
    if said.drove:
        return fault("directions", f"{text}, while you drove straight", f"One side is reversed: {sides}.")
    remedy = f"You drove straight and {sides}; or you turned, which the gyro does not measure (fog.axis, fog.protocol)"
    return fault("directions", text, f"{remedy}; or the wheels spun without ground contact. To decide, {STRAIGHT}.")


def blind(wheels_rad: float, gyro_rad: float, said: Statement) -> Finding:
    """Fault if the wheels turn and travel, and the gyro does not measure the turn."""
    text = f"the wheels turned {wheels_rad * DEG_PER_RAD:.0f} deg, the gyro {gyro_rad * DEG_PER_RAD:.0f} deg"
    remedy = "The gyro does not measure the turn: is it dead, is fog.axis the vertical one, is fog.protocol correct?"
    return fault("directions", text, remedy if said.turned else f"{remedy} Or the wheels spin without ground contact.")


def unrelated(gyro_rad: float, wheels_rad: float, share: float) -> Finding:
    """Finding if neither difference nor sum of the wheels correlates with the gyro."""
    text = (
        f"the gyro turned {gyro_rad * DEG_PER_RAD:.0f} deg, the wheels {wheels_rad * DEG_PER_RAD:.0f} deg, but only "
        f"{100.0 * max(share, 0.0):.0f} % of the wheels' turning is explained by the gyro's"
    )
    return unknown("directions", text, "Do gyro and encoders belong to the same robot, and do the wheels grip?")


def sides(ratio: float, sigma: float, straight_m: float, *, wrong: bool, even: bool) -> Finding:
    """The right side's counts over the left's, for the same distance."""
    text = f"over {straight_m:.1f} m forward, right = {ratio:.3f} +- {sigma:.3f} times left for the same distance"
    name = "left against right"
    if wrong:
        cause = _cause(ratio) or _cause(1.0 / ratio)
        remedy = f"One side's counts per revolution, gear or wheel differs{f' ({cause})' if cause else ''}."
        return fault(name, text, remedy)
    if even:
        return good(name, text)
    return unknown(name, text, "One wheel or gear differs slightly: run drd calibrate wheels.")


def ratio(ratio: float, sigma: float, tread_m: float, *, lies: bool, even: bool, confirmed: bool) -> Finding:
    """The gyro's turn over the wheels'."""
    text, name = f"gyro = {ratio:.3g} +- {sigma:.1g} times the wheels", "turn ratio"
    if lies:
        cause = _cause(1.0 / ratio)
        remedy = "Are counts_per_revolution (gear, quadrature), wheel radius, tread and the gyro's unit correct?"
        told = f" The wheels' turn is {1.0 / ratio:.3g} times the gyro's, perhaps {cause}." if cause else ""
        return fault(name, f"{text}: more than ground and tread can explain", f"{remedy}{told}")
    if even:
        return good(name, text)
    effective = f"robot.tread_m would be {tread_m / ratio:.3f} instead of {tread_m:.3f}"
    if confirmed:
        return good(name, f"{text}: scrubbing or tread, since the distance is correct", f"{effective}.")
    remedy = f"If tread, {effective}. If counts, the distance is wrong too: drive straight and state --distance METRES."
    return unknown(name, f"{text}: scrubbing or tread, or the counts per revolution of both sides", remedy)


def distance(distance_m: float, unseen_m: float, stated_m: float | None) -> Finding:
    """The wheels' distance against the tape's; up to `unseen_m` more may be in gaps of the wheels' samples."""
    name = "distance"
    if stated_m is None:
        text = f"{distance_m:.2f} m net by the wheels"
        return unknown(name, text, "Drive a measured distance straight and state --distance METRES.")
    least, most = distance_m / stated_m, (distance_m + unseen_m) / stated_m
    if most == 0.0:
        return fault(name, f"0 m by the wheels, {stated_m:.2f} m by the tape", "Do the counters count?")
    text = f"{distance_m:.2f} m by the wheels, {stated_m:.2f} m by the tape: {least:.3f} times"
    is_off = [abs(ratio - 1.0) > 0.1 for ratio in (least, most)]
    if not any(is_off):
        return good(name, text)
    if least <= 1.1 and most >= 0.9:
        text += f", but up to {unseen_m:.2f} m more may be in gaps of the encoders' frames"
        return unknown(name, text, "Find out why frames are missing, then drive the distance again.")
    cause = _cause(least) if not unseen_m else ""
    curves = " Or curves made the path longer than the tape: they count too." if least > 1.0 else ""
    return fault(name, text, f"Counts per revolution, gear or wheel radius{f': {cause}' if cause else ''}.{curves}")


def lag(found: Lag | None, late_s: float) -> Finding:
    """The sensor whose samples come late, and by how much."""
    if found is None:
        return unknown("timing", "the delay between the sensors is not observable", "Turn back and forth, with pauses.")
    who = "gyro behind the wheels" if found.lag_s >= 0.0 else "wheels behind the gyro"
    text = f"{who} by {abs(found.lag_s):.3f} +- {found.sigma_s:.3f} s"
    key = "fog.latency_s" if found.lag_s >= 0.0 else "encoders.latency_s"
    if abs(found.lag_s) - 2.0 * found.sigma_s < late_s:
        return good("timing", text, f"Raise {key} by this delay." if abs(found.lag_s) > NOTABLE_S else "")
    return fault("timing", text, f"Find what delays the data, or raise {key} and estimation.reorder_s.")


def _cause(factor: float) -> str:
    """Likely cause of a factor on the counts; empty where none is near."""
    near = min(CAUSES, key=lambda known: abs(np.log(factor / known)))
    return CAUSES[near] if abs(factor / near - 1.0) < NEAR else ""
