"""The basis of learned values: with another geometry, calibration or model they do not apply."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, Final, NamedTuple

from drd.config.keys import Config
from drd.effects.model import Model
from drd.estimation.calibration import Calibration
from drd.estimation.estimate import is_stated_skid

WHEEL_KEYS: Final = (
    "robot.wheel_radius_m", "robot.left_scale", "robot.right_scale", "robot.tread_m",
    "encoders.layout", "encoders.counts_per_revolution",
    "encoders.left.node", "encoders.left.reversed", "encoders.left.message", "encoders.left.signal",
    "encoders.right.node", "encoders.right.reversed", "encoders.right.message", "encoders.right.signal",
    "encoders.odrive.message", "encoders.odrive.gear_ratio", "encoders.vesc.pole_pairs", "encoders.vesc.gear_ratio",
    "encoders.dbc.quantity", "encoders.dbc.speed_unit_m_s",
)  # fmt: skip
GYRO_KEYS: Final = (
    "fog.protocol", "fog.full_scale_deg_s", "fog.positive", "fog.axis", "fog.dsp3000.mode", "fog.dsp17xx.rotation",
    "fog.dsp17xx.angle_unit", "fog.ecore.temperature_byte", "fog.ecore.temperature_scale_c",
    "fog.ecore.temperature_offset_c", "fog.dsp17xx.temperature_scale_c",
)  # fmt: skip
LAG_KEYS: Final = (
    "encoders.latency_s", "encoders.layout", "fog.latency_s", "estimation.profile", "estimation.initial.wheel_lag_s",
)  # fmt: skip
DIGITS: Final = 16  # hexadecimal, 64 bits: no two of a robot's configurations collide by chance


@dataclass(frozen=True)
class Basis:
    """Values, by key path, on which the learned wheel scales and tread, gyro scale and bias, and wheel lag depend.
    The first files have neither `drive` nor `lag`.

    `wheels`, `gyro`: decoding and correction of their readings. `drive`: initial assumptions on scales and tread.
    `provenance`: that of calibration and model, for people; it is not compared.
    """

    wheels: dict[str, Any]
    gyro: dict[str, Any]
    provenance: dict[str, dict[str, str]]
    drive: dict[str, Any] = field(default_factory=dict)
    lag: dict[str, Any] = field(default_factory=dict)


class Changes(NamedTuple):
    """Differences by key; empty where the learned values still apply."""

    wheels: list[str]
    gyro: list[str]
    lag: list[str]


def basis_of(
    config: Config,
    calibration: Calibration | None,
    model: Model | None,
    estimates_scale: bool,
    encoder_file: str | None = None,
) -> Basis:
    """The basis of a configuration with the files that it names. `encoder_file`: the part of the encoders' layout that
    comes from a file.
    """
    in_model = _digest([(t.effect.id, sorted(t.parameters.items())) for t in model.terms]) if model else "none"
    wheels = {path: attrgetter(path)(config) for path in WHEEL_KEYS} | {"model": in_model}
    wheels["encoders.dbc.file"] = None if encoder_file is None else _digest(encoder_file)
    gyro = {path: attrgetter(path)(config) for path in GYRO_KEYS}
    gyro |= {"calibration": _calibration(calibration), "model": in_model, "gyro scale estimated": estimates_scale}
    sources = {"calibration": calibration, "model": model}
    provenance = {name: dict(x.provenance) for name, x in sources.items() if x is not None}
    drive: dict[str, Any] = {
        "robot.drive": "skid" if is_stated_skid(config) else config.robot.drive,
        "estimation.profile": config.estimation.profile,
    }
    lag = {path: attrgetter(path)(config) for path in LAG_KEYS} | {"model": in_model}
    return Basis(wheels, gyro, provenance, drive, lag)


def changes(then: Basis, now: Basis) -> Changes:
    """Differences that invalidate values learned with another basis."""
    wheels = _different(then.wheels, now.wheels) + _different(then.drive, now.drive)
    gyro, lag = _different(then.gyro, now.gyro), _different(then.lag, now.lag)
    was, by = then.gyro.get("fog.protocol"), now.gyro["fog.protocol"]
    if by not in ("none", was):  # without a gyro, what one has taught stays
        lag.append(f"fog.protocol changed from {was} to {by}")
        if was == "none":  # without a gyro, scales and tread are assumed to be better known
            wheels.append(lag[-1])
    return Changes(wheels, gyro, lag)


def _different(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Differences by key. A key missing from an earlier version's file is unchanged: an upgrade forgets nothing."""
    return [f"{path} changed from {value} to {now.get(path)}" for path, value in then.items() if value != now.get(path)]


def learned_anew(found: Changes) -> list[str]:
    """Sentences about the values that no longer apply."""
    parts = ("wheel scales and tread are", "the gyro's bias and scale are", "the wheels' lag is")
    return [f"{what} learned again, since {', '.join(f)}" for what, f in zip(parts, found, strict=True) if f]


def _calibration(c: Calibration | None) -> str:
    if c is None:
        return "none"
    return _digest([c.rows, c.rate_range_deg_s, c.temperature_range_c, c.residual_deg_s, c.covariance])


def _digest(values: Any) -> str:
    """Digest of numbers and names, so that comments and provenance in a file may change."""
    return f"sha256 {hashlib.sha256(repr(values).encode()).hexdigest()[:DIGITS]}"
