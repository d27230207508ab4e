"""Check signs, sides and units of a recording as `drd import` does: no physical effect inverts a sensor."""

from typing import Final

from drd.config.schema import ConfigError
from drd_tools.importing.checks import WRONG, Finding, mistaken_unit
from drd_tools.importing.examine import GyroRates, WheelTravel, examine
from drd_tools.recordings.folder import Recording

# By the first word of a check: file, key and expected convention (REP 103, and the names of the columns).
EXPECTED: Final = {
    "sign": ("fog.csv", "rate_deg_s", "a rate that is positive counter-clockwise"),
    "sides": ("encoders.csv", "", "the left wheel on the left, and both positive ahead"),
    "unit": ("", "", "rate_deg_s and heading_deg in degrees"),
}
MOST_LAG_S: Final = 1.0  # between two sensors: real references are up to 0.5 s late


def check_conventions(recording: Recording) -> None:
    """Check that all sensors turn the same way, in the same unit. Raises ConfigError if they certainly do not."""
    fog, log, nominal = recording.fog, recording.wheels, recording.nominal
    gyro = None if fog is None else GyroRates(fog.time_s, fog.rate_rad_s[:, None], ("z",))
    wheels = None
    if log is not None:
        left_m, right_m = (nominal.wheel_radius_m * angle for angle in recording.wheel_angles_rad())
        wheels = WheelTravel(log.time_s, left_m, right_m, nominal.tread_m)
    for finding in examine(gyro, wheels, recording.reference, axis=None, sign=1, max_lag_s=MOST_LAG_S).findings:
        what = finding.check.partition(",")[0]
        if finding.verdict == WRONG and what in EXPECTED and (what != "unit" or _is_in_another_unit(finding)):
            file, key, expected = EXPECTED[what]
            raise ConfigError(str(recording.folder / file), key, expected, finding.text)


def _is_in_another_unit(finding: Finding) -> bool:
    """Whether degrees were certainly taken for radians, or vice versa: a wrong wheel or tread gives another gain."""
    gain = abs(finding.numbers.get("gain", 0.0))
    return bool(mistaken_unit(gain, gain))
