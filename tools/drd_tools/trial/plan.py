"""Cases of a trial: each is identified by its name, and drawn from name and seed alone."""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, Final, NamedTuple

import numpy as np

from drd.effects.catalogue import catalogue
from drd_tools.trial.unknown import HIDDEN

DISTANCES: Final = (8.0, 12.0, 20.0)
TOGETHER: Final = 20.0  # d of each effect in a set, of physics in no catalogue, and with other references
STRESSED: Final = "null stressed"
CONTACTS: Final = "contacts"
OTHERWISE: Final[dict[str, Any]] = {
    "sparse": {"reference": "sparse:60"},
    "ends": {"reference": "ends"},
    "none": {"reference": "none"},
    CONTACTS: {"world": CONTACTS},
}


@dataclass(frozen=True)
class Drawing:
    """A case, which can be made again from these fields.

    `name` states kind, effect and detectability. A detectability without effects means any effect the drive shows.
    """

    name: str
    kind: str
    effects: tuple[str, ...]
    detectability: float
    seed: int
    minutes: tuple[float, float]
    reference: str = "full"
    world: str = "formulas"

    @property
    def number(self) -> int:
        """Number among the cases of its kind, from 0."""
        return int(self.name.rpartition("-")[2])


class Plan(NamedTuple):
    """Numbers of cases: nulls (plain, and stressed), drives of each effect at each d, pairs (and triples), drives of
    each cause in no catalogue, nulls (and effects) with each other reference, and in the MuJoCo world.
    """

    nulls: int = 0
    singles: int = 0
    sets: int = 0
    unknowns: int = 0
    variants: int = 0
    contacts: int = 0


NONE: Final = Plan()
LARGE: Final = Plan(nulls=150, singles=4, sets=25, unknowns=4, variants=8, contacts=12)
LARGE_BESIDE: Final = 4  # one case in so many also goes to the other methods, which take as long as the diagnosis


def is_chosen(case: str, only: Iterable[str]) -> bool:
    """Whether a case's name matches one of the patterns of `--only`."""
    return any(fnmatchcase(case, pattern) for pattern in only)


def reversible() -> list[str]:
    """Names of the effects of variable size that a diagnosis may name."""
    return [effect.id for effect in catalogue().values() if not effect.irreversible and effect.is_diagnosed]


def events() -> list[str]:
    """Names of the effects that destroy readings."""
    return [effect.id for effect in catalogue().values() if effect.irreversible]


def drawings(
    plan: Plan, seed: int, minutes: tuple[float, float], reference: str = "full", only: tuple[str, ...] = ("*",)
) -> Iterator[Drawing]:
    """Yield the cases of a plan whose names match `only`, ordered so that a stopped trial has some of each kind."""
    for number in range(max(plan)):
        for drawing in _numbered(plan, number, seed, minutes, reference):
            if is_chosen(drawing.name, only):
                yield drawing


def _numbered(plan: Plan, number: int, seed: int, minutes: tuple[float, float], reference: str) -> Iterator[Drawing]:
    def drawing(name: str, kind: str, effects: tuple[str, ...] = (), d: float = 0.0) -> Drawing:
        return Drawing(f"{name}-{number:03}", kind, effects, d, seed, minutes, reference)

    if number < plan.nulls:
        yield drawing("null-plain", "null")
        yield drawing("null-stressed", STRESSED)
    if number < plan.singles:
        for d, effect in itertools.product(DISTANCES, reversible()):
            yield drawing(f"{effect}-d{d:g}", f"single d={d:g}", (effect,), d)
        for effect in events():
            yield drawing(f"{effect}-event", "single event", (effect,))
    if number < plan.sets:
        names, random = reversible(), np.random.default_rng([seed, number])
        for count, word in ((2, "pair"), (3, "triple")):
            chosen = tuple(names[i] for i in random.choice(len(names), count, replace=False))
            yield drawing(word, f"{word} d={TOGETHER:g}", chosen, TOGETHER)
    if number < plan.unknowns:
        for effect in HIDDEN:
            yield drawing(f"{effect}-d{TOGETHER:g}", f"unknown d={TOGETHER:g}", (effect,), TOGETHER)
    for word, changes in OTHERWISE.items():
        if number < (plan.contacts if word == CONTACTS else plan.variants):
            yield replace(drawing(f"null-{word}", f"null {word}"), **changes)
            yield replace(drawing(f"any-{word}", f"single {word}", (), TOGETHER), **changes)
