"""Judge the wiring from the samples of both sensors: findings, each good, a fault or undetermined."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.samples import GyroSample, Side, WheelSample
from drd.units import RAD_PER_DEG
from drd.wiring import words
from drd.wiring.findings import Finding, Outcome, Statement, faults, unknown
from drd.wiring.fit import KNOWN, LEAST_RATIO, PLAUSIBLE_RATIO, Fit, fit, fit_senses, goes_with
from drd.wiring.hypotheses import Seen, Wiring, explanations
from drd.wiring.signals import dead_sides, gyro_alive, held
from drd.wiring.windows import Curve, Windows, common_windows, gyro_curve, lag, travels, unseen_m, wheel_curve

# Windows that turn by less say nothing about signs; all together must turn by the second.
WINDOW_TURN_RAD: Final = 5.0 * RAD_PER_DEG
ENOUGH_TURN_RAD: Final = 45.0 * RAD_PER_DEG
BLIND_TURN_RAD: Final = 180.0 * RAD_PER_DEG
BLIND_SHARE: Final = 0.1
# Another wiring's squared residual must be smaller by this factor than the configured one's, which slip may spoil.
CLEARLY: Final = 4.0
SLACK_RAD: Final = 15.0 * RAD_PER_DEG
# Below this explained share the wheels' turn is unrelated to the gyro's.
EXPLAINED: Final = 0.5
# Least ratio of net to gross motion at which it has a sign.
NET: Final = 0.6
ENOUGH_TREADS: Final = 2.0
# Least number of windows with motion; sigmas from fewer say little.
ENOUGH_WINDOWS: Final = 5
# One side's counts against the other's: equal within UNEQUAL, wrong beyond WRONG.
UNEQUAL: Final = 1.1
WRONG: Final = 1.25
# Gyro over wheels. A skid-steer robot's effective tread is 1.0 to 1.9 times the measured one; or the configuration has
# such a factor already, and the ground gives less of it.
SCRUB: Final = (1.0 / 1.9, 1.6)
EVEN: Final = (0.9, 1.1)
RATIO_SIGMA: Final = 0.1
# As estimation.reorder_s, beyond which the estimator continues without the late sensor.
LATE_S: Final = 0.25


@dataclass(frozen=True)
class Geometry:
    """The part of the configuration that the judgement needs."""

    tread_m: float
    resolution_m: float
    has_gyro: bool = True

    @property
    def still_m(self) -> float:
        """Travel of a wheel that stands: noise in the last digit, or a flexing axle."""
        return max(3.0 * self.resolution_m, 1e-3)


@dataclass(frozen=True)
class _Turns:
    """Angles of the windows, shape (n,) each, rad: the wheels' turn and travel over the tread, and the gyro's turn.

    `net_m`: travel of all samples, including those in no window; `unseen_m`: the most that it can lack.
    """

    turn: Array
    travel: Array
    gyro: Array
    tread_m: float
    net_m: float
    unseen_m: float

    @property
    def turned_rad(self) -> float:
        """Total turning seen by the gyro, to both sides."""
        return total(self.gyro)

    @property
    def are_few(self) -> bool:
        """Whether there are too few windows with motion to judge magnitudes."""
        moving = np.maximum(np.abs(self.turn), np.abs(self.travel)) > WINDOW_TURN_RAD
        return int(moving.sum()) < ENOUGH_WINDOWS


def total(angles: Array) -> float:
    """Sum of the absolute angles that exceed noise, rad."""
    size = np.abs(angles)
    return float(size[size > WINDOW_TURN_RAD].sum())


def judge(
    gyro: Sequence[GyroSample], wheels: Sequence[WheelSample], robot: Geometry, said: Statement | None = None
) -> list[Finding]:
    """All findings, in the order in which people look for them. Times must increase for each sensor.

    Equations (42) to (45). It takes about 0.1 s for an hour of samples.
    """
    said = said or Statement()
    if silent := words.no_data(gyro, wheels, robot.has_gyro):
        return silent
    zero_ns = wheels[0].t_ns
    wheel, turned = wheel_curve(wheels, zero_ns), gyro_curve(gyro, zero_ns) if robot.has_gyro else None
    windows = common_windows(turned, wheel, robot.still_m)
    findings = [words.data(gyro if robot.has_gyro else None, wheels)]
    if windows.left_m.size == 0:
        return [*findings, unknown("motion", "no two seconds without a gap", "Observe for longer.")]
    moving = dead_sides(travels(wheel), windows, robot.tread_m, robot.still_m, said, robot.has_gyro)
    alive = [gyro_alive(gyro, windows, said, robot.tread_m)] if robot.has_gyro else []
    findings += [moving, *alive, *(held(side, wheels, robot.resolution_m) for side in Side)]
    if moving.outcome is not Outcome.GOOD or faults(alive):
        return findings  # sensors that do not move cannot be compared
    return findings + _together(windows, turned, wheel, robot, said)


def _turns(windows: Windows, wheels: Curve, tread_m: float) -> _Turns:
    turn, travel = (windows.right_m - windows.left_m) / tread_m, (windows.right_m + windows.left_m) / tread_m
    net_m = 0.5 * float(wheels.sums[-1].sum())
    return _Turns(turn, travel, windows.gyro_rad, tread_m, net_m, unseen_m(wheels))


def _together(windows: Windows, gyro: Curve | None, wheels: Curve, robot: Geometry, said: Statement) -> list[Finding]:
    """Findings from both wheels and the gyro together."""
    turns = _turns(windows, wheels, robot.tread_m)
    if gyro is None:
        evidence = words.wheels_alone(turns.turn, turns.travel * turns.tread_m / 2.0)
        return [_directions(_stated(turns, said), said, evidence, robot), _distance(turns, said)]
    if turns.turned_rad < ENOUGH_TURN_RAD and not _gyro_is_small(turns):
        return _hardly_turned(turns, said)
    fits = fit_senses(turns.turn, turns.travel, turns.gyro)
    best = _way(fits)
    late = lag(gyro, wheels, 1.0 if best[0] else -1.0, 1.0)
    if late is not None:
        turns = _turns(common_windows(gyro, wheels, robot.still_m, late.lag_s), wheels, robot.tread_m)
        fits = fit_senses(turns.turn, turns.travel, turns.gyro)
        best = _way(fits)
    chosen = fits[best]
    explained = turns.travel if best[0] else turns.turn
    if 1.0 - chosen.cost / float(explained @ explained + 1e-12) < EXPLAINED:
        share = 1.0 - chosen.cost / float(turns.turn @ turns.turn + 1e-12)
        return [words.unrelated(turns.turned_rad, total(turns.turn), share), words.lag(late, LATE_S)]
    seen = Seen(one_inverted=best[0], opposite=best[1], gyro_turn=_sign(turns.gyro, said.turned))
    seen = _with_drive(seen, turns, said)
    found = [_directions(seen, said, words.compared(turns.turned_rad, chosen), robot)]
    if not best[0]:
        asymmetry = _asymmetry(turns, chosen)
        ratio = [] if asymmetry.outcome is Outcome.FAULT else [_ratio(chosen, turns, said)]
        found += [asymmetry, *ratio, _distance(turns, said)]
    return [*found, words.lag(late, LATE_S)]


def _gyro_is_small(turns: _Turns) -> bool:
    """Whether the gyro follows the wheels' turn, not their travel, though too small: its unit is wrong."""
    return goes_with(turns.turn, turns.gyro) and not goes_with(turns.travel, turns.gyro)


