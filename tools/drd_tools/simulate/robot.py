"""The simulated robot: robot.yaml, and the model file with its deviations from that."""

from pathlib import Path
from typing import Final

import yaml

from drd.config.robot import Robot, load_robot
from drd.effects.model import load_model
from drd_tools.simulate.sensors import Effects

# A small skid-steer robot with a gyro as in Table I of the paper (KVH RD2100) and a good laser tracker.
DEFAULT: Final = Robot(
    name="simulated",
    wheel_radius_m=0.11,
    counts_per_revolution=20000.0,
    tread_m=0.52,
    gyro_rate_hz=10.0,
    gyro_range_deg_s=100.0,
    gyro_angle_random_walk_deg_per_sqrt_h=0.0833,
    gyro_bias_repeatability_deg_s=0.02,
    gyro_bias_random_walk_deg_per_h_per_sqrt_h=3.7,
    gyro_resolution_deg_s=0.004,
    encoders_rate_hz=20.0,
    slip_noise_m_per_sqrt_m=0.002,
    reference_position_sigma_m=0.01,
    reference_heading_sigma_deg=0.15,
    standstill_at_start_s=10.0,
)


def read_robot(robot: Path | None, model: Path | None) -> tuple[Robot, Effects]:
    """Read the nominal robot (DEFAULT if None), changed by the model file, and its effects. Raises ConfigError."""
    nominal = DEFAULT if robot is None else load_robot(robot).value
    if model is None:
        return nominal, ()
    found = load_model(model)
    return found.changed(nominal), tuple((term.effect, term.values()) for term in found.terms)


def robot_yaml(nominal: Robot) -> str:
    """Make the text of robot.yaml."""
    rows = {k: v for k, v in nominal.sections().items() if v is not None}
    plain = {
        k: {n: w for n, w in v.items() if w is not None} or None if isinstance(v, dict) else v for k, v in rows.items()
    }
    return "# What the robot's engineers believe: the nominal model of this recording.\n" + yaml.safe_dump(
        plain, sort_keys=False
    )
