"""What an engineer knows of a robot before it has driven."""

import typing
from dataclasses import dataclass
from typing import Annotated, Final, Literal

import msgspec
import numpy as np

from drd.config.from_nominal import nominal_config
from drd.config.keys import Config, Encoders, Fog
from drd.config.nominal import Nominal
from drd.config.schema import ConfigError, is_nan, keys, nested

Drive = Literal["auto", "differential", "skid"]


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A robot with two driven sides, as its drawings and its sensors' data sheets have it. None: not known.

    Each value's name in robot.yaml is in its annotation. Sizes of a robot without encoders may be NaN.
    """

    wheel_radius_m: Annotated[float, "wheel.radius_m"]  # Rolling radius
    tread_m: Annotated[float, "tread_m"]  # Distance between left and right wheels
    # Counts of one turn of the wheel; None where the drive reports speed only
    counts_per_revolution: Annotated[float | None, "wheel.counts_per_revolution"] = None
    # How it steers: two wheels and casters, or sideways slip in each turn (four wheels, tracks); auto: found out
    drive: Annotated[Drive | None, "drive"] = None
    # Faster wheel travel is a counter's jump; None: 10 m/s
    max_speed_m_s: Annotated[float | None, "max_speed_m_s"] = None
    # How long it stands at first: the gyro's bias is measured then
    standstill_at_start_s: Annotated[float, "standstill_at_start_s"] = 0.0
    # The gyro's data sheet. kind "MEMS" stands for a MEMS gyro's noise where the sheet does not say; else a FOG's
    gyro_kind: Annotated[str | None, "fog.kind"] = None
    gyro_rate_hz: Annotated[float | None, "fog.rate_hz"] = None  # None: as the time tells
    gyro_range_deg_s: Annotated[float | None, "fog.range_deg_s"] = None  # Full scale
    gyro_angle_random_walk_deg_per_sqrt_h: Annotated[float | None, "fog.angle_random_walk_deg_per_sqrt_h"] = None
    gyro_bias_repeatability_deg_s: Annotated[float | None, "fog.bias_repeatability_deg_s"] = None
    gyro_bias_random_walk_deg_per_h_per_sqrt_h: Annotated[float | None, "fog.bias_random_walk_deg_per_h_per_sqrt_h"] = (
        None
    )
    gyro_resolution_deg_s: Annotated[float | None, "fog.resolution_deg_s"] = None
    encoders_rate_hz: Annotated[float | None, "encoders.rate_hz"] = None  # None: as the time tells
    # Noise of each wheel's travel: 0.0005 indoors, 0.005 off-road
    slip_noise_m_per_sqrt_m: Annotated[float | None, "encoders.slip_noise_m_per_sqrt_m"] = None
    # Standard deviations of a reference's coordinates and of its heading, for a diagnosis
    reference_position_sigma_m: Annotated[float | None, "reference.position_sigma_m"] = None
    reference_heading_sigma_deg: Annotated[float | None, "reference.heading_sigma_deg"] = None
    name: Annotated[str, "name"] = "robot"  # Of the robot or of its drive

    def nominal(self) -> Nominal:
        """The same as robot.yaml has it. Raises ConfigError where a value is not of its type or out of its range."""
        stated = {path: _plain(getattr(self, name)) for name, path in PATHS.items()}
        known = {path: value for path, value in stated.items() if value is not None and not is_nan(value)}
        try:
            return msgspec.convert(nested(known), Nominal)
        except msgspec.ValidationError as error:
            path = str(error).partition(" - at `$.")[2].rstrip("`")
            name = next(name for name, p in PATHS.items() if p == path)
            raise ConfigError("robot", name, dict(keys(Nominal))[path].expected, repr(known[path])) from error

    def config(self, *, has_gyro: bool = True) -> Config:
        """The configuration of an `Estimator` that is fed with samples. Raises ConfigError."""
        return nominal_config(self.nominal(), Fog.rate_hz if has_gyro else None, Encoders.rate_hz)


PATHS: Final[dict[str, str]] = {
    name: hint.__metadata__[0] for name, hint in typing.get_type_hints(Robot, include_extras=True).items()
}


def _plain(value: object) -> object:
    """Numbers of numpy as Python's."""
    return value.item() if isinstance(value, np.generic) else value
