"""Score of a diagnosis against the answer."""

import itertools
import math
from collections.abc import Sequence
from typing import Any, Final

from msgspec import UNSET, Struct, UnsetType
from scipy.stats import binomtest

from drd.effects.catalogue import catalogue
from drd.effects.effect import END, START
from drd.monitor.findings import Z_90
from drd_tools.diagnose.results import NOTHING, UNNAMED, Finding, Status, Support, Verdict
from drd_tools.trial.ceiling import ceiling_of
from drd_tools.trial.results import FAILED, OtherDrive, Record, TrueEffect
from drd_tools.trial.unknown import PREFIX

LEAST_GAIN: Final = 25.0  # squared sigmas by which the oracle must improve another drive for a share to be meaningful
NOT_LINEAR: Final = 2.0  # of the residual's expectation
WORSE: Final = 0.02
BINS: Final = 10  # of probabilities: the usual number


class Interval(Struct, frozen=True):
    """A true parameter and its reported estimate, in the catalogue's unit."""

    effect: str
    parameter: str
    true: float
    value: float
    std: float

    @property
    def inside(self) -> bool:
        """Whether the 90 % interval contains the truth."""
        return abs(self.sigmas) <= Z_90

    @property
    def sigmas(self) -> float:
        """Error in standard deviations; an angle's is wrapped to +-pi."""
        error = self.value - self.true
        unit = next(q.unit for q in catalogue()[self.effect].parameters if q.name == self.parameter)
        return (math.remainder(error, 2.0 * math.pi) if unit == "rad" else error) / self.std


class Score(Struct, frozen=True, kw_only=True):
    """Score of one record. `..._class`: a finding is right if the right name is among those that it also fits.

    The right name of physics in no catalogue is `unknown`. `reports`: there is a finding; `sure_reports`: one above
    suspected. `named`: number of findings with a name; `false_named`: of those wrong even as a class. `windows`: named
    effects with an interval of time, and the overlap of the intervals (intersection over union). `share`: improvement
    of the other drive's residual relative to the oracle's; None if the latter is lost in the noise. `probabilities`:
    those of the first names, and whether they are right; `brier`: score over all names of a finding. `effects`: number
    of true effects; `ceiling`: limit of the probability that any method names them all, or None. `worse`: the model
    made the other drive's residual (`worse_path`: path) worse than no correction by more than WORSE; None without
    another drive, or if it is uninformative.
    """

    verdict: bool
    reports: bool
    sure_reports: bool
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
    probabilities: tuple[tuple[float, bool], ...]
    brier: tuple[float, ...]
    effects: int
    ceiling: float | None
    share: float | None
    worse: bool | None
    worse_path: bool | None


def score(record: Record) -> Score:
    """Judge a record's verdict and findings by its effects."""
    truth, findings = record.effects, record.findings
    right = [UNNAMED if e.effect.startswith(PREFIX) else e.effect for e in truth]
    said = [f.effect for f in findings]
    classes = [{f.effect, *f.also_fits} for f in findings]
    named = [c for f, c in zip(findings, classes, strict=True) if f.is_named]
    expected = (Verdict.UNKNOWN if UNNAMED in right else Verdict.EXPLAINED) if truth else Verdict.NOTHING
    pairs = [(e, f) for e in truth for f in findings if f.effect == e.effect]
    share, worse, worse_path = _held_out(record.held_out)
    return Score(
        verdict=record.verdict == expected,
        reports=bool(findings),
        sure_reports=any(f.status != Status.SUSPECTED for f in findings),
        top_1=bool(said) and said[0] in right,
        top_1_class=bool(said) and not classes[0].isdisjoint(right),
        exact=record.verdict != FAILED and set(said) == set(right),
        exact_class=record.verdict != FAILED and _matches(right, classes),
        flagged=UNNAMED in said,
        misnamed=bool(named) and UNNAMED not in said,
        named=len(named),
        false_named=sum(c.isdisjoint(right) for c in named),
        intervals=tuple(i for e, f in pairs for i in estimates(e, f) if i.std > 0.0),
        windows=tuple((e.effect, iou) for e, f in pairs if (iou := overlap(e, f)) is not None),
        probabilities=tuple((f.probability, f.effect in right) for f in findings if f.probabilities),
        brier=tuple(_brier(f, right) for f in findings if f.probabilities),
        effects=len(truth),
        ceiling=ceiling_of(record),
        share=share,
        worse=worse,
        worse_path=worse_path,
    )


