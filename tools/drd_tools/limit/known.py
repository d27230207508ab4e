"""True noise and geometry of a recording, as well as they can be known. (62)"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from drd.config.keys import Config
from drd.config.schema import ConfigError
from drd.estimation.estimate import initial_sigmas
from drd.estimation.noise import NoiseProfile, make_noise
from drd.estimation.state import Sigmas
from drd.units import RAD_PER_DEG
from drd_tools.limit.drive import Drive
from drd_tools.recordings.folder import Recording
from drd_tools.simulate.files import TRUTH, read_truth

# A comparison without any noise would leave S at 0.
FINEST_RAD2: Final = 1e-14
# Travel of a window: long enough for slip to exceed the reference's noise, short enough for many windows.
WINDOW_TREADS: Final = 5.0
LEAST_WINDOWS: Final = 8
LEAST_FACTOR: Final = 1e-3  # anything smaller is indistinguishable from none
MEDIAN_PER_VARIANCE: Final = 0.4549  # median of chi-square with one degree of freedom
SLIP: Final = ("wheel_m2_per_m", "lateral_m2_per_m", "position_m2_per_rad", "turn_rad2_per_rad", "tread_m2_per_rad")


@dataclass(frozen=True)
class Known:
    """True noise, initial uncertainty, and a sentence on the origin of both."""

    noise: NoiseProfile
    sigmas: Sigmas
    basis: str


def known_of(recording: Recording, config: Config, drive: Drive) -> Known:
    """Noise and geometry from the recording's files: the datasheet if it states them, else as measured."""
    if recording.nominal.slip_noise_m_per_sqrt_m is not None and not _is_of_contacts(recording):
        return Known(*_datasheet(recording, config, drive), "noise of the datasheets, geometry known exactly")
    noise, how = drive.noise, "as learned on the way (sideways, and of the position in turns, as assumed)"
    if not drive.gyro_hz:
        noise = make_noise("physical", config.estimation.noise, drive.tread_m, drive.resolution_m)
        factor = slip_factor(recording, drive, noise)
        how = "as configured, since nothing shows it" if factor is None else "as the reference shows it"
        noise = replace(noise, **{name: (factor or 1.0) * getattr(noise, name) for name in SLIP})
    noise = replace(noise, comparison_rad2=max(noise.comparison_rad2, FINEST_RAD2))
    start = initial_sigmas(config, True)
    if recording.reference is not None and len(recording.reference.time_s) > 1:
        return Known(noise, fixed(start), f"noise {how}, geometry taken as known")
    return Known(noise, start, f"noise {how}, geometry as configured, for want of a reference")


def fixed(start: Sigmas) -> Sigmas:
    """Initial sigmas with all geometry known: only those of the pose and the gyro bias remain."""
    return Sigmas(start.position_m, start.heading_rad, 0.0, 0.0, 0.0, start.gyro_bias_rad_s)


def _datasheet(recording: Recording, config: Config, drive: Drive) -> tuple[NoiseProfile, Sigmas]:
    """Noise and initial sigmas that the datasheets state and the simulator has, and nothing else."""
    k = make_noise("physical", config.estimation.noise, drive.tread_m, drive.resolution_m)
    gyro, wheels, jitter_s = _conditions(recording)
    step_s = 1.0 / drive.gyro_hz if drive.gyro_hz else 0.0
    resolution = (recording.nominal.gyro_resolution_deg_s or 0.0) * RAD_PER_DEG
    noise = NoiseProfile(
        wheel_m2_per_m=k.wheel_m2_per_m * wheels**2,
        gyro_rad2_per_s=k.gyro_rad2_per_s * gyro**2 + resolution**2 / 12.0 * step_s,
        gyro_bias_rad2_s2_per_s=k.gyro_bias_rad2_s2_per_s * gyro**2,
        count_m2=k.count_m2,
        comparison_rad2=max(2.0 * k.count_m2 / drive.tread_m**2, FINEST_RAD2),
        timing_s2=2.0 * jitter_s**2,
    )
    start = fixed(initial_sigmas(config, True))
    return noise, replace(start, gyro_bias_rad_s=start.gyro_bias_rad_s * gyro)


def _is_of_contacts(recording: Recording) -> bool:
    """Whether slip and tread result from contact physics, so that robot.yaml does not state them."""
    truth = recording.folder / TRUTH
    return truth.is_file() and "world: mujoco" in truth.read_text(encoding="utf-8", errors="replace")


def _conditions(recording: Recording) -> tuple[float, float, float]:
    """Factors on the gyro and wheel noise, and the time stamps' jitter, of a simulated recording."""
    if not (recording.folder / TRUTH).is_file():
        return 1.0, 1.0, 0.0
    conditions: Any = read_truth(recording.folder).get("conditions", {})
    try:
        gyro, wheels, jitter_s = (float(conditions[name]) for name in ("gyro_noise", "wheel_noise", "jitter_s"))
    except (KeyError, TypeError, ValueError) as error:
        file = str(recording.folder / TRUTH)
        raise ConfigError(file, "conditions", "those that drd simulate writes", repr(error)) from error
    return gyro, wheels, jitter_s


def slip_factor(recording: Recording, drive: Drive, noise: NoiseProfile) -> float | None:
    """Factor of the wheels' variances relative to those stated, from the turns that a reference shows. (62)

    The reference's turn in each window is regressed on both wheels' travel, so that scales and tread do not matter.
    """
    log = recording.reference
    if log is None or len(log.time_s) < LEAST_WINDOWS:
        return None
    radius_m, time_s = recording.nominal.wheel_radius_m, recording.encoders.time_s
    inside = (log.time_s >= time_s[0]) & (log.time_s <= time_s[-1])
    at_s, heading_rad = log.time_s[inside], log.heading_rad[inside]
    ways = np.column_stack([radius_m * np.interp(at_s, time_s, angle) for angle in recording.wheel_angles_rad()])
    driven_m = np.cumsum(0.5 * np.abs(np.diff(ways, axis=0, prepend=ways[:1])).sum(axis=1))
    if not driven_m.size or driven_m[-1] < LEAST_WINDOWS * WINDOW_TREADS * drive.tread_m:
        return None
    ends = np.searchsorted(driven_m, np.arange(0.0, driven_m[-1], WINDOW_TREADS * drive.tread_m))
    turn, travel = np.diff(heading_rad[ends]), np.diff(ways[ends], axis=0)
    rest = turn - travel @ np.linalg.lstsq(travel, turn, rcond=None)[0]
    own = 2.0 * ((recording.nominal.reference_heading_sigma_deg or 0.0) * RAD_PER_DEG) ** 2
    stated = noise.wheel_m2_per_m * np.abs(travel).sum(axis=1) / drive.tread_m**2
    stated = stated + noise.turn_rad2_per_rad * np.abs(turn)
    degrees = (len(turn) - 2) / len(turn)
    found = float(np.median(rest * rest)) / MEDIAN_PER_VARIANCE / degrees - own
    return max(found / float(np.median(stated)), LEAST_FACTOR)
