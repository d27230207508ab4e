"""Cases drawn by seed: a drive, its conditions, and effects of the requested detectability."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np
from msgspec import UnsetType

from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect, Values
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
from drd_tools.trial.ceiling import set_ceilings
from drd_tools.trial.overlay import Effects, overlaid
from drd_tools.trial.plan import CONTACTS, STRESSED, Drawing, reversible
from drd_tools.trial.results import Answer, Run, Stress, TrueEffect
from drd_tools.trial.size import Random, Whitener, eventful, selected_of, set_rivals
from drd_tools.trial.unknown import HIDDEN

TRIES: Final = 30  # drives tried until one shows an effect of plausible size with the requested d
UNLIKE_NATS: Final = 20.0  # by which physics in no catalogue must beat the nearest name, without noise
LATE_S: Final = 0.005
SIDEWAYS_M: Final = 0.05
YAW_DEG: Final = 0.5
TAILS: Final = 4.0
FRICTION: Final = (0.8, 1.0)
CONTACTS_MINUTES: Final = 4.0  # at most: contact physics is slow to simulate


@dataclass(frozen=True)
class Case:
    """A recording and its answer.

    `again()`: another drive of the same robot with the same effects, with a full reference.
    """

    recording: Recording
    effects: Effects
    answer: Answer
    again: Callable[[], Recording]


def make(drawing: Drawing, judged: bool = True) -> Case:
    """Simulate a case; `judged`: with rivals and ceilings. Raises ValueError if no drive shows its effects at a
    plausible size.
    """
    random = np.random.default_rng([drawing.seed, zlib.crc32(drawing.name.encode())])
    for _ in range(TRIES):
        case = _made(drawing, random, judged)
        if case is not None:
            return case
    raise ValueError(f"{drawing.name}: none of {TRIES} drives shows it at a plausible size")


def _made(drawing: Drawing, random: Random, judged: bool) -> Case | None:
    """Try one drive; None if an effect would be implausible."""
    names = drawing.effects
    if drawing.detectability and not names:
        names = (reversible()[int(random.integers(len(reversible())))],)
    run, other = (_run(drawing, names, random) for _ in range(2))
    other = msgspec.structs.replace(other, seconds=run.seconds)  # so that windows of time lie within it, too
    conditions, answer = (
        Conditions(reference=Reference.parse(drawing.reference)),
        Answer(case=drawing.name, kind=drawing.kind, effects=[], drive=run),
    )
    if drawing.kind == STRESSED:
        answer.stress = _stress(random)
        conditions = _stressed(conditions, answer.stress)

    def record(one: Run, effects: Effects, conditions: Conditions) -> tuple[Recording, Motion]:
        make_one = _in_contacts if drawing.world == CONTACTS else _simulated
        return make_one(one, effects, conditions, drawing.name)

    def again() -> Recording:
        return record(other, found, Conditions())[0]

    recording, motion = record(run, (), conditions)
    found: list[tuple[Effect, Values]] = []
    if not names:
        return Case(_turned(recording, answer.stress), (), answer, again)
    whitener = Whitener(Problem(gather(recording)), motion)
    for effect in (HIDDEN.get(name) or catalogue()[name] for name in names):
        d = drawing.detectability
        values = whitener.sized(effect, d, random) if d else eventful(motion, effect, random)
        if values is None:
            return None
        found.append((effect, values))
    answer.effects = [
        TrueEffect(**row, detectability=whitener.detectability(*pair))
        for row, pair in zip(effect_rows(found), found, strict=True)
    ]
    if judged:
        set_rivals(whitener.problem, found, answer.effects)
        set_ceilings(whitener.problem, selected_of(found), answer.effects)
    margin = answer.effects[0].margin_nats
    if names[0] in HIDDEN and isinstance(margin, float) and margin < UNLIKE_NATS:
        return None  # on this drive a known name explains it as well
    return Case(record(run, found, conditions)[0], found, answer, again)


def _run(drawing: Drawing, names: tuple[str, ...], random: Random) -> Run:
    """Draw a drive that can show these effects."""
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
    hidden = [x.error(made.motion, v) for x, v in effects if x.id in HIDDEN]
    return overlaid(made.recording, made.motion, hidden), made.motion


def _in_contacts(run: Run, effects: Effects, conditions: Conditions, name: str) -> tuple[Recording, Motion]:
    reference = conditions.reference
    recording, motion = contacts.drive(run.mission, run.seconds, run.seed, run.friction, reference, name)
    return overlaid(recording, motion, [x.error(motion, v) for x, v in effects]), motion


def _stress(random: Random) -> Stress:
    """Draw noise, tails and a reference that differ from the datasheets."""
    gyro, wheels, reference = random.uniform(0.7, 1.3, 3).tolist()
    latency_s, sideways_m = float(random.uniform(0.0, LATE_S)), float(random.uniform(-SIDEWAYS_M, SIDEWAYS_M))
    return Stress(gyro, wheels, reference, TAILS, latency_s, sideways_m, float(random.uniform(-YAW_DEG, YAW_DEG)))


def _stressed(conditions: Conditions, stress: Stress) -> Conditions:
    return replace(
        conditions,
        gyro_noise=stress.gyro_noise,
        wheel_noise=stress.wheel_noise,
        reference_noise=stress.reference_noise,
        tails=stress.tails,
        reference=replace(conditions.reference, latency_s=stress.latency_s, lever_m=(0.0, stress.sideways_m)),
    )


def _turned(recording: Recording, stress: Stress | UnsetType) -> Recording:
    """Rotate the reference, as if mounted askew."""
    log = recording.reference
    if log is None or not isinstance(stress, Stress):
        return recording
    return replace(recording, reference=replace(log, heading_rad=log.heading_rad + stress.yaw_deg * RAD_PER_DEG))
