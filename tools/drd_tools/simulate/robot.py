"""The robot that is simulated: robot.yaml, and the model file that says what it is beyond that."""

import dataclasses
from pathlib import Path
from typing import Final

import yaml

from drd.config.nominal import EncoderSheet, FogSheet, Nominal, ReferenceSheet, Wheel, load_nominal
from drd.effects.model import load_model
from drd_tools.simulate.sensors import Effects

# A small skid-steer robot with a gyro as in Table I of the paper (KVH RD2100) and a good laser tracker.
DEFAULT: Final = Nominal(
    name="simulated",
    wheel=Wheel(radius_m=0.11, counts_per_revolution=20000.0),
    tread_m=0.52,
    fog=FogSheet(
        rate_hz=10.0,
        range_deg_s=100.0,
        angle_random_walk_deg_per_sqrt_h=0.0833,
        bias_repeatability_deg_s=0.02,
        bias_random_walk_deg_per_h_per_sqrt_h=3.7,
        resolution_deg_s=0.004,
    ),
    encoders=EncoderSheet(rate_hz=20.0, slip_noise_m_per_sqrt_m=0.002),
    reference=ReferenceSheet(position_sigma_m=0.01, heading_sigma_deg=0.15),
    standstill_at_start_s=10.0,
)


def read_robot(robot: Path | None, model: Path | None) -> tuple[Nominal, Effects]:
    """The nominal robot (none given: DEFAULT) with the model file's keys, and its effects. Raises ConfigError."""
    nominal = DEFAULT if robot is None else load_nominal(robot).value
    if model is None:
        return nominal, ()
    found = load_model(model)
    return found.changed(nominal), tuple((term.effect, term.values()) for term in found.terms)


def robot_yaml(nominal: Nominal) -> str:
    """The text of robot.yaml."""
    rows = {k: v for k, v in dataclasses.asdict(nominal).items() if v is not None}
    plain = {
        k: {n: w for n, w in v.items() if w is not None} or None if isinstance(v, dict) else v for k, v in rows.items()
    }
    return "# What the robot's engineers believe: the nominal model of this recording.\n" + yaml.safe_dump(
        plain, sort_keys=False
    )
