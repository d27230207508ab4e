"""Check that the sensors of a recording can be compared: overlapping in time, and in the stated units."""

import numpy as np

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd_tools.recordings.folder import Recording

# Limits for this percentile: anything faster is in another unit, since no gyro or robot reaches them.
MOST_DEG_S, MOST_M_S, USUAL_PERCENT = 5000.0, 100.0, 90.0


def check_comparable(recording: Recording) -> None:
    """Check that there are at least two sensors and that their times overlap. Raises ConfigError."""
    times = {"encoders.csv": recording.wheels, "fog.csv": recording.fog, "reference.csv": recording.reference}
    known = {name: log.time_s for name, log in times.items() if log is not None and len(log.time_s)}
    if len(known) < 2:
        alone = "wheels alone" if recording.wheels is not None else "a gyro alone"
        others = " or ".join(name for name in times if name not in known)
        expected = f"{others}: {alone} would have nothing to be compared with"
        raise ConfigError(str(recording.folder), "", expected, f"{next(iter(known), 'none of them')} only")
    (first, first_s), *others_s = known.items()
    for name, time_s in others_s:
        if time_s[0] > first_s[-1] or time_s[-1] < first_s[0]:
            expected = f"times that overlap {first}'s, {first_s[0]:.12g} to {first_s[-1]:.12g} s"
            got = f"{time_s[0]:.12g} to {time_s[-1]:.12g} s"
            raise ConfigError(str(recording.folder / name), "time_s", expected, got)
    _check_plausible(recording)


def _check_plausible(recording: Recording) -> None:
    """Check rates and speeds: values a thousand times too fast have the wrong unit. Raises ConfigError."""
    fog, wheels, reference = recording.fog, recording.wheels, recording.reference
    fastest: list[tuple[str, str, Array, float]] = []
    if fog is not None:
        fastest.append(("fog.csv", "rate_deg_s", np.degrees(fog.rate_rad_s), MOST_DEG_S))
    if wheels is not None:
        for side, angle in zip(("left", "right"), recording.wheel_angles_rad(), strict=True):
            speed = recording.nominal.wheel_radius_m * np.diff(angle) / np.diff(wheels.time_s)
            fastest.append(("encoders.csv", f"speed of the {side} wheel in m/s", speed, MOST_M_S))
    if reference is not None and len(reference.time_s) > 1:
        speed = np.hypot(np.diff(reference.x_m), np.diff(reference.y_m)) / np.diff(reference.time_s)
        fastest.append(("reference.csv", "speed in m/s", speed, MOST_M_S))
    for name, what, values, most in fastest:
        usual = float(np.percentile(np.abs(values), USUAL_PERCENT))
        if not usual <= most:
            expected = f"at most {most:g} in {USUAL_PERCENT:g} % of the rows"
            raise ConfigError(str(recording.folder / name), what, expected, f"{usual:.4g}")