def _way(fits: dict[tuple[bool, bool], Fit]) -> tuple[bool, bool]:
    """The signs with the least residual, if clearly better than the configured ones; else those.  # (43)"""
    best, configured = min(fits, key=lambda way: fits[way].cost), (False, False)
    return best if fits[configured].cost > CLEARLY * fits[best].cost + SLACK_RAD**2 else configured


def _sign(motion: Array, stated: int) -> int | None:
    """Sign of the net motion relative to the user's statement, 1 if as stated; None without one or if it varied."""
    net, gross = float(motion.sum()), float(np.abs(motion).sum())
    return None if not stated or abs(net) < NET * gross else (1 if net * stated > 0.0 else -1)


def _with_drive(seen: Seen, turns: _Turns, said: Statement) -> Seen:
    """Add the sign of forward travel, if the robot drove far enough."""
    forward = turns.turn if seen.one_inverted else turns.travel
    if float(np.abs(forward).sum()) < 2.0 * ENOUGH_TREADS:
        return seen
    return replace(seen, wheel_travel=_sign(forward, said.drove))


def _stated(turns: _Turns, said: Statement) -> Seen:
    """Signs that the wheels alone show relative to the user's statement."""
    inverted: bool | None = None
    if not (said.drove and said.turned):
        turn, travel = (float(np.abs(x).sum()) for x in (turns.turn, turns.travel))
        if not (said.drove or said.turned) or max(turn, travel) <= ENOUGH_TREADS:
            return Seen()
        # A user who states one motion may have made the other, too: the stated one must be nearly absent.
        stated, other = (travel, turn) if said.drove else (turn, travel)
        inverted = True if stated < ENOUGH_TURN_RAD else False if stated > other else None
    turned = turns.travel if inverted else turns.turn
    wheel_turn = _sign(turned, said.turned) if turned.any() else None
    return _with_drive(Seen(one_inverted=inverted, wheel_turn=wheel_turn), turns, said)


