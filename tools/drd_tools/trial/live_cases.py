"""Drives on which an effect begins in mid-run, the ground changes, or nothing happens: drawn by name and seed."""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from msgspec import Struct

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd.effects.effect import Begins, Chance, Effect, Errors, Parameter, Values
from drd.effects.motion import Motion
from drd.monitor.constants import CHANGE_S, KNOWN_SIGMAS, stated_constants
from drd.monitor.library import CHANGE, TRAVEL, TURN
from drd.monitor.sums import FIRST_BIAS_RAD_S
from drd.units import (
    RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H,
    RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H,
)
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.recordings.folder import Recording
from drd_tools.replay.nominal import configuration
from drd_tools.simulate.conditions import GROUNDS, Conditions, Random, Reference
from drd_tools.simulate.missions import MISSIONS, make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.route import STEP_S
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.temperature import PROFILES
from drd_tools.simulate.truth import make_truth
from drd_tools.trial.overlay import overlaid, planted
from drd_tools.trial.size import eventful, scaled

DISTANCES: Final = (8.0, 12.0, 25.0)  # over WAY_M
WAY_M, TIME_S = 100.0, 60.0  # a name within either is in time
MINUTES: Final = 8.0
TURN_S: Final = 4.0  # interval of the monitor's decisions
BEHIND_S: Final = 1.0  # their delay behind the data
TRIES: Final = 25
BEGINS: Final = (0.25, 0.5)  # share of the steps in motion
NULLS: Final = ("plain", "stressed", "asphalt", "floors", "mujoco")
FRICTION: Final = (0.4, 0.8)  # ground of the skid-steer robot in MuJoCo
FLOOR_S, FLOOR_TREAD = (20.0, 90.0), (0.05, 0.3)  # other ground: duration, and change of tread
STRESS: Final = (0.7, 1.3)
TAILS: Final = 4.0
GOING_M_S: Final = 0.1
ROW_S: Final = 0.1
SIZED, ROUNDS, SMALL = 0.02, 12, 1e-3
# Prior standard deviations of the constants estimated with an effect, as a memory of earlier drives leaves them: bias
# (rad/s), turn, distance over tread, the wheels' lag (s).
NUISANCES: Final = (3.5e-4, 0.003, 0.0003, 0.002)
BIAS_STEP_S: Final = 20.0  # step of the gyro bias's random walk


class Case(Struct, frozen=True):
    """A case, which can be drawn again from this. `kind`: an effect's name, or one of NULLS; `d`: over 100 m.

    `remembers`: the monitor begins with the constants that a memory of earlier drives would give it.
    """

    name: str
    kind: str
    d: float
    seed: int
    remembers: bool = False


@dataclass(frozen=True)
class Drawn:
    """A recording and its answer. `begin_s`: onset, None if there is none; `limit_s`: deadline for a name.

    `seen_d`: the effect's detectability by then, with the monitor's own uncertainty of the constants.
    """

    recording: Recording
    effect: Effect | None = None
    values: Values | None = None
    begin_s: float | None = None
    limit_s: float = 0.0
    seen_d: float = 0.0


def seen_live() -> list[Effect]:
    """Effects that can begin in mid-run and that a monitor can see."""
    diagnosed = (e for e in catalogue().values() if e.is_diagnosed)
    return [e for e in diagnosed if not e.needs_position and e.begins is not Begins.POWER_ON]


def cases(each: int, nulls: int, seed: int, remembers: bool = False) -> list[Case]:
    """Cases: `nulls` of each kind of null first, then `each` of each effect and d."""
    found = [Case(f"null-{kind}-{n:03}", kind, 0.0, seed, remembers) for n in range(nulls) for kind in NULLS]
    for n in range(each):
        for effect in seen_live():
            sizes = (0.0,) if effect.irreversible else DISTANCES
            found += [Case(f"{effect.id}-d{d:g}-{n:03}", effect.id, d, seed, remembers) for d in sizes]
    return found


def drawn(case: Case) -> Drawn | None:
    """Simulate a case; None if no drive shows it at a plausible size."""
    random = np.random.default_rng([case.seed, zlib.crc32(case.name.encode())])
    tries = (_drawn(case, random) for _ in range(TRIES))
    return next((found for found in tries if found is not None), None)


