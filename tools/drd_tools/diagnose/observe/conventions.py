"""Check signs, sides, units and scale of a recording as `drd import` does: no physical effect inverts a sensor."""

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD
from drd_tools.calibrate.wheels.drive import MOST_LAG_S
from drd_tools.importing.checks import WRONG, Finding, mistaken_unit
from drd_tools.importing.examine import GyroRates, WheelTravel, examine
from drd_tools.recordings.folder import Recording

Complaint = tuple[str, str, str, str]  # file, key, what is expected, and what was found

# By the first word of a check: file, key and expected convention (REP 103, and the names of the columns).
EXPECTED: Final = {
    "sign": ("fog.csv", "rate_deg_s", "a rate that is positive counter-clockwise"),
    "heading": ("reference.csv", "heading_deg", "a heading that is positive counter-clockwise"),
    "sides": ("encoders.csv", "", "the left wheel on the left, and both positive ahead"),
    "unit": ("", "", "rate_deg_s and heading_deg in degrees"),
}
SPAN_S: Final = 2.0  # in which travel and displacement are compared: beyond four times that lag, and short in a turn
LEAST_M: Final = 0.2  # of displacement in a span, and the next beyond a reference's noise
LEAST_SIGMAS: Final = 20.0
FEWEST_SPANS: Final = 5
MOST_SCALE: Final = 1.6  # of the wheels' travel: radii are off by a tenth; a diameter for a radius is 2
MOST_OFFSET_DEG: Final = 15.0  # mounted by eye it is less, and the diagnosis is linear in it
ALIGNED: Final = 0.9  # resultant length of the directions: 25 deg of scatter


class Spans(NamedTuple):
    """Spans of a drive (n,): the travel of the middle and of the wheel that goes farther, the reference's displacement,
    and its direction, ahead or astern as the wheels drive, less the reference's heading.
    """

    travel_m: Array
    farther_m: Array
    displacement_m: Array
    direction_rad: Array


def check_conventions(recording: Recording) -> None:
    """Check that all sensors turn the same way, in the same unit, that wheels and reference go as far, and that the
    reference's heading is the robot's. Raises ConfigError if they certainly do not.
    """
    wheels = _wheels(recording)
    for file, key, expected, got in (*_turning(recording, wheels), *_driving(recording, wheels)):
        raise ConfigError(str(recording.folder / file), key, expected, got)


def _turning(recording: Recording, wheels: WheelTravel | None) -> Iterator[Complaint]:
    """Complaints about turns."""
    fog = recording.fog
    gyro = None if fog is None else GyroRates(fog.time_s, fog.rate_rad_s[:, None], ("z",))
    for finding in examine(gyro, wheels, recording.reference, axis=None, sign=1, max_lag_s=MOST_LAG_S).findings:
        what, text = finding.check.partition(",")[0], finding.text
        if what == "sign" and finding.numbers.get("correlation_wheels", 0.0) > 0.0:
            what, text = "heading", "one that turns against both gyro and wheels"
        if finding.verdict == WRONG and what in EXPECTED and (what != "unit" or _is_in_another_unit(finding)):
            yield *EXPECTED[what], text


def _driving(recording: Recording, wheels: WheelTravel | None) -> Iterator[Complaint]:
    """Complaints about distances and directions."""
    if (spans := _spans(recording, wheels)) is None:
        return
    # A dead counter halves the middle's travel, a turn adds to that of one wheel.
    middle, farther = (float(np.median(m / spans.displacement_m)) for m in (spans.travel_m, spans.farther_m))
    if middle > MOST_SCALE or 0.0 < farther < 1.0 / MOST_SCALE:
        got = f"{middle:.3g} times as much: check unit, radius_m and counts_per_revolution (gear, quadrature)"
        yield "encoders.csv", "", "travel as in reference.csv", got
    mean = np.exp(1j * spans.direction_rad).mean()
    offset_deg = -float(np.angle(mean)) * DEG_PER_RAD
    if abs(mean) > ALIGNED and abs(offset_deg) > MOST_OFFSET_DEG:
        got = f"one {offset_deg:+.0f} deg off the way its wheels drive it"
        yield "reference.csv", "heading_deg", "the robot's heading", got


def _wheels(recording: Recording) -> WheelTravel | None:
    log, nominal = recording.wheels, recording.nominal
    if log is None:
        return None
    left_m, right_m = (nominal.wheel_radius_m * angle for angle in recording.wheel_angles_rad())
    return WheelTravel(log.time_s, left_m, right_m, nominal.tread_m)


def _spans(recording: Recording, wheels: WheelTravel | None) -> Spans | None:
    """The spans in which the robot drives far enough; None if they are too few, or the reference is too sparse."""
    r = recording.reference
    if wheels is None or r is None or len(r.time_s) < FEWEST_SPANS or np.median(np.diff(r.time_s)) > SPAN_S:
        return None
    at_s = np.arange(max(wheels.time_s[0], r.time_s[0]), min(wheels.time_s[-1], r.time_s[-1]), SPAN_S)
    left_m, right_m = (np.diff(np.interp(at_s, wheels.time_s, m)) for m in (wheels.left_m, wheels.right_m))
    travel_m, farther_m = 0.5 * (left_m + right_m), np.maximum(np.abs(left_m), np.abs(right_m))
    step = np.diff(np.interp(at_s, r.time_s, r.x_m) + 1j * np.interp(at_s, r.time_s, r.y_m))
    heading_rad = np.interp(at_s[:-1] + 0.5 * SPAN_S, r.time_s, r.heading_rad)
    far = np.abs(step) > max(LEAST_M, LEAST_SIGMAS * (recording.nominal.reference_position_sigma_m or 0.0))
    if far.sum() < FEWEST_SPANS:
        return None
    turned = np.angle(step * np.exp(-1j * heading_rad) * np.where(travel_m < 0.0, -1.0, 1.0))
    return Spans(np.abs(travel_m[far]), farther_m[far], np.abs(step[far]), turned[far])


def _is_in_another_unit(finding: Finding) -> bool:
    """Whether degrees were certainly taken for radians, or vice versa: a wrong wheel or tread gives another gain."""
    gain = abs(finding.numbers.get("gain", 0.0))
    return bool(mistaken_unit(gain, gain))
