"""What a diagnosis is worth against the answer."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from drd.effects.catalogue import catalogue
from drd.effects.effect import END, START
from drd_tools.trial.unknown import PREFIX

Record = dict[str, Any]

NOTHING, EXPLAINED, UNKNOWN = "nothing_missing", "explained", "unknown"
LEAST_GAIN: Final = 25.0  # squared sigmas that the oracle takes off another drive, there for a share to mean anything
NOT_LINEAR: Final = 2.0  # of the residual's expectation
WORSE: Final = 0.02
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
    """Of one record. `..._class`: a finding is right where the right name is among those that it also fits.

    What is in no catalogue has the right name `unknown`. `named`: findings with a name, `false_named`: those of them
    that are wrong even as a class. `windows`: effects of a stretch of time that were named, and the share of overlap
    (intersection over union). `share`: improvement of the other drive's residual, of what the oracle's is; None where
    the oracle's is lost in the noise. `worse`: what was found made the other drive's residual (`worse_path`: path)
    worse than no correction by more than WORSE; None where there was no other drive, or it tells nothing.
    """

    verdict: bool
    claims: bool
    sure_claims: bool
    top_1: bool
    top_1_class: bool
    exact: bool
    exact_class: bool
    flagged: bool
    misnamed: bool
    named: int
    false_named: int
    intervals: tuple[Interval, ...]
    windows: tuple[tuple[str, float], ...]
    share: float | None
    worse: bool | None
    worse_path: bool | None


def score(record: Record) -> Score:
    """Judge a record: the answer's `effects`, and the diagnosis' `verdict` and `findings`, best first."""
    truth, findings = record["effects"], record["findings"]
    right = [_right(e["effect"]) for e in truth]
    said = [f["effect"] for f in findings]
    classes = [{f["effect"], *f["also_fits"]} for f in findings]
    named = [c for f, c in zip(findings, classes, strict=True) if f["effect"] != UNKNOWN]
    expected = (UNKNOWN if UNKNOWN in right else EXPLAINED) if truth else NOTHING
    pairs = [(e, f) for e in truth for f in findings if f["effect"] == e["effect"]]
    share, worse, worse_path = _held_out(record.get("held_out"))
    return Score(
        verdict=record["verdict"] == expected,
        claims=bool(findings),
        sure_claims=any(f["status"] != "suspected" for f in findings),
        top_1=bool(said) and said[0] in right,
        top_1_class=bool(said) and not classes[0].isdisjoint(right),
        exact=record["verdict"] != "failed" and set(said) == set(right),
        exact_class=record["verdict"] != "failed" and _matches(right, classes),
        flagged=UNKNOWN in said,
        misnamed=bool(named) and UNKNOWN not in said,
        named=len(named),
        false_named=sum(c.isdisjoint(right) for c in named),
        intervals=tuple(i for e, f in pairs for i in _intervals(e, f)),
        windows=tuple((e["effect"], iou) for e, f in pairs if (iou := _overlap(e["parameters"], f)) is not None),
        share=share,
        worse=worse,
        worse_path=worse_path,
    )


def of_names(record: Record, names: Sequence[str]) -> Score:
    """Judge a method that gives names only, the best first."""
    findings = [{"effect": n, "also_fits": [], "status": "supported", "parameters": {}, "windows": []} for n in names]
    verdict = EXPLAINED if names else NOTHING
    return score({"effects": record["effects"], "findings": findings, "verdict": verdict})


def _right(name: str) -> str:
    return UNKNOWN if name.startswith(PREFIX) else name


def _overlap(true: dict[str, Any], finding: dict[str, Any]) -> float | None:
    """Intersection over union of two windows; None for an effect that has none. One that lasts ends with the drive."""
    windows = finding["windows"]
    if START.name not in true or not windows:
        return None
    low, high, begin = float(windows[0][0]), float(windows[0][1]), float(true[START.name])
    end = float(true.get(END.name, high))
    return max(0.0, min(high, end) - max(low, begin)) / max(max(high, end) - min(low, begin), 1e-9)


def _held_out(other: dict[str, Any] | None) -> tuple[float | None, bool | None, bool | None]:
    if other is None:
        return None, None, None
    residual, path_m = other["residual"], other["path_m"]
    # Where even the truth leaves so much, what is missing is too large there for a linear residual.
    is_linear = residual["oracle"] < NOT_LINEAR * other["rows"]
    could = residual["before"] - residual["oracle"]
    share = (residual["before"] - residual["after"]) / could if could > LEAST_GAIN and is_linear else None
    worse = math.sqrt(residual["after"] / residual["before"]) > 1.0 + WORSE if is_linear else None
    # Where even the truth makes the path worse, that drive's noise decides.
    best_m = max(path_m["before"], path_m.get("oracle", 0.0))
    return share, worse, path_m["after"] > (1.0 + WORSE) * best_m


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
