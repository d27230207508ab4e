"""Score of a diagnosis on a real drive with a planted effect, relative to that of the untouched drive."""

import math
from collections.abc import Callable, Sequence
from typing import Final

from msgspec import Struct, UnsetType
from msgspec.structs import replace

from drd.effects.catalogue import catalogue
from drd.effects.effect import END, START
from drd_tools.diagnose.results import Finding
from drd_tools.trial.ceiling import ceiling_of
from drd_tools.trial.figures import Cells, Table, mean, quantile, share
from drd_tools.trial.plant import DISTANCES
from drd_tools.trial.results import Planted, Row, TrueEffect, Untouched
from drd_tools.trial.score import Interval, estimates, overlap

SIGMAS: Final = 3.0
SHARE: Final = 0.1
SAME_WINDOW: Final = 0.5  # overlap
FACTORS: Final = {"gyro_scale_error": 1.0, "tread_error": 1.0, "wheel_radius_error": -1.0}


class Judged(Struct, frozen=True):
    """Score of a planted effect. `first`: it comes before all other names not reported in the untouched drive.

    `in_class`: a finding has its name, or also fits it. `sized`: its choices are right, and each size is within SIGMAS
    of the planted one added to that of the untouched drive, or within SHARE of it if the estimate has no standard
    deviation; times are judged by the `overlap` of windows. `extra`: names that are neither. `ceiling`: that of the
    name, given what was found in the untouched drive.
    """

    effect: str
    kind: str
    first: bool
    in_class: bool
    sized: bool
    intervals: tuple[Interval, ...]
    overlap: float | None
    extra: tuple[str, ...]
    ceiling: float | None


def judged(record: Planted, untouched: Untouched) -> Judged:
    """Judge a planted drive by the untouched one."""
    (true,) = record.effects
    before = {f.effect for f in untouched.findings}
    said = [f for f in record.findings if f.effect == true.effect or f.effect not in before]
    fitting = [f for f in record.findings if f.is_named and true.effect in (f.effect, *f.also_fits)]
    own = [f for f in fitting if f.effect == true.effect]
    mine = max(own, key=lambda f: overlap(true, f) or 0.0, default=None)
    on_top = [] if mine is None else _on_top(true, mine, untouched.findings)
    sizes = [i for i in on_top if i.parameter not in (START.name, END.name)]
    words = {n: v for n, v in true.parameters.items() if isinstance(v, str)}
    return Judged(
        effect=true.effect,
        kind=record.kind,
        first=bool(said) and said[0].effect == true.effect,
        in_class=bool(fitting),
        sized=mine is not None and mine.choices == words and all(map(_is_near, sizes)),
        intervals=tuple(i for i in on_top if i.std > 0.0),
        overlap=None if mine is None else overlap(true, mine),
        extra=tuple(f.effect for f in said if f.is_named and f not in fitting),
        ceiling=ceiling_of(record),
    )


def _is_near(i: Interval) -> bool:
    return abs(i.sigmas) <= SIGMAS if i.std > 0.0 else abs(i.value - i.true) <= SHARE * abs(i.true)


def _on_top(true: TrueEffect, mine: Finding, untouched: Sequence[Finding]) -> list[Interval]:
    """Estimates against the planted effect combined with the untouched drive's own, whose uncertainty is included."""
    there = next((f for f in untouched if f.effect == true.effect and _is_alike(true, f)), None)
    own = {} if isinstance(true.own, UnsetType) else true.own
    before = {**own, **({} if there is None else there.parameters)}
    return [
        replace(
            i,
            true=composed(true.effect, i.parameter, was.value, i.true),
            std=math.hypot(i.std, 0.0 if math.isnan(was.std) else was.std),
        )
        if (was := before.get(i.parameter))
        else i
        for i in estimates(true, mine)
    ]


def _is_alike(true: TrueEffect, finding: Finding) -> bool:
    """Whether a finding has the choices and the window of an effect, so that their sizes add."""
    words = {n: v for n, v in true.parameters.items() if isinstance(v, str)}
    return finding.choices == words and (overlap(true, finding) or 0.0) >= SAME_WINDOW * (START.name in true.parameters)


