"""robot.yaml: the nominal robot of a recording, and what a model file may state of it."""

import math
from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta


@dataclass(frozen=True, kw_only=True)
class Wheel:
    """Both wheels, as believed."""

    radius_m: Annotated[float, "m", Meta(ge=0.001, le=5)]  # Rolling radius
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
    wheel: Wheel
    tread_m: Annotated[float, "m", Meta(ge=0.01, le=50)]  # Distance between left and right wheels
    fog: FogSheet = FogSheet()
    encoders: EncoderSheet = EncoderSheet()
    reference: ReferenceSheet = ReferenceSheet()
    standstill_at_start_s: Annotated[float, "s", Meta(ge=0, le=1e6)] = 0.0  # How long the robot stands at first


@dataclass(frozen=True, kw_only=True)
class StatedWheel(Wheel):
    """Both wheels; nothing is required."""

    radius_m: Annotated[float, "m", Meta(ge=0.001, le=5)] = math.nan  # Rolling radius


@dataclass(frozen=True, kw_only=True)
class Stated(Nominal):
    """Keys of robot.yaml in a model. NaN stands for "not stated" and is never used."""

    wheel: StatedWheel = StatedWheel()
    tread_m: Annotated[float, "m", Meta(ge=0.01, le=50)] = math.nan  # Distance between left and right wheels


@dataclass(frozen=True, kw_only=True)
class AbsentWheel:
    """Wheels without encoders: nothing need be known of them."""

    radius_m: Annotated[float, "m", Meta(ge=0.001, le=5)] | None = None  # Rolling radius
    counts_per_revolution: Annotated[float, "1", Meta(ge=1e-3, le=1e9)] | None = None  # Counts of one turn of the wheel


@dataclass(frozen=True, kw_only=True)
class Wheelless:
    """robot.yaml of a recording without encoders: its keys, of which the wheels' may be null."""

    name: str = "robot"  # Name of the recording or robot
    wheel: AbsentWheel = AbsentWheel()
    tread_m: Annotated[float, "m", Meta(ge=0.01, le=50)] | None = None  # Distance between left and right wheels
    fog: FogSheet = FogSheet()
    encoders: EncoderSheet = EncoderSheet()
    reference: ReferenceSheet = ReferenceSheet()
    standstill_at_start_s: Annotated[float, "s", Meta(ge=0, le=1e6)] = 0.0  # How long the robot stands at first

    def nominal(self) -> Nominal:
        """The same as a nominal robot; NaN where nothing is known."""
        radius_m, tread_m = (math.nan if v is None else v for v in (self.wheel.radius_m, self.tread_m))
        values = {name: getattr(self, name) for name in ("name", "fog", "encoders", "reference")}
        wheel = Wheel(radius_m=radius_m, counts_per_revolution=self.wheel.counts_per_revolution)
        return Nominal(wheel=wheel, tread_m=tread_m, standstill_at_start_s=self.standstill_at_start_s, **values)
