"""Cases drawn by seed: a drive, its conditions, and effects as visible as is asked for."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, Final

import numpy as np

from drd.effects.catalogue import catalogue
from drd.units import RAD_PER_DEG
from drd_tools.diagnose.evidence import gather
from drd_tools.diagnose.problem import Problem
from drd_tools.simulate.conditions import Conditions, Reference
from drd_tools.simulate.files import effect_rows
from drd_tools.simulate.missions import MISSIONS, make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import Simulated, simulate
from drd_tools.simulate.temperature import PROFILES
from drd_tools.simulate.truth import make_truth
from drd_tools.trial.size import Random, nearest, sized, visibility

VISIBILITIES: Final = (12.0, 25.0)
PAIR_VISIBILITY: Final = 25.0
DRIVES: Final = tuple(name for name in MISSIONS if name != "stand")
TRIES: Final = 30  # drives, until one shows an effect of a plausible size so well
LATE_S: Final = 0.005
SIDEWAYS_M: Final = 0.05
YAW_RAD: Final = 0.5 * RAD_PER_DEG
TAILS: Final = 4.0
STRESSED: Final = "null stressed"


@dataclass(frozen=True)
class Drawing:
    """A case that can be made again from these: `name` says its kind, effect and visibility."""

    name: str
    kind: str
    effects: tuple[str, ...]
    visibility: float
    seed: int
    minutes: tuple[float, float]
    reference: str = "full"


@dataclass(frozen=True)
class Case:
    """A recording and its answer, in the form of answers.json with the drive beside it."""

    simulated: Simulated
    answer: dict[str, Any]


def drawings(
    count: int, seed: int, minutes: tuple[float, float], reference: str = "full", only: tuple[str, ...] = ("*",)
) -> Iterator[Drawing]:
    """`count` plain and stressed nulls, pairs, and drives of each effect at each visibility; names that match `only`.

    A case depends on its name and `seed`, not on what else is drawn.
    """
    names = reversible()
    for number in range(count):
        wanted: list[tuple[str, str, tuple[str, ...], float]] = [
            (f"null-plain-{number:03}", "null", (), 0.0),
            (f"null-stressed-{number:03}", STRESSED, (), 0.0),
        ]
        for d in VISIBILITIES:
            wanted += [(f"{effect}-d{d:g}-{number:03}", f"single d={d:g}", (effect,), d) for effect in names]
        two = np.random.default_rng([seed, number]).choice(len(names), 2, replace=False)
        pair = tuple(names[i] for i in two)
        wanted.append((f"pair-{number:03}", f"pair d={PAIR_VISIBILITY:g}", pair, PAIR_VISIBILITY))
        for name, kind, effects, d in wanted:
            if any(fnmatchcase(name, pattern) for pattern in only):
                yield Drawing(name, kind, effects, d, seed, minutes, reference)


def reversible() -> list[str]:
    """Names of the effects that can be drawn."""
    return [effect.id for effect in catalogue().values() if not effect.irreversible]


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
    mission = DRIVES[int(random.integers(len(DRIVES)))]
    temperature = list(PROFILES)[int(random.integers(len(PROFILES)))]
    seconds = float(10.0 * np.round(6.0 * random.uniform(*drawing.minutes)))
    seed = int(random.integers(2**31))
    truth = make_truth(make_drive(mission, seconds, DEFAULT.standstill_at_start_s), temperature)
    conditions, yaw_rad = Conditions(reference=Reference.parse(drawing.reference)), 0.0
    drive = {"mission": mission, "temperature": temperature, "seconds": seconds, "seed": seed}
    answer: dict[str, Any] = {"case": drawing.name, "kind": drawing.kind, "effects": [], "drive": drive}
    if drawing.kind == STRESSED:
        conditions, yaw_rad = _stressed(conditions, random)
        answer["stress"] = _plain(conditions, yaw_rad)
    null = simulate(truth, DEFAULT, (), conditions, seed, drawing.name)
    if not drawing.effects:
        return Case(_turned(null, yaw_rad), answer)
    problem = Problem(gather(null.recording))
    found = []
    for effect in (catalogue()[name] for name in drawing.effects):
        values = sized(problem, null.motion, effect, drawing.visibility, random)
        if values is None:
            return None
        found.append((effect, values))
    answer["effects"] = effect_rows(found)
    for row, (effect, values) in zip(answer["effects"], found, strict=True):
        row["visibility"] = visibility(problem, effect, values)
    if len(found) == 1:
        answer["effects"][0] |= nearest(problem, *found[0])
    return Case(simulate(truth, DEFAULT, found, conditions, seed, drawing.name), answer)


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


def _turned(simulated: Simulated, yaw_rad: float) -> Simulated:
    """With a reference that is mounted askew."""
    recording = simulated.recording
    if recording.reference is None:
        return simulated
    reference = replace(recording.reference, heading_rad=recording.reference.heading_rad + yaw_rad)
    return replace(simulated, recording=replace(recording, reference=reference))
