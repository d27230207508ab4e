"""What learned values were learned with: with another geometry, calibration or model they do not apply."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final

from drd.config.keys import Config
from drd.effects.model import Model
from drd.estimation.calibration import Calibration

WHEEL_KEYS: Final = (
    "robot.wheel_radius_m", "robot.left_scale", "robot.right_scale", "robot.tread_m",
    "encoders.layout", "encoders.counts_per_revolution",
    "encoders.left.node", "encoders.left.reversed", "encoders.left.message", "encoders.left.signal",
    "encoders.right.node", "encoders.right.reversed", "encoders.right.message", "encoders.right.signal",
    "encoders.odrive.message", "encoders.vesc.pole_pairs", "encoders.vesc.gear_ratio",
    "encoders.dbc.quantity", "encoders.dbc.speed_unit_m_s",
)  # fmt: skip
GYRO_KEYS: Final = (
    "fog.protocol", "fog.full_scale_deg_s", "fog.positive", "fog.axis", "fog.dsp3000.mode", "fog.dsp17xx.rotation",
    "fog.dsp17xx.angle_unit", "fog.ecore.temperature_byte", "fog.ecore.temperature_scale_c",
    "fog.ecore.temperature_offset_c", "fog.dsp17xx.temperature_scale_c",
)  # fmt: skip
DIGITS: Final = 16  # hexadecimal, 64 bits: two of a robot's configurations do not meet by chance


@dataclass(frozen=True)
class Basis:
    """Values by the key's path, of all that wheel scales and tread, and the gyro's scale and bias, depend on.

    `provenance`: what calibration and model say of themselves, for people; it is not compared.
    """

    wheels: dict[str, Any]
    gyro: dict[str, Any]
    provenance: dict[str, dict[str, str]]


def basis_of(
    config: Config,
    calibration: Calibration | None,
    model: Model | None,
    estimates_scale: bool,
    encoder_file: str | None = None,
) -> Basis:
    """The basis of a configuration with the files that it names. `encoder_file`: what the encoders' layout takes from
    one.
    """
    in_model = _digest([(t.effect.id, sorted(t.parameters.items())) for t in model.terms]) if model else "none"
    wheels = {path: attrgetter(path)(config) for path in WHEEL_KEYS} | {"model": in_model}
    wheels["encoders.dbc.file"] = None if encoder_file is None else _digest(encoder_file)
    gyro = {path: attrgetter(path)(config) for path in GYRO_KEYS}
    gyro |= {"calibration": _calibration(calibration), "model": in_model, "gyro scale estimated": estimates_scale}
    sources = {"calibration": calibration, "model": model}
    return Basis(wheels, gyro, {name: dict(x.provenance) for name, x in sources.items() if x is not None})


def changes(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What is different, by key: empty where what was learned then applies now."""
    paths = dict.fromkeys((*then, *now))
    return [f"{p} was {then.get(p)}, is {now.get(p)}" for p in paths if then.get(p) != now.get(p)]


def learned_anew(wheels: Sequence[str], gyro: Sequence[str]) -> list[str]:
    """Sentences about what does not apply any more, from the changes of both."""
    parts = (("wheel scales and tread", wheels), ("the gyro's bias and scale", gyro))
    return [f"{what} are learned anew, since {', '.join(found)}" for what, found in parts if found]


def _calibration(c: Calibration | None) -> str:
    if c is None:
        return "none"
    return _digest([c.rows, c.rate_range_deg_s, c.temperature_range_c, c.residual_deg_s, c.covariance])


def _digest(values: Any) -> str:
    """Of numbers and names; comments and provenance in a file may change without making it another one."""
    return f"sha256 {hashlib.sha256(repr(values).encode()).hexdigest()[:DIGITS]}"