def _drawn(case: Case, random: Random) -> Drawn | None:
    if case.kind == "mujoco":
        return _in_mujoco(random)
    missions = [m for m in MISSIONS if m != "stand"]
    mission = missions[int(random.integers(len(missions)))]
    profile = list(PROFILES)[int(random.integers(len(PROFILES)))]
    conditions = Conditions(reference=Reference(is_there=False))
    seed = int(random.integers(2**31))
    if case.kind == "stressed":
        gyro, wheels = random.uniform(*STRESS, 2).tolist()
        conditions = replace(conditions, gyro_noise=gyro, wheel_noise=wheels, tails=TAILS)
    elif case.kind == "asphalt":
        conditions = replace(conditions, ground=GROUNDS["asphalt"])
    truth = make_truth(make_drive(mission, 60.0 * MINUTES, DEFAULT.standstill_at_start_s), profile)
    made = simulate(truth, DEFAULT, (), conditions, seed, case.name)
    if case.kind in ("plain", "stressed", "asphalt"):
        return Drawn(made.recording)
    begin, after, limit = _onset(made.motion, random)
    begin_s, limit_s = float(made.motion.time_s[begin]), float(made.motion.time_s[limit])
    if case.kind == "floors":
        floor = catalogue()["terrain_tread"]
        tread = float(random.uniform(*FLOOR_TREAD) * random.choice((-1, 1)))
        values: Values = {"t0": begin_s, "t1": begin_s + float(random.uniform(*FLOOR_S)), "tread": tread, "gain": 0.0}
        recording = overlaid(made.recording, made.motion, [floor.error(made.motion, values)])
        return Drawn(recording, floor, values, begin_s, limit_s)
    effect = catalogue()[case.kind]
    if effect.irreversible:
        return _destroying(made.recording, made.motion, effect, (begin_s, limit_s), random)
    found = sized(effect, case.d, made.motion, (begin, after), random)
    if found is None:
        return None
    errors = since(effect, found, made.motion, begin)
    recording = overlaid(made.recording, made.motion, [errors])
    known = KNOWN_SIGMAS if case.remembers else stated_constants(configuration(recording)).sigmas
    constants = (FIRST_BIAS_RAD_S, known[TURN], known[TRAVEL], CHANGE_S * known[CHANGE])
    return Drawn(recording, effect, found, begin_s, limit_s, detectability(errors, made.motion, limit, constants))


def _in_mujoco(random: Random) -> Drawn | None:
    """Drive a skid-steer robot in MuJoCo, nothing missing; None if MuJoCo is not installed."""
    try:
        from drd_tools.mujoco_world import ground, missions, sensors, vehicle, world  # noqa: PLC0415  # an extra
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise
        return None
    names, car = list(missions.MISSIONS), vehicle.Vehicle()
    under = ground.Ground(friction=float(random.uniform(*FRICTION)), bumps_per_m=0.5 * float(random.random() < 0.5))
    name, seed = names[int(random.integers(len(names)))], int(random.integers(2**31))
    stand_s = DEFAULT.standstill_at_start_s
    motion = world.drive(car, under, name, 60.0 * MINUTES, stand_s, seed)
    nominal = sensors.nominal_of(car, name, stand_s)
    read = sensors.read_sensors(motion, Reference(is_there=False), seed, nominal)
    return Drawn(read.recording)


def _onset(m: Motion, random: Random) -> tuple[int, int, int]:
    """Draw the step of the onset; return it, the step WAY_M later, and the deadline for a name."""
    distance = np.cumsum(np.abs(m.speed_m_s)) * STEP_S
    going = np.flatnonzero(np.abs(m.speed_m_s) + 0.5 * m.tread_m * np.abs(m.rate_rad_s) > GOING_M_S)
    begin, last = (
        int(going[int(random.uniform(*BEGINS) * len(going))]),
        len(distance) - 1 - round((TURN_S + BEHIND_S) / STEP_S),
    )
    after = min(int(np.searchsorted(distance, distance[begin] + WAY_M)), last)
    return begin, after, min(max(after, begin + round(TIME_S / STEP_S)), last)


def _destroying(
    recording: Recording, m: Motion, effect: Effect, times_s: tuple[float, float], random: Random
) -> Drawn | None:
    """Plant an effect that destroys readings, from its onset on."""
    values = eventful(m, effect, random)
    if values is None:
        return None
    begin_s, limit_s = times_s
    has_window = "t0" in values
    if has_window:
        begin_s = float(values["t0"])
        limit_s = begin_s + TIME_S
    made, before, after = recording, recording.fog, planted(recording, effect, values)
    if after.fog is not None and before is not None:
        rate = np.where(before.time_s < (0.0 if has_window else begin_s), before.rate_rad_s, after.fog.rate_rad_s)
        made = replace(after, fog=replace(before, rate_rad_s=rate))
    return Drawn(made, effect, values, begin_s, limit_s)


