"""Cases drawn by seed: a drive, its conditions, and effects as visible as is asked for."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.recordings.folder import Recording
from drd_tools.simulate.conditions import Conditions, Reference
from drd_tools.simulate.files import effect_rows
from drd_tools.simulate.missions import MISSIONS, make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.temperature import PROFILES
from drd_tools.simulate.truth import make_truth
from drd_tools.trial import contacts
from drd_tools.trial.overlay import Effects, overlaid
from drd_tools.trial.plan import CONTACTS, STRESSED, Drawing, reversible
from drd_tools.trial.size import Random, Values, eventful, nearest, sized, visibility
from drd_tools.trial.unknown import HIDDEN

TRIES: Final = 30  # drives, until one shows an effect of a plausible size so well
UNLIKE_NATS: Final = 20.0  # by which what is in no catalogue must do better than the nearest name, without noise
LATE_S: Final = 0.005
SIDEWAYS_M: Final = 0.05
YAW_RAD: Final = 0.5 * RAD_PER_DEG
TAILS: Final = 4.0
FRICTION: Final = (0.8, 1.0)
CONTACTS_MINUTES: Final = 4.0  # at most: contact physics takes its time


@dataclass(frozen=True)
class Case:
    """A recording and its answer, in the form of answers.json with the drive beside it.

    `again()`: another drive of the same robot with the same effects, with a full reference.
    """

    recording: Recording
    effects: Effects
    answer: dict[str, Any]
    again: Callable[[], Recording]


class Run(NamedTuple):
    """One drive of a robot. The temperature is the other world's own in MuJoCo, the friction only there."""

    mission: str
    temperature: str
    seconds: float
    seed: int
    friction: float


def make(drawing: Drawing) -> Case:
    """Simulate a case. Raises ValueError where no drive shows its effects at a plausible size."""
    random = np.random.default_rng([drawing.seed, zlib.crc32(drawing.name.encode())])
    for _ in range(TRIES):
        case = _made(drawing, random)
        if case is not None:
            return case
    raise ValueError(f"{drawing.name}: none of {TRIES} drives shows it at a plausible size")


def _made(drawing: Drawing, random: Random) -> Case | None:
    """One try; None where an effect would be implausible."""
    names = drawing.effects
    if drawing.visibility and not names:
        names = (reversible()[int(random.integers(len(reversible())))],)
    run, other = (_run(drawing, names, random) for _ in range(2))
    other = other._replace(seconds=run.seconds)  # windows of time are in it, too
    conditions, yaw_rad = Conditions(reference=Reference.parse(drawing.reference)), 0.0
    answer: dict[str, Any] = {"case": drawing.name, "kind": drawing.kind, "effects": [], "drive": run._asdict()}
    if drawing.kind == STRESSED:
        conditions, yaw_rad = _stressed(conditions, random)
        answer["stress"] = _plain(conditions, yaw_rad)

    def record(one: Run, effects: Effects, conditions: Conditions) -> tuple[Recording, Motion]:
        make_one = _in_contacts if drawing.world == CONTACTS else _simulated
        return make_one(one, effects, conditions, drawing.name)

    def again() -> Recording:
        return record(other, found, Conditions())[0]

    recording, motion = record(run, (), conditions)
    found: list[tuple[Effect, Values]] = []
    if not names:
        return Case(_turned(recording, yaw_rad), (), answer, again)
    problem = Problem(gather(recording))
    for effect in (_effect(name) for name in names):
        values = (
            sized(problem, motion, effect, drawing.visibility, random)
            if drawing.visibility
            else eventful(motion, effect, random)
        )
        if values is None:
            return None
        found.append((effect, values))
    answer["effects"] = effect_rows(found)
    for row, (effect, values), rival in zip(answer["effects"], found, nearest(problem, found), strict=True):
        row.update(visibility=visibility(problem, effect, values), **rival)
    if names[0] in HIDDEN and answer["effects"][0]["margin_nats"] < UNLIKE_NATS:
        return None  # on this drive a name says it all
    return Case(record(run, found, conditions)[0], found, answer, again)


def _effect(name: str) -> Effect:
    return HIDDEN[name] if name in HIDDEN else catalogue()[name]


def _run(drawing: Drawing, names: tuple[str, ...], random: Random) -> Run:
    """Any drive on which it makes sense to look for these."""
    in_contacts = drawing.world == CONTACTS
    missions = contacts.MISSIONS if in_contacts else [name for name in MISSIONS if name != "stand"]
    mission = missions[int(random.integers(len(missions)))]
    temperature = list(PROFILES)[int(random.integers(len(PROFILES)))]
    low, high = drawing.minutes
    if in_contacts:
        low, high = min(low, CONTACTS_MINUTES), min(high, CONTACTS_MINUTES)
    seconds = float(10.0 * np.round(6.0 * random.uniform(low, high)))
    seed, friction = int(random.integers(2**31)), float(random.uniform(*FRICTION))
    wanted = next((HIDDEN[n].temperature for n in names if n in HIDDEN), "")
    return Run(mission, wanted or temperature, seconds, seed, friction)


def _simulated(run: Run, effects: Effects, conditions: Conditions, name: str) -> tuple[Recording, Motion]:
    truth = make_truth(make_drive(run.mission, run.seconds, DEFAULT.standstill_at_start_s), run.temperature)
    known = [pair for pair in effects if pair[0].id not in HIDDEN]
    made = simulate(truth, DEFAULT, known, conditions, run.seed, name)
    hidden = [pair for pair in effects if pair[0].id in HIDDEN]
    return (overlaid(made.recording, made.motion, hidden) if hidden else made.recording), made.motion


def _in_contacts(run: Run, effects: Effects, conditions: Conditions, name: str) -> tuple[Recording, Motion]:
    reference = conditions.reference
    driven = contacts.drive(run.mission, run.seconds, run.seed, run.friction, reference, name)
    recording = overlaid(driven.recording, driven.motion, effects) if effects else driven.recording
    return recording, driven.motion


def _stressed(conditions: Conditions, random: Random) -> tuple[Conditions, float]:
    """Nothing is missing, yet noise, reference and tails are worse than on paper; and the reference's yaw, rad."""
    gyro, wheels, reference = random.uniform(0.7, 1.3, 3).tolist()
    late = replace(
        conditions.reference,
        latency_s=float(random.uniform(0.0, LATE_S)),
        lever_m=(0.0, float(random.uniform(-SIDEWAYS_M, SIDEWAYS_M))),
    )
    made = replace(
        conditions, gyro_noise=gyro, wheel_noise=wheels, reference_noise=reference, tails=TAILS, reference=late
    )
    return made, float(random.uniform(-YAW_RAD, YAW_RAD))


def _plain(conditions: Conditions, yaw_rad: float) -> dict[str, float]:
    return {
        "gyro_noise": conditions.gyro_noise,
        "wheel_noise": conditions.wheel_noise,
        "reference_noise": conditions.reference_noise,
        "tails": conditions.tails,
        "latency_s": conditions.reference.latency_s,
        "sideways_m": conditions.reference.lever_m[1],
        "yaw_deg": yaw_rad / RAD_PER_DEG,
    }


def _turned(recording: Recording, yaw_rad: float) -> Recording:
    """With a reference that is mounted askew."""
    if recording.reference is None or not yaw_rad:
        return recording
    log = replace(recording.reference, heading_rad=recording.reference.heading_rad + yaw_rad)
    return replace(recording, reference=log)
