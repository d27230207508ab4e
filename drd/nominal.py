"""robot.yaml: the nominal robot of a recording, and what a model file may state of it."""

import math
from dataclasses import dataclass

from drd.schema import REQUIRED, key, section


@dataclass(frozen=True, kw_only=True)
class Wheel:
    """Both wheels, as believed."""

    radius_m: float = key(REQUIRED, "Rolling radius", "m", low=0.001, high=5)
    counts_per_revolution: float | None = key(
        None, "Counts of one turn of the wheel; null where the drive reports speed only", "1", low=1e-3, high=1e9
    )


@dataclass(frozen=True, kw_only=True)
class FogSheet:
    """The gyro as its data sheet describes it."""

    kind: str | None = key(None, "What kind of gyro, for people")
    rate_hz: float | None = key(None, "Output rate", "Hz", low=1e-3, high=1e5)
    range_deg_s: float | None = key(None, "Full scale", "deg/s", low=1e-3, high=1e5)
    angle_random_walk_deg_per_sqrt_h: float | None = key(None, "Angle random walk", "deg/sqrt(h)", low=0, high=1e3)
    bias_repeatability_deg_s: float | None = key(None, "Bias, switch-on to switch-on", "deg/s", low=0, high=1e3)
    bias_random_walk_deg_per_h_per_sqrt_h: float | None = key(
        None, "Rate random walk", "deg/h/sqrt(h)", low=0, high=1e6
    )
    resolution_deg_s: float | None = key(None, "Resolution", "deg/s", low=0, high=1e3)


@dataclass(frozen=True, kw_only=True)
class EncoderSheet:
    """The encoders and the ground, as believed."""

    kind: str | None = key(None, "What kind of encoder, for people")
    rate_hz: float | None = key(None, "Output rate", "Hz", low=1e-3, high=1e5)
    slip_noise_m_per_sqrt_m: float | None = key(None, "Noise of each wheel's travel", "m/sqrt(m)", low=0, high=1)


@dataclass(frozen=True, kw_only=True)
class ReferenceSheet:
    """How good the reference is."""

    position_sigma_m: float | None = key(None, "Standard deviation of each coordinate", "m", low=0, high=1e3)
    heading_sigma_deg: float | None = key(None, "Standard deviation of the heading", "deg", low=0, high=180)


@dataclass(frozen=True, kw_only=True)
class Nominal:
    """robot.yaml: what the robot's engineers believe."""

    name: str = key("robot", "Name of the recording or robot")
    wheel: Wheel = section(Wheel)
    tread_m: float = key(REQUIRED, "Distance between left and right wheels", "m", low=0.01, high=50)
    fog: FogSheet = section(FogSheet)
    encoders: EncoderSheet = section(EncoderSheet)
    reference: ReferenceSheet = section(ReferenceSheet)
    standstill_at_start_s: float = key(0.0, "How long the robot stands at first", "s", low=0, high=1e6)


@dataclass(frozen=True, kw_only=True)
class StatedWheel(Wheel):
    """Both wheels; nothing is required."""

    radius_m: float = key(math.nan, "Rolling radius", "m", low=0.001, high=5)


@dataclass(frozen=True, kw_only=True)
class Stated(Nominal):
    """Keys of robot.yaml in a model. NaN stands for "not stated" and is never used."""

    wheel: StatedWheel = section(StatedWheel)
    tread_m: float = key(math.nan, "Distance between left and right wheels", "m", low=0.01, high=50)


@dataclass(frozen=True, kw_only=True)
class AbsentWheel:
    """Wheels without encoders: nothing need be known of them."""

    radius_m: float | None = key(None, "Rolling radius", "m", low=0.001, high=5)
    counts_per_revolution: float | None = key(None, "Counts of one turn of the wheel", "1", low=1e-3, high=1e9)


@dataclass(frozen=True, kw_only=True)
class Wheelless:
    """robot.yaml of a recording without encoders: its keys, of which the wheels' may be null."""

    name: str = key("robot", "Name of the recording or robot")
    wheel: AbsentWheel = section(AbsentWheel)
    tread_m: float | None = key(None, "Distance between left and right wheels", "m", low=0.01, high=50)
    fog: FogSheet = section(FogSheet)
    encoders: EncoderSheet = section(EncoderSheet)
    reference: ReferenceSheet = section(ReferenceSheet)
    standstill_at_start_s: float = key(0.0, "How long the robot stands at first", "s", low=0, high=1e6)

    def nominal(self) -> Nominal:
        """The same as a nominal robot; NaN where nothing is known."""
        radius_m, tread_m = (math.nan if v is None else v for v in (self.wheel.radius_m, self.tread_m))
        values = {name: getattr(self, name) for name in ("name", "fog", "encoders", "reference")}
        wheel = Wheel(radius_m=radius_m, counts_per_revolution=self.wheel.counts_per_revolution)
        return Nominal(wheel=wheel, tread_m=tread_m, standstill_at_start_s=self.standstill_at_start_s, **values)