def since(effect: Effect, values: Values, motion: Motion, begin: int) -> Errors:
    """Errors of an effect that begins at a step of the motion."""
    t0 = float(motion.time_s[begin]) if effect.begins is Begins.GROWING else 0.0
    moved = replace(motion, time_s=motion.time_s - t0, end_s=motion.end_s - t0)
    on = (np.arange(len(motion.time_s)) >= begin).astype(float)
    return Errors(*(on * e for e in effect.error(moved, values)))


def sized(effect: Effect, d: float, m: Motion, steps: tuple[int, int], random: Random) -> Values | None:
    """Values (SI) with detectability d by the second of two steps, from an onset at the first; None: not plausible."""
    begin, limit = steps
    side = "left" if random.random() < 0.5 else "right"
    chance = Chance(side, float(m.time_s[begin]), m.end_s, *map(float, random.random(6)))
    values: dict[str, Any] = {**effect.variants(m)[0], **effect.drawn(m, chance)}
    chosen = _sizes(effect)
    values |= {q.name: q.neutral for q in effect.parameters if q.linear and not q.choices}
    if len(chosen) > 1 and not chosen[0].signed:  # only their difference shows: vary one of the two
        chosen = [chosen[int(random.integers(2))]]
    for q in chosen:
        share = random.uniform(0.3, 1.0) * (random.choice((-1.0, 1.0)) if q.signed or q.neutral else 1.0)
        values[q.name] = q.neutral + float(share) * SMALL * (1.0 if q.neutral else q.high * q.si)
    if effect.opposed:
        values[chosen[1].name] = -values[chosen[0].name]
    return scaled(
        values, chosen, d, lambda found: detectability(since(effect, found, m, begin), m, limit), ROUNDS, SIZED
    )


def _sizes(effect: Effect) -> list[Parameter]:
    """Parameters that set the size of an effect, as far as it shows without a reference."""
    found = [q for q in effect.parameters if not (q.choices or q.moment or q.fixed)]
    found = [q for q in found if q.linear or not effect.linear()]
    return [q for q in found if q.name == effect.essential] if effect.essential else found


def detectability(errors: Errors, motion: Motion, limit: int, nuisances: Sequence[float] = NUISANCES) -> float:
    """Whitened norm of the errors in rows of wheel turn minus gyro turn up to a step, nuisances projected out."""
    size = round(ROW_S / STEP_S)
    n = limit // size

    def rows(values: Array | float) -> Array:
        full = np.zeros_like(motion.time_s) + values
        return np.asarray(full[: n * size].reshape(n, size).sum(1) * STEP_S)

    seen = (rows(errors.right_m_s) - rows(errors.left_m_s)) / DEFAULT.tread_m - rows(errors.gyro_rad_s)
    ways = rows(np.abs(motion.left_m_s)) + rows(np.abs(motion.right_m_s))
    walk = (DEFAULT.gyro_angle_random_walk_deg_per_sqrt_h or 0.0) * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H
    slip = DEFAULT.slip_noise_m_per_sqrt_m or 0.0
    sigma = np.sqrt(walk**2 * ROW_S + slip**2 * ways / DEFAULT.tread_m**2)
    change = np.gradient(motion.rate_rad_s, STEP_S)
    columns = (np.full(n, ROW_S), rows(motion.rate_rad_s), rows(motion.speed_m_s) / DEFAULT.tread_m, rows(change))
    drift = DEFAULT.gyro_bias_random_walk_deg_per_h_per_sqrt_h or 0.0
    step = drift * RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H * math.sqrt(BIAS_STEP_S)
    steps = [
        step * ROW_S * (np.arange(n) >= k) for k in range(round(BIAS_STEP_S / ROW_S), n, round(BIAS_STEP_S / ROW_S))
    ]
    beside = np.column_stack([*(s * c for s, c in zip(nuisances, columns, strict=True)), *steps]) / sigma[:, None]
    z = seen / sigma
    return math.sqrt(max(float(z @ Marginal(beside).projected(z)), 0.0))