def composed(effect: str, parameter: str, before: float, planted: float) -> float:
    """Parameter of two instances of the same effect combined, in the catalogue's unit.

    Factors multiply; the lower limit and the wider band apply; a time, a time constant and a phase are those of the
    planted one; sizes add.
    """
    if effect in FACTORS:
        return before + planted + FACTORS[effect] * before * planted
    q = next(q for q in catalogue()[effect].parameters if q.name == parameter)
    if q.neutral:
        return before * planted
    if effect in ("gyro_saturation", "gyro_deadband"):
        return min(before, planted) if effect == "gyro_saturation" else max(before, planted)
    is_size = q.linear or not catalogue()[effect].linear()
    return before + planted if is_size and not q.moment else planted


def planted_table(rows: Sequence[Row]) -> Table:
    """Table with one row per effect, by distance d, and one for all."""
    untouched = {r.case: r for r in rows if isinstance(r, Untouched)}
    scores = [judged(r, untouched[r.base]) for r in rows if isinstance(r, Planted) and r.base in untouched]
    kinds = [f"planted d{d:g}" for d in DISTANCES]
    titles: dict[str, Callable[[Judged], bool]] = {
        "first": lambda s: s.first, "class": lambda s: s.in_class, "size": lambda s: s.sized,
    }  # fmt: skip
    header = ["effect", "n", *(f"{title} {k.rpartition(' ')[2]}" for title in titles for k in kinds)]
    cells: list[Cells] = []
    for name in [*catalogue(), "all"]:
        own = [s for s in scores if name in (s.effect, "all")]
        if not own:
            continue
        inside = [i.inside for s in own for i in s.intervals]
        overlaps = [s.overlap for s in own if s.overlap is not None]
        by_kind = [share(is_so(s) for s in own if s.kind == k)[0] for is_so in titles.values() for k in kinds]
        extra = f"{sum(len(s.extra) for s in own) / len(own):.2f}"
        cells.append([name, str(len(own)), *by_kind, *share(inside), quantile(overlaps), extra])
        cells[-1].append(mean([s.ceiling for s in own if s.ceiling is not None]))
    caption = (
        "Planted in real drives (first: named before all that is not reported of the untouched drive; class: a finding "
        f"is it or also fits it; size: all its sizes within {SIGMAS:g} sigma of the planted upon the untouched "
        "drive's; coverage: truth within the 90 % intervals; extra: names a drive that are neither; ceiling: no method "
        "has more names right, where the nearest other is as likely and the noise is as the diagnosis weighs it)"
    )
    return Table(caption, [*header, "coverage", "", "overlap", "extra", "ceiling"], cells)


def not_visible(rows: Sequence[Row]) -> Table:
    """Table of how many untouched drives cannot show an effect at a distance d at any plausible size."""
    drives = [r for r in rows if isinstance(r, Untouched)]
    counts = {
        name: [sum(f"{r.case}.{name}.d{d:g}" in r.not_visible for r in drives) for d in DISTANCES]
        for name in catalogue()
    }
    cells = [[name, *(f"{n} of {len(drives)}" for n in row)] for name, row in counts.items() if any(row)]
    return Table(
        "Not visible in a drive with this d at any plausible size, and not scored",
        ["effect", *(f"d{d:g}" for d in DISTANCES)],
        cells,
    )


def reported(rows: Sequence[Row]) -> list[str]:
    """Describe each planted effect in a line or two: its score, its sizes, and the names reported."""
    untouched, lines = {r.case: r for r in rows if isinstance(r, Untouched)}, []
    for record in sorted((r for r in rows if isinstance(r, Planted) and r.base in untouched), key=lambda r: r.case):
        s, base = judged(record, untouched[record.base]), untouched[record.base]
        marks = [word for word, yes in (("first", s.first), ("class", s.in_class), ("size", s.sized)) if yes]
        before = {f.effect for f in base.findings}
        names = [f.effect if f.effect in before else f"+{f.effect}" for f in record.findings]
        lines.append(f"{record.case}: {', '.join(marks) or 'missed'}; reported {', '.join(names) or 'nothing'}")
        sizes = [f"{i.parameter} {i.value:.4g} +- {i.std:.2g} ({i.true:.4g})" for i in s.intervals]
        lines += [f"    estimate (and truth) {', '.join(sizes)}"] if sizes else []
    return lines