def _brier(finding: Finding, right: Sequence[str]) -> float:
    """Brier score of a finding's probabilities (Brier 1950), 0 to 2. If none of its names is right, "nothing" is."""
    true = next((name for name in finding.probabilities if name in right), NOTHING)
    missed = 0.0 if true in finding.probabilities else 1.0
    return missed + sum((p - (name == true)) ** 2 for name, p in finding.probabilities.items())


def calibration_error(pairs: Sequence[tuple[float, bool]]) -> float:
    """Expected calibration error of probabilities and whether they were right, in BINS bins (Guo et al. 2017)."""
    bins: dict[int, list[tuple[float, bool]]] = {}
    for p, is_right in pairs:
        bins.setdefault(min(int(BINS * p), BINS - 1), []).append((p, is_right))
    return sum(abs(sum(p - is_right for p, is_right in own)) for own in bins.values()) / max(len(pairs), 1)


def exact_error(probabilities: Sequence[float]) -> float:
    """Expected `calibration_error` of perfectly calibrated probabilities, by the normal approximation."""
    bins: dict[int, float] = {}
    for p in probabilities:
        at = min(int(BINS * p), BINS - 1)
        bins[at] = bins.get(at, 0.0) + p * (1.0 - p)
    return sum(math.sqrt(2.0 / math.pi * variance) for variance in bins.values()) / max(len(probabilities), 1)


def of_names(record: Record, method: str) -> Score:
    """Judge another method, which selects names only, the best first."""
    names = record.baselines[method]
    findings = tuple(
        Finding(effect=n, status=Status.SUPPORTED, also_fits=(), acts_on="", parameters={}, windows=(), covariate=None,
                evidence=Support(None, None, None), explains=None, sentence="")
        for n in names
    )  # fmt: skip
    verdict = Verdict.EXPLAINED if names else Verdict.NOTHING
    return score(Record(case=record.case, kind=record.kind, effects=record.effects, verdict=verdict, findings=findings))


def overlap(true: TrueEffect, finding: Finding) -> float | None:
    """Intersection over union of two windows; None without windows. An effect that has no end lasts to the drive's."""
    if START.name not in true.parameters or not finding.windows:
        return None
    (low, high), begin = finding.windows[0], float(true.parameters[START.name])
    end = float(true.parameters.get(END.name, high))
    return max(0.0, min(high, end) - max(low, begin)) / max(max(high, end) - min(low, begin), 1e-9)


def estimates(true: TrueEffect, finding: Finding) -> list[Interval]:
    """Intervals of the parameters that both have, except choices and fixed ones; a std of 0 or NaN means unknown."""
    parameters = catalogue()[true.effect].parameters if true.effect in catalogue() else ()
    names = [q.name for q in parameters if not q.choices and not q.fixed and q.name in true.parameters]
    amounts = {n: finding.parameters[n] for n in names if n in finding.parameters}
    return [Interval(true.effect, n, float(true.parameters[n]), a.value, a.std) for n, a in amounts.items()]


def _held_out(other: OtherDrive | UnsetType) -> tuple[float | None, bool | None, bool | None]:
    if other is UNSET:
        return None, None, None
    assert isinstance(other, OtherDrive)
    residual, path_m, oracle = other.residual, other.path_m, other.residual.oracle
    assert isinstance(oracle, float)
    # If even the truth leaves that much, the effects are too large there for a linear residual.
    is_linear = oracle < NOT_LINEAR * other.rows
    could = residual.before - oracle
    share = (residual.before - residual.after) / could if could > LEAST_GAIN and is_linear else None
    worse = math.sqrt(residual.after / residual.before) > 1.0 + WORSE if is_linear else None
    # If even the truth makes the path worse, that drive's noise dominates.
    best_m = max(path_m.before, path_m.oracle if isinstance(path_m.oracle, float) else 0.0)
    return share, worse, path_m.after > (1.0 + WORSE) * best_m


def _matches(right: Sequence[str], classes: Sequence[set[str]]) -> bool:
    """Whether findings and effects match one to one."""
    if len(right) != len(classes):
        return False
    orders = itertools.permutations(right)
    return any(all(name in names for name, names in zip(order, classes, strict=True)) for order in orders)


def wilson(successes: int, n: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927); (0, 1) if n is 0."""
    if n == 0:
        return 0.0, 1.0
    found: Any = binomtest(successes, n).proportion_ci(0.95, "wilson")
    return found.low, found.high
