"""All checks of one import: from streams in SI units to findings."""

from dataclasses import dataclass, replace

from drd.arrays import Array
from drd.config.robot import MAX_SPEED_M_S
from drd_tools.importing.checks import (
    WRONG,
    Finding,
    check_offset,
    check_peak,
    check_speed,
    check_unit,
    find_axis,
    gravity,
    most_turning,
)
from drd_tools.importing.matching import Match, Turning, angle_of, match
from drd_tools.importing.signs import Witnesses, check_one_side, check_sides, check_sign, forward_share
from drd_tools.recordings.folder import ReferenceLog


@dataclass(frozen=True)
class GyroRates:
    """Rates about each axis, shape (n, k), with the accelerometer's readings, shape (n, 3), if there are any."""

    time_s: Array
    rate_rad_s: Array
    axes: tuple[str, ...]
    acceleration_m_s2: Array | None = None


@dataclass(frozen=True)
class WheelTravel:
    """Travel of each side since the first row, shape (n,), and the tread."""

    time_s: Array
    left_m: Array
    right_m: Array
    tread_m: float


@dataclass(frozen=True)
class Examined:
    """The findings, and the axis used for sign, unit and clock (None: no gyro, or no axis known)."""

    findings: list[Finding]
    axis: int | None


def examine(
    gyro: GyroRates | None,
    wheels: WheelTravel | None,
    reference: ReferenceLog | None,
    *,
    axis: str | None,
    sign: int,
    max_lag_s: float,
) -> Examined:
    """Run all checks on the data as the options state them. `axis`: None to find it from the data.

    `sign` (+1 or -1) is that applied to the gyro. Findings on units and clocks do not depend on the signs.
    """
    turned = None if wheels is None else Turning(wheels.time_s, (wheels.right_m - wheels.left_m) / wheels.tread_m)
    truth = None if reference is None else Turning(reference.time_s, reference.heading_rad)
    findings: list[Finding | None] = []
    chosen, gyro_turned, felt = None, None, None
    if gyro is not None:
        felt = gravity(gyro.acceleration_m_s2) if len(gyro.axes) == 3 else None
        names = gyro.axes
        turnings = [Turning(gyro.time_s, sign * angle_of(gyro.time_s, rate)) for rate in gyro.rate_rad_s.T]
        if len(names) == 1:
            chosen = 0
        else:
            found = _axis(gyro, turnings, turned, truth, max_lag_s)
            wanted = axis if axis is not None else found.proposal.get("axis")
            if axis is not None and found.proposal.get("axis", axis) != axis:
                found = replace(found, verdict=WRONG)
            findings.append(found)
            chosen = names.index(wanted) if wanted is not None else None
        gyro_turned = turnings[chosen] if chosen is not None else None
    seen = Witnesses(
        match(turned, gyro_turned, max_lag_s),
        match(truth, gyro_turned, max_lag_s),
        match(truth, turned, max_lag_s),
        sign * felt.sign if felt is not None and felt.axis == chosen else None,
        _forward(wheels, reference),
    )
    if gyro is not None and chosen is not None:
        findings += [check_sign(seen), check_peak(gyro.rate_rad_s[:, chosen])]
    if wheels is not None and (gyro_turned is not None or truth is not None):
        findings.append(_wheels(wheels, seen, truth, gyro_turned, max_lag_s))
    if wheels is not None:
        findings.append(check_speed(wheels.time_s, wheels.left_m, wheels.right_m, MAX_SPEED_M_S))
    findings += _units_and_clocks(seen, truth, turned, gyro_turned)
    return Examined([finding for finding in findings if finding is not None], chosen)


def _units_and_clocks(
    seen: Witnesses, truth: Turning | None, turned: Turning | None, gyro_turned: Turning | None
) -> list[Finding]:
    findings: list[Finding] = []
    if gyro_turned is not None and truth is not None:
        findings.append(check_unit(seen.gyro_reference, "gyro", "reference"))
        findings.append(check_offset(_turned_round(seen.gyro_reference), "reference", "gyro", "shift-reference"))
    if gyro_turned is not None and turned is not None:
        findings.append(check_unit(seen.gyro_wheels, "gyro", "wheels"))
        findings.append(check_offset(_turned_round(seen.gyro_wheels), "wheels", "gyro", "shift-wheels"))
    if turned is not None and truth is not None:
        findings.append(check_unit(seen.wheels_reference, "wheels", "reference"))
        # If there is a gyro, both are set to its clock.
        if gyro_turned is None:
            findings.append(check_offset(seen.wheels_reference, "wheels", "reference", "shift-wheels"))
    return findings


def _axis(
    gyro: GyroRates, turnings: list[Turning], turned: Turning | None, truth: Turning | None, max_lag_s: float
) -> Finding:
    felt = gravity(gyro.acceleration_m_s2)
    finding: Finding | None = None
    for name, other in (("reference", truth), ("wheels", turned)):
        if other is not None:
            finding = find_axis([match(other, t, max_lag_s) for t in turnings], gyro.axes, name, felt)
            if finding.numbers.get("correlation_" + finding.proposal.get("axis", ""), 0.0) != 0.0:
                return finding
    if finding is None:
        finding = find_axis([None] * len(turnings), gyro.axes, "wheels", felt)
    if finding.proposal or turned is not None or truth is not None:
        return finding
    return most_turning(gyro.rate_rad_s, gyro.axes)


def _wheels(
    wheels: WheelTravel, seen: Witnesses, truth: Turning | None, gyro_turned: Turning | None, max_lag_s: float
) -> Finding:
    seconds = float(wheels.time_s[-1] - wheels.time_s[0])
    mean_m_s = float(wheels.left_m[-1] + wheels.right_m[-1]) / 2.0 / seconds if seconds > 0.0 else 0.0
    other, name = (truth, "reference") if truth is not None else (gyro_turned, "gyro")
    assert other is not None
    total = Turning(wheels.time_s, (wheels.right_m + wheels.left_m) / wheels.tread_m)
    difference = seen.wheels_reference if truth is not None else seen.gyro_wheels
    return check_one_side(difference, match(other, total, max_lag_s), name) or check_sides(seen, mean_m_s)


def _forward(wheels: WheelTravel | None, reference: ReferenceLog | None) -> float | None:
    if wheels is None or reference is None:
        return None
    poses = (reference.time_s, reference.x_m, reference.y_m, reference.heading_rad)
    return forward_share(wheels.time_s, 0.5 * (wheels.left_m + wheels.right_m), poses)


def _turned_round(found: Match | None) -> Match | None:
    """Reverse the delay of a match, since the gyro's clock is kept."""
    if found is None:
        return None
    return replace(found, lag_s=-found.lag_s)