def _directions(seen: Seen, said: Statement, evidence: str, robot: Geometry) -> Finding:
    """Judge the sensors' signs, and which side is which."""
    possible = explanations(seen, robot.has_gyro)
    if possible in ([], [Wiring()]):
        return words.directions_good(seen, said, evidence)
    return words.directions_fault(possible, seen, said, evidence)


def _hardly_turned(turns: _Turns, said: Statement) -> list[Finding]:
    """Findings when the gyro saw little turning: the wheels must not show much either."""
    ways = ((LEAST_RATIO, PLAUSIBLE_RATIO), (-PLAUSIBLE_RATIO, -LEAST_RATIO))
    straight = min((fit(turns.turn, turns.travel, turns.gyro, *way) for way in ways), key=lambda found: found.cost)
    claimed = turns.turn - straight.ratio * turns.gyro - straight.asymmetry * turns.travel
    if total(claimed) < max(BLIND_TURN_RAD, turns.turned_rad / BLIND_SHARE):
        rest = [_asymmetry(turns, straight)] if turns.travel.any() else []
        return [unknown("directions", words.turn_more(turns.turned_rad)), *rest, _distance(turns, said)]
    along, around = float(turns.travel @ turns.travel), float(turns.turn @ turns.turn)
    if along < around / CLEARLY**2 and not said.turned:
        seen = _with_drive(Seen(one_inverted=True), turns, said)
        return [words.claims_to_turn(total(turns.turn), turns.turned_rad, explanations(seen), said)]
    return [words.blind(total(claimed), turns.turned_rad, said)]


def _asymmetry(turns: _Turns, chosen: Fit) -> Finding:
    """Compare one side's counts with the other's.  # (44)"""
    k, sigma = chosen.asymmetry, chosen.asymmetry_sigma
    straight_m = float(np.abs(turns.travel).sum()) * turns.tread_m / 2.0
    if sigma > KNOWN or straight_m < ENOUGH_TREADS * turns.tread_m or turns.are_few:
        text = f"{straight_m:.2g} m forward, but for too short a time, or too little of it without turning"
        return unknown("left against right", text, "Drive straight ahead for ten seconds or more.")
    ratio, ratio_sigma = (1.0 + k) / (1.0 - k), 2.0 * sigma / (1.0 - k) ** 2
    size = max(ratio, 1.0 / ratio)
    wrong = size - 2.0 * ratio_sigma * size / ratio > WRONG
    return words.sides(ratio, ratio_sigma, straight_m, wrong=wrong, even=size < UNEQUAL)


def _ratio(chosen: Fit, turns: _Turns, said: Statement) -> Finding:
    """Judge the gyro's turn over the wheels': tread, or counts."""
    ratio = 1.0 / abs(chosen.ratio)
    sigma = chosen.ratio_sigma * ratio**2
    if sigma > RATIO_SIGMA * ratio or turns.are_few:
        text = f"gyro = {ratio:.2g} +- {sigma:.1g} times the wheels"
        return unknown(
            "turn ratio", text, "Turn more: on the spot, or in curves and with straight pieces between them."
        )
    lies = ratio + 2.0 * sigma < SCRUB[0] or ratio - 2.0 * sigma > SCRUB[1]
    confirmed = said.distance_m is not None and _distance(turns, said).outcome is Outcome.GOOD
    return words.ratio(ratio, sigma, turns.tread_m, lies=lies, even=EVEN[0] <= ratio <= EVEN[1], confirmed=confirmed)


def _distance(turns: _Turns, said: Statement) -> Finding:
    """Compare the distance driven with the user's tape measure."""
    return words.distance(abs(turns.net_m), turns.unseen_m, said.distance_m)
