"""What a diagnosis is worth against the answer."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from drd.effects.catalogue import catalogue

Record = dict[str, Any]

NOTHING, EXPLAINED = "nothing_missing", "explained"
Z_90: Final = 1.6448536269514722  # two-sided 90 %
Z_95: Final = 1.959963984540054


@dataclass(frozen=True)
class Interval:
    """A true parameter and what was said of it, in the catalogue's unit."""

    effect: str
    parameter: str
    true: float
    value: float
    std: float

    @property
    def inside(self) -> bool:
        """Whether the 90 % interval holds the truth."""
        return abs(self._error()) <= Z_90 * self.std

    @property
    def sigmas(self) -> float:
        """The error in standard deviations."""
        return self._error() / self.std

    def _error(self) -> float:
        error = self.value - self.true
        unit = next(q.unit for q in catalogue()[self.effect].parameters if q.name == self.parameter)
        return math.remainder(error, 2.0 * math.pi) if unit == "rad" else error


@dataclass(frozen=True)
class Score:
    """Of one record. `..._class`: a finding is right where the right name is among those that it also fits."""

    verdict: bool
    claims: bool
    sure_claims: bool
    top_1: bool
    top_1_class: bool
    exact: bool
    exact_class: bool
    intervals: tuple[Interval, ...]


def score(record: Record) -> Score:
    """Judge a record: the answer's `effects`, and the diagnosis' `verdict` and `findings`, best first."""
    truth, findings = record["effects"], record["findings"]
    right = [e["effect"] for e in truth]
    said = [f["effect"] for f in findings]
    classes = [{f["effect"], *f["also_fits"]} for f in findings]
    return Score(
        verdict=record["verdict"] == (EXPLAINED if truth else NOTHING),
        claims=bool(findings),
        sure_claims=any(f["status"] != "suspected" for f in findings),
        top_1=bool(said) and said[0] in right,
        top_1_class=bool(said) and not classes[0].isdisjoint(right),
        exact=record["verdict"] != "failed" and set(said) == set(right),
        exact_class=record["verdict"] != "failed" and _matches(right, classes),
        intervals=tuple(i for e in truth for f in findings if f["effect"] == e["effect"] for i in _intervals(e, f)),
    )


def _matches(right: Sequence[str], classes: Sequence[set[str]]) -> bool:
    """Whether each finding stands for another of the effects, and none is left."""
    if len(right) != len(classes):
        return False
    orders = itertools.permutations(right)
    return any(all(name in names for name, names in zip(order, classes, strict=True)) for order in orders)


def _intervals(effect: dict[str, Any], finding: dict[str, Any]) -> list[Interval]:
    """Of the parameters that both have, and that were estimated; a catalogue's fixed ones are not."""
    name = effect["effect"]
    made = []
    for q in catalogue()[name].parameters if name in catalogue() else ():
        true, told = effect["parameters"].get(q.name), finding["parameters"].get(q.name)
        if not q.choices and not q.fixed and true is not None and told is not None and told["std"] > 0.0:
            made.append(Interval(name, q.name, float(true), float(told["value"]), float(told["std"])))
    return made


def wilson(successes: int, n: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927). (0, 1) where n is 0."""
    if n == 0:
        return 0.0, 1.0
    p, z2 = successes / n, Z_95**2
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = Z_95 / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    return max(0.0, middle - half), min(1.0, middle + half)
