"""Figures of a trial as tables, for terminal, page and README, computed only here.

A table evaluates columns over groups of pairs, each a record with its score; `Figures` has the groups.
"""

import statistics
from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

from drd_tools.trial.results import NotMade, Record, Row
from drd_tools.trial.score import Score, calibration_error, of_names, score, wilson

Cells = list[str]
Pair = tuple[Record, Score]
Group = tuple[str, list[Pair]]
OURS: Final = "drd"


class Table(NamedTuple):
    """A table with its caption; the first column holds text."""

    caption: str
    header: Cells
    rows: list[Cells]


class Column(NamedTuple):
    """A figure of a group, as one cell or, with its interval, as two."""

    titles: Cells
    cells: Callable[[Sequence[Pair]], Cells]


def _rate(title: str, of: Callable[[Score], Iterable[bool]], width: int = 2) -> Column:
    return Column([title, ""][:width], lambda pairs: share(yes for _, s in pairs for yes in of(s))[:width])


def _count(title: str, of: Callable[[Score], Iterable[object]]) -> Column:
    return Column([title], lambda pairs: [str(sum(1 for _, s in pairs for _ in of(s)))])


def _median(title: str, of: Callable[[Score], Iterable[float]], quarter: int = 2) -> Column:
    return Column([title], lambda pairs: [quantile([x for _, s in pairs for x in of(s)], quarter)])


def _mean(title: str, of: Callable[[Score], Iterable[float]]) -> Column:
    return Column([title], lambda pairs: [mean([x for _, s in pairs for x in of(s)])])


def _ceiling(s: Score) -> list[float]:
    return [] if s.ceiling is None else [s.ceiling]


def _shares(s: Score) -> list[float]:
    return [] if s.share is None else [s.share]


def _inside(s: Score) -> list[bool]:
    return [i.inside for i in s.intervals]


def _overlaps(s: Score) -> list[float]:
    return [iou for _, iou in s.windows]


def _false(s: Score) -> list[bool]:
    return [k < s.false_named for k in range(s.named)]


N: Final = _count("n", lambda _: [True])
NULLS: Final = [N, _rate("any finding", lambda s: [s.reports]), _rate("above suspected", lambda s: [s.sure_reports])]
FOUND: Final = [
    N, _rate("verdict", lambda s: [s.verdict], 1), _rate("top-1", lambda s: [s.top_1]),
    _mean("ceiling", lambda s: _ceiling(s) if s.effects == 1 else []),
    _rate("top-1 class", lambda s: [s.top_1_class]), _rate("false names", _false),
]  # fmt: skip
SETS: Final = [
    N,
    _rate("set", lambda s: [s.exact]),
    _mean("ceiling", _ceiling),
    _rate("set class", lambda s: [s.exact_class]),
]
HIDDEN: Final = [
    N, _rate("flagged", lambda s: [s.flagged]), _mean("ceiling", _ceiling), _rate("misnamed", lambda s: [s.misnamed]),
    _rate("silent", lambda s: [not s.reports], 1),
]  # fmt: skip
SIZES: Final = [
    _count("parameters", _inside), _rate("inside", _inside),
    _count("windows", _overlaps), _median("median overlap", _overlaps),
]  # fmt: skip
OTHER_DRIVE: Final = [
    N, _count("counted", _shares), _median("median", _shares), _median("lower quartile", _shares, 1),
    _count("residual worse", lambda s: [True] * bool(s.worse)),
    _count("path worse", lambda s: [True] * bool(s.worse_path)),
]  # fmt: skip
ALONE: Final = [
    N, _rate("top-1", lambda s: [s.top_1]), _mean("ceiling", _ceiling),
    _rate("class", lambda s: [s.top_1_class], 1), _rate("coverage", _inside, 1),
    _median("overlap", _overlaps), _median("of the oracle", _shares),
]  # fmt: skip
TITLES: Final = {
    "nulls": "Nothing is missing, and yet something is reported (95 % Wilson intervals)",
    "found": "Something is missing: the first name (top-1: the name itself; class: it is among those that it also "
    "fits; separable: no other name, nor one less, would do as well without noise; false names: of all names, wrong "
    "even as a class; ceiling: no method has more first names right, on average, where the nearest other name is as "
    "likely; a rate above it leans to the names of its row, or is luck)",
    "sets": "Something is missing: exactly the right names (ceiling: with that effect exchanged which is nearest to "
    "another)",
    "hidden": "In no catalogue (flagged: unknown is reported; misnamed: a name is, and unknown is not; ceiling: of "
    "telling it from the nearest name)",
    "drives": "Ceiling of each drive (for each effect what is nearest in its place, at the whitened distance d, and "
    "Phi(d/2), above which no method tells the two; at least: what the best method reaches among all names)",
    "sizes": "What was named right: truth within the 90 % intervals, and overlap of the windows of time",
    "other drive": "Another drive of the same robot: share of the oracle's improvement of the residual (counted where "
    "that is no noise, and not too large for a linear model), and how often it is worse than no correction by more "
    "than 2 %; the path: also worse than with the truth taken off",
    "methods": "Beside sparse regressions of the same library on the same recordings",
    "alone": "Each effect alone: top-1 by detectability d, and all together",
}


