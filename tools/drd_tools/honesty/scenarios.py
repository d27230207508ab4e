"""Simulated robots and drives, drawn by seed for each scenario."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.config.keys import Encoders, Fog
from drd.config.robot import Robot, nominal_config
from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect, Values
from drd.effects.model import Amount, Term
from drd.estimation.estimate import initial_sigmas
from drd_tools.evaluate.trajectory import Reference
from drd_tools.honesty.configurations import as_simulated
from drd_tools.recordings.folder import Recording
from drd_tools.simulate import conditions
from drd_tools.simulate.conditions import Random, stream
from drd_tools.simulate.missions import Drive, make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.route import RATE_HZ, Steps
from drd_tools.simulate.simulator import Simulated, simulate
from drd_tools.simulate.truth import Truth, make_truth

# Two minutes: long enough for everything the filter learns, short enough for 300 seeds.
SECONDS: Final = 120.0
# Seed n drives number n modulo their count. Straights and bends, reversing, turns on the spot, weaving; the first and
# the last are cut off while the robot moves.
MISSIONS: Final = ("square-cw", "eights", "slalom", "warehouse")
HOUR_S: Final = 3600.0
# Sensor rates are at least half of this, and errors are smooth at this rate.
TRUTH_HZ: Final = 10
# First seed of the drives on which a simulated robot is calibrated.
OTHER_SEEDS: Final = 1_000_000
CALIBRATION_DRIVES: Final = 2
# In contact physics: bends, figures of eight, weaving, turns on the spot, after a standstill for the gyro bias.
CONTACT_MISSIONS: Final = ("square-ccw", "eights", "slalom", "umbmark-cw")
STAND_S: Final = 10.0

Draw = Callable[[Random], Mapping[str, Mapping[str, float | str]]]


@dataclass(frozen=True)
class Scenario:
    """A family of simulated drives. `draw`: effects by name, besides those that every robot is drawn with.

    `is_modelled`: the filter models all the physics, so its covariance must be neither too small nor too large.
    `gyro_noise`: white noise relative to that of robot.yaml. `stand_s`: standstill between two laps of eights.
    `rate_hz`: rate of both sensors, if not robot.yaml's. `seeds_share`: share of the seeds, if a drive takes long.
    """

    about: str
    draw: Draw = lambda _: {}
    is_modelled: bool = False
    gyro_noise: float = 1.0
    stand_s: float = 0.0
    rate_hz: float | None = None
    seeds_share: float = 1.0
    temperature: str = "warmup"


def _radius_tread(random: Random) -> Mapping[str, Mapping[str, float | str]]:
    left, right = random.normal(0.0, 0.01, 2).tolist()
    return {"wheel_radius_error": {"left": left, "right": right}, "tread_error": {"k": random.normal(0.0, 0.05)}}


def _gyro_scale_latency(random: Random) -> Mapping[str, Mapping[str, float | str]]:
    return {
        "gyro_scale_error": {"k": random.normal(0.0, 0.005)},
        "encoder_latency": {"delay": 0.0},
        "gyro_latency": {"delay": random.uniform(0.01, 0.1)},
    }


def _encoder_latency_slip(random: Random) -> Mapping[str, Mapping[str, float | str]]:
    begin_s = random.uniform(30.0, 90.0)
    left, right = random.uniform(0.02, 0.1, 2).tolist()
    return {
        "encoder_latency": {"delay": random.uniform(0.02, 0.2)},
        "gyro_latency": {"delay": 0.0},
        "surface_slip": {"t0": begin_s, "t1": begin_s + 10.0, "left": left, "right": right},
    }


def _lateral_terrain(random: Random) -> Mapping[str, Mapping[str, float | str]]:
    begin_s = random.uniform(20.0, 60.0)
    changed = {"tread": random.normal(0.0, 0.1), "gain": random.normal(0.0, 0.02)}
    return {
        "lateral_slip_turning": {"k": random.uniform(0.02, 0.15)},
        "terrain_tread": {"t0": begin_s, "t1": begin_s + 40.0, **changed},
    }


def _counts_temperature(random: Random) -> Mapping[str, Mapping[str, float | str]]:
    lost = {"fraction": random.uniform(0.002, 0.01), "speed": 0.8}
    return {
        "encoder_missed_counts": {"side": str(random.choice(["left", "right"])), **lost},
        "gyro_bias_temperature": {"b1": random.normal(0.0, 0.0003)},
    }


def _scrub_bumps_asymmetry(random: Random) -> Mapping[str, Mapping[str, float | str]]:
    return {
        "turn_scrub": {"k": random.uniform(0.02, 0.1)},
        "bump_counts": {"travel_per_m": random.uniform(0.001, 0.005)},
        "gyro_scale_asymmetry": {"k": random.normal(0.0, 0.001)},
    }


SCENARIOS: Final = {
    "plain": Scenario("no effect but what the prior has", is_modelled=True),
    "gyro noise x 3": Scenario("three times the angle random walk that robot.yaml states", is_modelled=True,
        gyro_noise=3.0),
    "an hour at rest": Scenario("an hour of standstill between two laps", is_modelled=True, stand_s=HOUR_S,
        rate_hz=5.0, seeds_share=0.1),
    "radii, tread": Scenario("radii 1 %, tread 5 % (1 sigma)", _radius_tread),
    "gyro scale, late gyro": Scenario("scale 0.5 % (1 sigma), gyro 0.01 to 0.1 s late", _gyro_scale_latency),
    "late wheels, slip": Scenario("wheels 0.02 to 0.2 s late, 10 s of 2 to 10 % slip", _encoder_latency_slip),
    "sideways slip, ground": Scenario("sideways slip 0.02 to 0.15 s, 40 s of ground: tread 10 %, gain 2 %",
        _lateral_terrain),
    "lost counts, warmth": Scenario("0.2 to 1 % of one side's counts above 0.8 m/s, bias 0.0003 deg/s/degC, 15 degC",
        _counts_temperature, temperature="rise"),
    "scrub, bumps, asymmetry": Scenario("tread 2 to 10 % larger on the spot, bumps 0.1 to 0.5 %, asymmetry 0.1 %",
        _scrub_bumps_asymmetry),
}  # fmt: skip
MUJOCO: Final = "mujoco"


@dataclass(frozen=True)
class Simulation:
    """A recording for the estimator, the true path, and the mission's name."""

    recording: Recording
    true: Reference
    mission: str


