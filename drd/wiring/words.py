"""Findings about gyro and wheels together, in sentences with their numbers."""

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

# Ratios of counts, and what they are likely to be.
CAUSES: Final = {
    4.0: "four counts where one is configured: quadrature edges",
    2.0: "two counts where one is configured: both edges, or quadrature",
    0.5: "half the configured counts: one edge instead of two",
    0.25: "a quarter of the configured counts: lines instead of quadrature edges",
    DEG_PER_RAD: "the factor of degrees to radians",
    1.0 / DEG_PER_RAD: "the factor of degrees to radians",
}
NEAR: Final = 0.12
NOTABLE_S: Final = 0.05
STRAIGHT: Final = "drive straight ahead, then say --drove forward (or backward)"
LEFT: Final = "turn to the left, then say --turned left (or right)"


def no_data(gyro: Sequence[GyroSample], wheels: Sequence[WheelSample], has_gyro: bool) -> list[Finding]:
    """Faults of the sensors that have given nothing."""
    found = []
    if has_gyro and not gyro:
        found.append(fault("gyro", "no sample", "Is it powered, and are fog.port, fog.baud and fog.protocol right?"))
    if not wheels:
        remedy = "Are the bus, its speed, encoders.layout and the node ids right? Both sides must report."
        found.append(fault("encoders", "no sample of both wheels", remedy))
    return found


def data(gyro: Sequence[GyroSample] | None, wheels: Sequence[WheelSample]) -> Finding:
    """How many samples there are, and at which rate."""
    parts = [_rate("wheel", wheels)] if gyro is None else [_rate("gyro", gyro), _rate("wheel", wheels)]
    return good("data", ", ".join(parts))


def _rate(name: str, samples: Sequence[Any]) -> str:
    span_s = (samples[-1].t_ns - samples[0].t_ns) / NS_PER_S
    rate = f" ({(len(samples) - 1) / span_s:.1f} Hz)" if span_s > 0.0 else ""
    return f"{len(samples)} {name} samples{rate}"


def compared(turned_rad: float, fit: Fit) -> str:
    """The evidence for the senses."""
    ratio = 1.0 / fit.ratio
    sigma = fit.ratio_sigma * ratio**2
    return f"over {turned_rad * DEG_PER_RAD:.0f} deg of turning, gyro = {ratio:+.3g} +- {sigma:.1g} of the wheels"


def wheels_alone(turn_rad: Array, travel_m: Array) -> str:
    """The evidence without a gyro: net and, where it differs, gross motion."""
    net_deg, net_m = float(turn_rad.sum()) * DEG_PER_RAD, float(travel_m.sum())
    return f"the wheels say {net_m:+.2f} m forward and {net_deg:+.0f} deg to the left, net"


def directions_good(seen: Seen, said: Statement, evidence: str) -> Finding:
    """Finding without a contradiction; it asks for what only the user can tell."""
    missing = _missing(seen, said)
    if seen.one_inverted is None and seen.opposite is None and len(missing) == 2:
        return unknown("directions", f"no gyro to compare with; {evidence}", f"To decide, {'; '.join(missing)}.")
    remedy = f"That no two mistakes hide each other, only you can tell: {'; '.join(missing)}." if missing else ""
    return good("directions", evidence, remedy)


def directions_fault(possible: list[Wiring], seen: Seen, said: Statement, evidence: str) -> Finding:
    """Fault of what is the wrong way round, or of several things one."""
    if seen.one_inverted:
        has_gyro = seen.opposite is not None
        sums = "sum turns with the gyro, not their difference" if has_gyro else "sum moves as their difference should"
        what = f"the wheels' {sums}: one side counts backwards"
        evidence = evidence.replace("of the wheels", "of the wheels with one side turned round")
    elif seen.opposite:
        what = "gyro and wheels turn in opposite senses"
    else:
        what = "the wheels, or gyro and wheels together, move otherwise than you say"
    missing = _missing(seen, said) if len(possible) > 1 else []
    decide = f" To decide, {'; '.join(missing)}." if missing else ""
    return fault("directions", f"{what}: {evidence}", f"{_either(possible)}{decide}")


def _missing(seen: Seen, said: Statement) -> list[str]:
    """What the user has not said yet, or what the robot did otherwise."""
    missing = []
    if seen.wheel_travel is None:
        missing.append("drive straight one way only, it went to and fro" if said.drove else STRAIGHT)
    if seen.gyro_turn is None and seen.wheel_turn is None:
        missing.append("turn to one side only, it turned to both" if said.turned else LEFT)
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
    """Evidence where the gyro turned too little for the senses."""
    return f"the gyro turned only {turned_rad * DEG_PER_RAD:.0f} deg: turn to the left, half a turn or more"


def claims_to_turn(wheels_rad: float, gyro_rad: float, possible: list[Wiring], said: Statement) -> Finding:
    """Fault where the wheels say nothing but turning, and the gyro saw none."""
    text = f"the wheels turned {wheels_rad * DEG_PER_RAD:.0f} deg, the gyro {gyro_rad * DEG_PER_RAD:.0f} deg"
    sides = " or ".join(f"{wiring.words()} ({_action(wiring)})" for wiring in possible)
    if said.drove:
        return fault("directions", f"{text}, while you drove straight", f"One side is the wrong way round: {sides}.")
    remedy = f"You drove straight and {sides}; or you turned and the gyro does not see it (fog.axis, fog.protocol); or "
    return fault("directions", text, f"{remedy}the wheels spun without the ground. To decide, {STRAIGHT}.")


