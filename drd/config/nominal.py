"""robot.yaml: the nominal robot of a recording. NaN stands for what is not stated."""

import math
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from drd.config.schema import ConfigError, Loaded, keys, load


@dataclass(frozen=True, kw_only=True)
class Wheel:
    """Both wheels, as believed."""

    radius_m: Annotated[float, "m", Meta(ge=0.001, le=5)] = math.nan  # Rolling radius
    # Counts of one turn of the wheel; null where the drive reports speed only
    counts_per_revolution: Annotated[float, "1", Meta(ge=1e-3, le=1e9)] | None = None


@dataclass(frozen=True, kw_only=True)
class FogSheet:
    """The gyro as its data sheet describes it."""

    kind: str | None = None  # What kind of gyro, for people
    rate_hz: Annotated[float, "Hz", Meta(ge=1e-3, le=1e5)] | None = None  # Output rate
    range_deg_s: Annotated[float, "deg/s", Meta(ge=1e-3, le=1e5)] | None = None  # Full scale
    # Angle random walk
    angle_random_walk_deg_per_sqrt_h: Annotated[float, "deg/sqrt(h)", Meta(ge=0, le=1e3)] | None = None
    # Bias, switch-on to switch-on
    bias_repeatability_deg_s: Annotated[float, "deg/s", Meta(ge=0, le=1e3)] | None = None
    # Rate random walk
    bias_random_walk_deg_per_h_per_sqrt_h: Annotated[float, "deg/h/sqrt(h)", Meta(ge=0, le=1e6)] | None = None
    resolution_deg_s: Annotated[float, "deg/s", Meta(ge=0, le=1e3)] | None = None  # Resolution


@dataclass(frozen=True, kw_only=True)
class EncoderSheet:
    """The encoders and the ground, as believed."""

    kind: str | None = None  # What kind of encoder, for people
    rate_hz: Annotated[float, "Hz", Meta(ge=1e-3, le=1e5)] | None = None  # Output rate
    # Noise of each wheel's travel
    slip_noise_m_per_sqrt_m: Annotated[float, "m/sqrt(m)", Meta(ge=0, le=1)] | None = None


@dataclass(frozen=True, kw_only=True)
class ReferenceSheet:
    """How good the reference is."""

    position_sigma_m: Annotated[float, "m", Meta(ge=0, le=1e3)] | None = None  # Standard deviation of each coordinate
    heading_sigma_deg: Annotated[float, "deg", Meta(ge=0, le=180)] | None = None  # Standard deviation of the heading


@dataclass(frozen=True, kw_only=True)
class Nominal:
    """robot.yaml: what the robot's engineers believe."""

    name: str = "robot"  # Name of the recording or robot
    wheel: Wheel = Wheel()
    tread_m: Annotated[float, "m", Meta(ge=0.01, le=50)] = math.nan  # Distance between left and right wheels
    drive: Literal["auto", "differential", "skid"] | None = None  # How it steers; null: auto
    # Faster wheel travel is a counter's jump; null: far more than a robot's
    max_speed_m_s: Annotated[float, "m/s", Meta(ge=0.01, le=100)] | None = None
    fog: FogSheet = FogSheet()
    encoders: EncoderSheet = EncoderSheet()
    reference: ReferenceSheet = ReferenceSheet()
    standstill_at_start_s: Annotated[float, "s", Meta(ge=0, le=1e6)] = 0.0  # How long the robot stands at first


def load_nominal(file: Path, has_wheels: bool = True) -> Loaded[Nominal]:
    """Read robot.yaml. Without encoders nothing need be known of the wheels. Raises ConfigError."""
    loaded, meanings = load(file, Nominal), dict(keys(Nominal))
    for path in ("wheel.radius_m", "tread_m") if has_wheels else ():
        if math.isnan(attrgetter(path)(loaded.value)):
            raise ConfigError(str(file), path, meanings[path].expected, "nothing (the key is required)")
    return loaded