def simulation(name: str, seed: int, other: int | None = None) -> Simulation:
    """Drive a robot of the scenario `name`. The same arguments give the same bits.

    `other`: number of a further drive of the same robot: the next mission, other noise, the same effects.
    """
    scenario = SCENARIOS[name]
    number = seed if other is None else seed + 1 + other
    mission = "eights" if scenario.stand_s else MISSIONS[number % len(MISSIONS)]
    truth = make_truth(_drive(scenario, mission), scenario.temperature)
    random = stream(seed, f"robot of {name}")
    nominal = _nominal(scenario)
    effects = _effects(prior(nominal, random) | dict(scenario.draw(random)))
    walk = scenario.gyro_noise * (nominal.gyro_angle_random_walk_deg_per_sqrt_h or 0.0)
    louder = replace(nominal, gyro_angle_random_walk_deg_per_sqrt_h=walk)
    noise_seed = seed if other is None else OTHER_SEEDS * (1 + other) + seed
    simulated = simulate(truth, louder, effects, seed=noise_seed, name=f"{name}, seed {seed}")
    recording = replace(simulated.recording, nominal=nominal)
    return Simulation(recording, true_path(simulated), mission)


def _effects(stated: Mapping[str, Mapping[str, float | str]]) -> list[tuple[Effect, Values]]:
    """Effects with their values in SI; those whose values are all 0 are left out."""
    terms = [
        Term(catalogue()[name], {k: v if isinstance(v, str) else Amount(float(v)) for k, v in values.items()})
        for name, values in stated.items()
        if any(values.values())
    ]
    return [(term.effect, term.values()) for term in terms]


