"""A four-wheel skid-steer robot on frictional ground, as an MJCF model."""

from dataclasses import dataclass
from typing import Final

from drd_tools.mujoco_world.ground import Bump

WHEELS: Final = ("front_left", "front_right", "rear_left", "rear_right")
STEP_S: Final = 0.002

# The tyre: a spring and damper, and friction that is viscous up to its limit, in the "direct" format of MuJoCo's
# contacts (its documentation, "Solver parameters"). An EMPTY_KG robot sits about 2 mm deep and rocks at some 6 Hz.
# Pitfall: the impedance of a default contact is near 1. It makes a sliding wheel rise, more with friction, damping and
# sliding speed, so that a turning robot hops and its effective tread doubles; and a turning robot drifts outward by
# (centripetal acceleration / damping). An impedance near 0 nearly removes both.
EMPTY_KG: Final = 60.0
IMPEDANCE: Final = 0.02
STIFFNESS_PER_S2: Final = 1500.0
DAMPING_PER_S: Final = 50.0
TANGENTIAL_DAMPING_PER_S: Final = 5.0
TANGENTIAL_TO_NORMAL_IMPEDANCE: Final = 10.0
# Explicit integration requires less than 2 (wheel inertia + armature) / STEP_S = 130. Pitfall: MuJoCo's implicit
# integrators damp the wheel after solving the contact: an accelerating robot outruns its wheels by centimetres per s.
SERVO_NM_S_PER_RAD: Final = 60.0
ARMATURE_KG_M2: Final = 0.1


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """Sizes of a Clearpath Husky A200 (its public URDF); masses, motors and the centre of mass are assumed.

    The body frame is between the four wheels, on the ground. `centre_m`: centre of the chassis' mass in that frame;
    `payload_at_m`: place of the payload.
    """

    track_m: float = 0.5708
    wheelbase_m: float = 0.512
    wheel_radius_m: float = 0.1651
    tyre_width_m: float = 0.114
    chassis_kg: float = 50.0
    wheel_kg: float = 2.5
    centre_m: tuple[float, float, float] = (-0.02, 0.0, 0.21)
    payload_kg: float = 0.0
    payload_at_m: tuple[float, float, float] = (-0.15, 0.0, 0.45)
    torque_nm: float = 30.0

    @property
    def total_kg(self) -> float:
        """Chassis, wheels and payload."""
        return self.chassis_kg + 4.0 * self.wheel_kg + self.payload_kg

    @property
    def wheels_m(self) -> tuple[tuple[float, float], ...]:
        """Middle of each of WHEELS, forward and left."""
        a, c = 0.5 * self.wheelbase_m, 0.5 * self.track_m
        return (a, c), (a, -c), (-a, c), (-a, -c)


def scene_xml(vehicle: Vehicle, friction: float, bumps: tuple[Bump, ...] = ()) -> str:
    """Make the MJCF text: floor, bumps, robot."""
    v, tyre = vehicle, f'solimp="{IMPEDANCE} {IMPEDANCE} 0.001"'
    # MuJoCo's contact law is per mass; scaled this way, a loaded tyre deflects more, like a spring.
    per_mass = EMPTY_KG / v.total_kg
    spring = f'solref="{-STIFFNESS_PER_S2 * per_mass:.9g} {-DAMPING_PER_S * per_mass:.9g}"'
    tangential = f'solreffriction="0 {-TANGENTIAL_DAMPING_PER_S * per_mass:.9g}"'
    wheels, pairs, servos = "", "", ""
    for name, (x, y) in zip(WHEELS, v.wheels_m, strict=True):
        wheels += f"""
      <body name="{name}" pos="{x} {y} {v.wheel_radius_m}">
        <joint name="{name}" axis="0 1 0" armature="{ARMATURE_KG_M2}"/>
        <geom name="{name}" type="cylinder" size="{v.wheel_radius_m} {0.5 * v.tyre_width_m}" zaxis="0 1 0"
          mass="{v.wheel_kg}" contype="0" conaffinity="1" priority="1" friction="{friction} 0.005 0.0001"
          {spring} {tyre}/>
      </body>"""
        pairs += f"""
    <pair name="{name}" geom1="{name}" geom2="floor" condim="3" friction="{friction} {friction}"
      {spring} {tangential} {tyre}/>"""
        servos += f"""
    <velocity joint="{name}" kv="{SERVO_NM_S_PER_RAD}" forcerange="{-v.torque_nm} {v.torque_nm}"/>"""
    ground = "".join(
        f'\n    <geom type="ellipsoid" pos="{b.x_m:.6f} {b.y_m:.6f} 0" size="{b.radius_m:.6f} {b.radius_m:.6f} '
        f'{b.height_m:.6f}" contype="1" conaffinity="0"/>'
        for b in bumps
    )
    chassis = f'size="0.4 0.25 0.12" mass="{v.chassis_kg}" contype="0" conaffinity="0"'
    payload = (
        f'\n      <geom type="box" pos="{_triple(v.payload_at_m)}" size="0.12 0.12 0.12" mass="{v.payload_kg}" '
        'contype="0" conaffinity="0"/>'
        if v.payload_kg
        else ""
    )
    return f"""<mujoco model="skid steer">
  <option timestep="{STEP_S}" integrator="Euler" cone="elliptic" impratio="{TANGENTIAL_TO_NORMAL_IMPEDANCE}"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" contype="2" conaffinity="0"/>{ground}
    <body name="robot">
      <freejoint/>
      <geom type="box" pos="{_triple(v.centre_m)}" {chassis}/>{payload}{wheels}
    </body>
  </worldbody>
  <contact>{pairs}
  </contact>
  <actuator>{servos}
  </actuator>
</mujoco>
"""


def _triple(values: tuple[float, float, float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