class Figures:
    """All tables of a trial's records."""

    def __init__(self, rows: Sequence[Row]):
        self.not_made = [r for r in rows if isinstance(r, NotMade)]
        self.pairs: list[Pair] = [(r, score(r)) for r in rows if isinstance(r, Record)]
        self.kinds = sorted({r.kind for r, _ in self.pairs}, key=_kind_order)
        self.null_kinds = [k for k in self.kinds if "null" in k]
        self.unknown_kinds = [k for k in self.kinds if k.startswith("unknown")]
        self.named_kinds = [k for k in self.kinds if k not in (*self.null_kinds, *self.unknown_kinds)]
        self.single_kinds = [k for k in self.named_kinds if k.startswith("single d=") or k == "single event"]
        self.methods = sorted({name for r, _ in self.pairs for name in r.baselines})

    def of(self, *kinds: str) -> list[Pair]:
        """Records whose kind is one of these."""
        return [p for p in self.pairs if p[0].kind in kinds]

    def tables(self) -> list[Table]:
        """Tables that are not empty."""
        kinds, named = self._groups(self.kinds), self._groups(self.named_kinds)
        apart = [(f"{k}, separable", chosen) for k, pairs in named if (chosen := list(filter(_is_separable, pairs)))]
        driven = [(k, [p for p in pairs if p[1].worse_path is not None]) for k, pairs in kinds]
        hidden = _with_all(by_effect(self.of(*self.unknown_kinds)))
        made = [
            _table("nulls", "kind", _with_all(self._groups(self.null_kinds)), NULLS),
            _table("found", "kind", [*named, *apart], FOUND),
            _table("sets", "kind", [*named, *apart], SETS),
            _table("hidden", "cause", hidden, HIDDEN),
            _table("sizes", "kind", named, SIZES),
            _table("other drive", "kind", driven, OTHER_DRIVE),
            self._beside_methods(kinds),
            self._alone(),
        ]
        return [t for t in made if t.rows]

    def _groups(self, kinds: Sequence[str]) -> list[Group]:
        return [(k, self.of(k)) for k in kinds]

    def _beside_methods(self, kinds: Sequence[Group]) -> Table:
        names, header, rows = [OURS, *self.methods], ["kind", "n"], []
        for name in names:
            header += [f"{name}: reports", "top-1", "set"]
        for kind, pairs in kinds:
            both = [p for p in pairs if all(n in p[0].baselines for n in self.methods)]
            cells = [kind, str(len(both))]
            for name in names:
                scores = by_method(name, both)
                missing = [s for r, s in scores if r.effects]
                cells += share(s.reports for _, s in scores)[:1] + share(s.top_1 for s in missing)[:1]
                cells += share(s.exact for s in missing)[:1]
            rows += [cells] if both and self.methods else []
        return Table(TITLES["methods"], header, rows)

    def _alone(self) -> Table:
        """Each effect of the catalogue alone."""

        def only(kind: str) -> Column:
            title = kind.removeprefix("single ")
            return Column([title], lambda pairs: [share(s.top_1 for r, s in pairs if r.kind == kind)[0]])

        groups = by_effect(self.of(*self.single_kinds))
        return _table("alone", "effect", groups, [*map(only, self.single_kinds), *ALONE])

    def drives(self) -> Table:
        """Each true effect of each drive that has a ceiling, the lowest first."""
        known = [(e, r, s) for r, s in self.pairs for e in r.effects if isinstance(e.ceiling, float)]
        cells = []
        for e, r, s in sorted(known, key=lambda k: (k[0].distance, k[1].case)):
            seen = f"{e.detectability:.1f}" if isinstance(e.detectability, float) else "-"
            limits = [f"{e.distance:.2f}", f"{e.ceiling:.3f}", f"{e.least:.3f}"]
            cells.append([r.case, e.effect, seen, str(e.nearest), *limits, "yes" if s.exact else "no"])
        header = ["case", "effect", "seen with d", "nearest", "distance d", "ceiling", "at least", "names right"]
        return Table(TITLES["drives"], header, cells)

    def quoted(self) -> Table:
        """The key figures, next to those of other methods."""
        rows: list[Cells] = []

        def add(text: str, pairs: Sequence[Pair], yes: Callable[[Score], bool], bounded: bool = False) -> None:
            if not pairs:
                return
            highest = mean([c for _, s in pairs for c in _ceiling(s)]) if bounded else "-"
            cells = [" ".join(share(yes(s) for _, s in pairs))]
            for name in self.methods:
                own = [r for r, _ in pairs if name in r.baselines]
                shown = share(yes(of_names(r, name)) for r in own)[0]
                cells.append(shown if len(own) in (0, len(pairs)) else f"{shown} of {len(own)}")
            rows.append([text, str(len(pairs)), *cells, highest])

        add("nothing is missing, something is reported", self.of(*self.null_kinds), lambda s: s.reports)
        for kind, pairs in self._groups(self.single_kinds):
            add(f"{kind}: the right name first", pairs, lambda s: s.top_1, True)
            add(f"{kind}: the right name, or one that the drive cannot tell from it", pairs, lambda s: s.top_1_class)
            apart = list(filter(_is_separable, pairs))
            text = f"{kind}: the right name first, on drives that tell it from all others"
            add(text, apart, lambda s: s.top_1, True)
        for kind, pairs in self._groups(self.named_kinds):
            if kind.startswith(("pair", "triple")):
                right = f"{kind}: exactly the right set"
                add(right, pairs, lambda s: s.exact, True)
                add(f"{right}, up to what cannot be told apart", pairs, lambda s: s.exact_class)
                apart = list(filter(_is_separable, pairs))
                add(f"{right}, on drives that tell each from all others", apart, lambda s: s.exact, True)
        add("in no catalogue: flagged as unknown", self.of(*self.unknown_kinds), lambda s: s.flagged, True)
        rows += [[*row, *[""] * (len(self.methods) + 1)] for row in self._quoted_ours()]
        return Table("", ["figure (95 % Wilson interval)", "n", OURS, *self.methods, "ceiling"], rows)

    def _quoted_ours(self) -> list[Cells]:
        named, all_scores = [s for _, s in self.of(*self.named_kinds)], [s for _, s in self.pairs]
        false, inside = [x for s in named for x in _false(s)], [x for s in named for x in _inside(s)]
        sure, brier = [x for _, s in self.pairs for x in s.probabilities], [x for _, s in self.pairs for x in s.brier]
        overlaps, shares = [x for s in named for x in _overlaps(s)], [x for s in named for x in _shares(s)]
        residual = [s.worse for s in all_scores if s.worse is not None]
        path = [s.worse_path for s in all_scores if s.worse_path is not None]
        rows: list[tuple[str, Sequence[object], str]] = [
            ("names that are wrong even as a class", false, " ".join(share(false))),
            ("truth within the 90 % intervals", inside, " ".join(share(inside))),
            ("expected calibration error of the names' probabilities", sure, f"{calibration_error(sure):.2f}"),
            ("Brier score of the names' probabilities", brier, f"{sum(brier) / max(len(brier), 1):.2f}"),
            ("median overlap of windows of time", overlaps, quantile(overlaps)),
            ("median share of the oracle's improvement on another drive", shares, quantile(shares)),
            ("residual of another drive worse by more than 2 %", residual, str(sum(residual))),
            ("path of another drive worse by more than 2 %", path, str(sum(path))),
        ]
        return [[text, str(len(values)), shown] for text, values, shown in rows if values]