def _nominal(scenario: Scenario) -> Robot:
    if scenario.rate_hz is None:
        return DEFAULT
    return replace(DEFAULT, gyro_rate_hz=scenario.rate_hz, encoders_rate_hz=scenario.rate_hz)


def prior(nominal: Robot, random: Random) -> dict[str, Mapping[str, float | str]]:
    """Draw a robot from the sigmas of its configuration, as effects. The gyro bias is drawn by the simulator.

    A negative lag is the gyro's.
    """
    config = as_simulated(nominal_config(nominal, Fog.rate_hz, Encoders.rate_hz))
    sigma = initial_sigmas(config, estimates_gyro_scale=True)
    left, right, tread, scale, lag = random.standard_normal(5).tolist()
    lag_s = sigma.wheel_lag_s * lag
    return {
        "wheel_radius_error": {"left": sigma.wheel_scale * left, "right": sigma.wheel_scale * right},
        "tread_error": {"k": sigma.tread_m / nominal.tread_m * tread},
        "gyro_scale_error": {"k": sigma.gyro_scale * scale},
        "encoder_latency": {"delay": max(lag_s, 0.0)},
        "gyro_latency": {"delay": max(-lag_s, 0.0)},
    }


def _drive(scenario: Scenario, mission: str) -> Drive:
    """Drive the mission for SECONDS, or two laps with the scenario's standstill between them."""
    if not scenario.stand_s:
        return make_drive(mission, SECONDS)
    first = make_drive(mission)
    again = make_drive(mission, stand_s=0.0).steps
    still = np.zeros(round(scenario.stand_s * RATE_HZ))
    steps = (np.concatenate([a, still, b]) for a, b in zip(first.steps, again, strict=True))
    return Drive(Steps(*steps), 2)


def true_path(simulated: Simulated) -> Reference:
    """True path at TRUTH_HZ, and at the end."""
    truth: Truth = simulated.truth
    rows = np.unique(np.append(np.arange(0, len(truth.x_m), RATE_HZ // TRUTH_HZ), len(truth.x_m) - 1))
    pose = np.column_stack([truth.x_m, truth.y_m, truth.heading_rad])
    return Reference(simulated.recording.name, truth.time_s[rows], pose[rows])


def contact_simulation(seed: int) -> Simulation:
    """Drive a skid-steer robot in MuJoCo, with random load, friction and bumps. Needs the package mujoco."""
    from drd_tools.mujoco_world import sensors, world  # noqa: PLC0415  # an optional extra
    from drd_tools.mujoco_world.ground import Ground  # noqa: PLC0415
    from drd_tools.mujoco_world.vehicle import Vehicle  # noqa: PLC0415

    random = stream(seed, MUJOCO)
    vehicle = Vehicle(payload_kg=random.uniform(0.0, 30.0))
    ground = Ground(friction=random.uniform(0.4, 1.0), bumps_per_m=random.uniform(0.0, 0.5))
    mission = CONTACT_MISSIONS[seed % len(CONTACT_MISSIONS)]
    motion = world.drive(vehicle, ground, mission, SECONDS, STAND_S, seed)
    nominal = sensors.nominal_of(vehicle, f"{MUJOCO}, seed {seed}", STAND_S)
    readings = sensors.read_sensors(motion, conditions.Reference(), seed, nominal)
    pose = np.column_stack([motion.x_m, motion.y_m, motion.heading_rad])
    every = slice(None, None, world.ROW_HZ // TRUTH_HZ)
    return Simulation(readings.recording, Reference(MUJOCO, motion.time_s[every], pose[every]), mission)