def blind(wheels_rad: float, gyro_rad: float, said: Statement) -> Finding:
    """Fault where the wheels turn and travel, and the gyro sees nothing of the turn."""
    text = f"the wheels turned {wheels_rad * DEG_PER_RAD:.0f} deg, the gyro {gyro_rad * DEG_PER_RAD:.0f} deg"
    remedy = "The gyro does not see the turning: is it dead, is fog.axis the vertical one, is fog.protocol right?"
    return fault("directions", text, remedy if said.turned else f"{remedy} Or the wheels spin without the ground.")


def unrelated(gyro_rad: float, wheels_rad: float, share: float) -> Finding:
    """Finding where neither difference nor sum of the wheels goes with the gyro."""
    text = (
        f"the gyro turned {gyro_rad * DEG_PER_RAD:.0f} deg, the wheels {wheels_rad * DEG_PER_RAD:.0f} deg, but only "
        f"{100.0 * max(share, 0.0):.0f} % of the wheels' turning goes with the gyro's"
    )
    return unknown("directions", text, "Do gyro and encoders belong to the same robot, do the wheels grip?")


def sides(ratio: float, sigma: float, straight_m: float, *, wrong: bool, even: bool) -> Finding:
    """The right side's counts over the left's, for the same way."""
    text = f"over {straight_m:.1f} m forward, right = {ratio:.3f} +- {sigma:.3f} of left for the same way"
    name = "left against right"
    if wrong:
        cause = _cause(ratio) or _cause(1.0 / ratio)
        remedy = f"One side's counts per revolution, gear or wheel differs{f' ({cause})' if cause else ''}."
        return fault(name, text, remedy)
    if even:
        return good(name, text)
    return unknown(name, text, "One wheel or gear differs a little: drd calibrate wheels.")


def ratio(ratio: float, sigma: float, tread_m: float, *, lies: bool, even: bool, confirmed: bool) -> Finding:
    """The gyro's turn over the wheels'."""
    text, name = f"gyro = {ratio:.3g} +- {sigma:.1g} of the wheels", "turn ratio"
    if lies:
        cause = _cause(1.0 / ratio)
        remedy = "Are counts_per_revolution (gear, quadrature), wheel radius, tread and the gyro's unit right?"
        told = f" {1.0 / ratio:.3g} times too much turn of the wheels may be {cause}." if cause else ""
        return fault(name, f"{text}: more than ground and tread can make", f"{remedy}{told}")
    if even:
        return good(name, text)
    effective = f"robot.tread_m would be {tread_m / ratio:.3f} instead of {tread_m:.3f}"
    if confirmed:
        return good(name, f"{text}: scrubbing or tread, since the distance is right", f"{effective}.")
    remedy = f"If tread, {effective}. If counts, the distance is wrong too: drive straight and say --distance METRES."
    return unknown(name, f"{text}: scrubbing or tread, or the counts per revolution of both sides", remedy)


def distance(distance_m: float, unseen_m: float, stated_m: float | None) -> Finding:
    """The wheels' distance against the tape measure's; up to `unseen_m` more may be in holes of the wheels' samples."""
    name = "distance"
    if stated_m is None:
        text = f"the wheels say {distance_m:.2f} m net"
        return unknown(name, text, "Drive a measured distance straight: --distance METRES.")
    least, most = distance_m / stated_m, (distance_m + unseen_m) / stated_m
    if most == 0.0:
        return fault(name, f"the wheels say 0 m, the tape {stated_m:.2f} m", "Do the counters count?")
    text = f"the wheels say {distance_m:.2f} m, the tape {stated_m:.2f} m: {least:.3f} times"
    is_off = [abs(ratio - 1.0) > 0.1 for ratio in (least, most)]
    if not any(is_off):
        return good(name, text)
    if least <= 1.1 and most >= 0.9:
        text += f", but up to {unseen_m:.2f} m more may be in gaps of the encoders' frames"
        return unknown(name, text, "Find out why frames are missing, then drive the distance again.")
    cause = _cause(least) if not unseen_m else ""
    curves = " Or curves made the way longer than the tape: they count, too." if least > 1.0 else ""
    return fault(name, text, f"Counts per revolution, gear or wheel radius{f': {cause}' if cause else ''}.{curves}")


def lag(found: Lag | None, late_s: float) -> Finding:
    """Which sensor's samples come late."""
    if found is None:
        return unknown("timing", "the delay between the sensors cannot be seen", "Turn to and fro, with pauses.")
    who = "gyro behind the wheels" if found.lag_s >= 0.0 else "wheels behind the gyro"
    text = f"{who} by {abs(found.lag_s):.3f} +- {found.sigma_s:.3f} s"
    key = "fog.latency_s" if found.lag_s >= 0.0 else "encoders.latency_s"
    if abs(found.lag_s) - 2.0 * found.sigma_s < late_s:
        return good("timing", text, f"Raise {key} by it." if abs(found.lag_s) > NOTABLE_S else "")
    return fault("timing", text, f"Find what holds the data back, or raise {key} and estimation.reorder_s.")


def _cause(factor: float) -> str:
    """What a factor on the counts is likely to be; empty where nothing is near."""
    near = min(CAUSES, key=lambda known: abs(np.log(factor / known)))
    return CAUSES[near] if abs(factor / near - 1.0) < NEAR else ""