def _table(title: str, first: str, groups: Sequence[Group], columns: Sequence[Column]) -> Table:
    header = [first, *(t for column in columns for t in column.titles)]
    rows = [[name, *(cell for column in columns for cell in column.cells(pairs))] for name, pairs in groups if pairs]
    return Table(TITLES[title], header, rows)


def by_effect(pairs: Sequence[Pair]) -> list[Group]:
    """Groups by the name of the first effect."""
    names = sorted({r.effects[0].effect for r, _ in pairs})
    return [(name, [p for p in pairs if p[0].effects[0].effect == name]) for name in names]


def by_method(name: str, pairs: Sequence[Pair]) -> list[Pair]:
    """Replace the scores by those of a method, for the records on which it ran."""
    return [(r, s if name == OURS else of_names(r, name)) for r, s in pairs if name == OURS or name in r.baselines]


def _with_all(groups: list[Group]) -> list[Group]:
    return groups if len(groups) < 2 else [*groups, ("all", [p for _, pairs in groups for p in pairs])]


def markdown(table: Table) -> str:
    """Format a table in Markdown."""
    rule = ["---", *["---:"] * (len(table.header) - 1)]
    return "\n".join("| " + " | ".join(row) + " |" for row in (table.header, rule, *table.rows)) + "\n"


def share(yes: Iterable[bool]) -> Cells:
    """A share with its interval, as two cells."""
    flags = list(yes)
    if not flags:
        return ["-", ""]
    low, high = wilson(sum(flags), len(flags))
    return [f"{sum(flags) / len(flags):.2f}", f"({low:.2f}..{high:.2f})"]


def mean(values: Sequence[float]) -> str:
    """The mean as a cell."""
    return f"{statistics.fmean(values):.2f}" if values else "-"


def quantile(values: Sequence[float], quarter: int = 2) -> str:
    """The median, or another quartile, as a cell."""
    if len(values) < 2:
        return f"{values[0]:.2f}" if len(values) and quarter == 2 else "-"
    return f"{statistics.quantiles(values, n=4)[quarter - 1]:.2f}"


def _kind_order(kind: str) -> tuple[str, float, str]:
    """Sort key: single d=8 before d=12."""
    name, _, d = kind.partition(" d=")
    return name, float(d or 0.0), kind


def _is_separable(pair: Pair) -> bool:
    """Whether no other name, nor omitting one, would do as well without noise."""
    effects = pair[0].effects
    return bool(effects) and all(e.separable is True for e in effects)
