"""Physics: MuJoCo simulates the robot under the pilot's control."""

from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from tqdm import tqdm

from drd.arrays import Array, cumulative
from drd_tools.mujoco_world.ground import Friction, Ground, make_bumps
from drd_tools.mujoco_world.missions import legs_of, way_of
from drd_tools.mujoco_world.pilot import CONTROL_S, Pilot
from drd_tools.mujoco_world.vehicle import STEP_S, WHEELS, Vehicle, scene_xml

ROW_HZ: Final = 100
ROW_S: Final = 1.0 / ROW_HZ
STEPS_PER_ROW: Final = round(ROW_S / STEP_S)
ROWS_PER_CONTROL: Final = round(CONTROL_S / ROW_S)
LONGEST_LAP_S: Final = 3600.0


@dataclass(frozen=True)
class Motion:
    """The body frame (between the wheels, on the ground) and the wheels, every ROW_S, shape (n,) each.

    `speed_m_s`, `lateral_m_s` (left positive): of that frame's origin, along its own axes. `heading_rad` keeps whole
    turns. `gyro_rad`: integral of the rotation about the body's own vertical axis. `left_rad`, `right_rad`: mean angle
    of a side's two wheels. `friction`: mean of the coefficients under the four wheels.
    """

    time_s: Array
    x_m: Array
    y_m: Array
    heading_rad: Array
    gyro_rad: Array
    speed_m_s: Array
    lateral_m_s: Array
    left_rad: Array
    right_rad: Array
    friction: Array


def random_of(seed: int, source: int) -> np.random.Generator:
    """Make the random generator of one source."""
    return np.random.default_rng([seed, source])


def drive(vehicle: Vehicle, ground: Ground, mission: str, seconds: float | None, stand_s: float, seed: int) -> Motion:
    """Drive laps of `mission` for `seconds`, or one lap. The same arguments, MuJoCo and machine give the same bits.

    Raises RuntimeError if MuJoCo reports that the simulation is unstable.
    """
    bumps = make_bumps(ground.bumps_per_m, way_of(mission), random_of(seed, 1))
    model: Any = mujoco.MjModel.from_xml_string(scene_xml(vehicle, ground.friction, bumps))
    data: Any = mujoco.MjData(model)
    pilot = Pilot(legs_of(mission, stand_s, endless=seconds is not None), vehicle)
    friction = Friction(ground, random_of(seed, 2)) if ground.patch_friction is not None else None
    under = np.full(len(WHEELS), ground.friction)
    last = round((LONGEST_LAP_S if seconds is None else seconds) * ROW_HZ)
    poses, speeds, coefficients = [], [], []
    with tqdm(total=last if seconds is not None else None, unit="row", disable=None, leave=False) as bar:
        for row in range(last + 1):
            if row % ROWS_PER_CONTROL == 0:
                wheels = pilot.wheels_rad_s(float(data.qpos[0]), float(data.qpos[1]), float(_yaw_rad(data.qpos[3:7])))
                if wheels is None:
                    break
                data.ctrl[:] = (*wheels, *wheels)
                if friction is not None:
                    mujoco.mj_kinematics(model, data)
                    under = _lay(model, data, friction)
            poses.append(data.qpos.copy())
            speeds.append(data.qvel[:2].copy())
            coefficients.append(under.mean())
            mujoco.mj_step(model, data, STEPS_PER_ROW)
            bar.update()
    if any(warning.number for warning in data.warning):
        raise RuntimeError("MuJoCo reports an unstable simulation")
    return _motion(np.array(poses), np.array(speeds), np.array(coefficients))


def _lay(model: Any, data: Any, friction: Friction) -> Array:
    """Set each wheel's friction to that of its place; return the coefficients, shape (4,)."""
    under = friction.at(*np.array([data.geom(name).xpos[:2] for name in WHEELS]).T)
    for name, value in zip(WHEELS, under, strict=True):
        model.pair(name).friction[:2] = value
        model.geom(name).friction[0] = value
    return under


def _yaw_rad(quaternions: Array) -> Array:
    """Yaw of quaternions: shape (..., 4) to (...)."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def _motion(poses: Array, speeds: Array, friction: Array) -> Motion:
    heading = np.unwrap(_yaw_rad(poses[:, 3:7]))
    c, s = np.cos(heading), np.sin(heading)
    front_left, front_right, rear_left, rear_right = poses[:, 7:11].T
    return Motion(
        np.asarray(ROW_S * np.arange(len(poses))),
        poses[:, 0],
        poses[:, 1],
        heading,
        turned_about_own_axis_rad(poses[:, 3:7]),
        c * speeds[:, 0] + s * speeds[:, 1],
        c * speeds[:, 1] - s * speeds[:, 0],
        0.5 * (front_left + rear_left),
        0.5 * (front_right + rear_right),
        friction,
    )


def turned_about_own_axis_rad(quaternions: Array) -> Array:
    """Integral of the rate about the body's z axis, shape (n,), as measured by a strapdown gyro."""
    w, x, y, z = quaternions[:-1].T
    w2, x2, y2, z2 = quaternions[1:].T
    # Vector part of conj(q1) q2, and its scalar part; then the rotation vector.
    vector = np.array([
        w * x2 - x * w2 - y * z2 + z * y2,
        w * y2 + x * z2 - y * w2 - z * x2,
        w * z2 - x * y2 + y * x2 - z * w2,
    ])  # fmt: skip
    scalar = w * w2 + x * x2 + y * y2 + z * z2
    length = np.sqrt(np.square(vector).sum(axis=0))
    angle_per_length = np.where(length > 1e-12, 2.0 * np.arctan2(length, scalar) / np.maximum(length, 1e-12), 2.0)
    return cumulative(angle_per_length * vector[2])
