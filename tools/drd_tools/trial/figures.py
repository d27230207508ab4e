"""The figures of a trial as tables: printed, put on the page and quoted, but computed here only."""

import statistics
from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

from drd_tools.trial.score import Record, Score, of_names, score, wilson

Row = list[str]
Pair = tuple[Record, Score]
OURS: Final = "drd"


class Table(NamedTuple):
    """`caption` says what is in it; the first column holds text."""

    caption: str
    header: Row
    rows: list[Row]


class Figures:
    """All tables of a trial's records."""

    def __init__(self, records: Sequence[Record]):
        self.not_made = [r for r in records if "not_made" in r]
        self.pairs: list[Pair] = [(r, score(r)) for r in records if "not_made" not in r]
        self.kinds = sorted({r["kind"] for r, _ in self.pairs}, key=_kind_order)

    def of(self, *kinds: str) -> list[Pair]:
        """Records whose kind is one of these."""
        return [p for p in self.pairs if p[0]["kind"] in kinds]

    @property
    def null_kinds(self) -> list[str]:
        """Kinds in which nothing is missing."""
        return [k for k in self.kinds if "null" in k]

    @property
    def unknown_kinds(self) -> list[str]:
        """Kinds of what is in no catalogue."""
        return [k for k in self.kinds if k.startswith("unknown")]

    @property
    def named_kinds(self) -> list[str]:
        """Kinds with effects of the catalogue."""
        return [k for k in self.kinds if k not in (*self.null_kinds, *self.unknown_kinds)]

    def tables(self) -> list[Table]:
        """All that have anything in them."""
        first = self.nulls(), self.found(), self.sets(), self.unknown(), self.sizes(), self.other_drive()
        return [t for t in (*first, self.methods(), self.effects()) if t.rows]

    def nulls(self) -> Table:
        """False claims."""
        rows = [_null_row(kind, self.of(kind)) for kind in self.null_kinds]
        if len(rows) > 1:
            rows.append(_null_row("all", self.of(*self.null_kinds)))
        header = ["kind", "n", "any claim", "", "above suspected", ""]
        return Table("Nothing is missing, and yet something is claimed (95 % Wilson intervals)", header, rows)

    def found(self) -> Table:
        """The name that comes first, and names that are wrong."""
        header = ["kind", "n", "verdict", "top-1", "", "top-1 class", "", "false names", ""]
        caption = (
            "Something is missing: the first name (top-1: the name itself; class: it is among those that it also fits; "
            "separable: no other name, nor one less, would do as well without noise; false names: of all names, wrong "
            "even as a class)"
        )
        return Table(caption, header, [_found_row(*pair) for pair in self._with_separable()])

    def sets(self) -> Table:
        """All names together."""
        rows = [
            [kind, str(len(pairs)), *share(s.exact for _, s in pairs), *share(s.exact_class for _, s in pairs)]
            for kind, pairs in self._with_separable()
        ]
        return Table("Something is missing: exactly the right names", ["kind", "n", "set", "", "set class", ""], rows)

    def _with_separable(self) -> list[tuple[str, list[Pair]]]:
        kinds = [(k, self.of(k)) for k in self.named_kinds]
        apart = [
            (f"{k}, separable", chosen) for k, pairs in kinds if (chosen := [p for p in pairs if _is_separable(p)])
        ]
        return [*kinds, *apart]

    def unknown(self) -> Table:
        """What is in no catalogue."""
        pairs = self.of(*self.unknown_kinds)
        causes = sorted({r["effects"][0]["effect"] for r, _ in pairs})
        groups = [(c, [p for p in pairs if p[0]["effects"][0]["effect"] == c]) for c in causes]
        if len(groups) > 1:
            groups.append(("all", pairs))
        rows = [
            [
                name, str(len(chosen)), *share(s.flagged for _, s in chosen), *share(s.misnamed for _, s in chosen),
                share(not s.claims for _, s in chosen)[0],
            ]
            for name, chosen in groups
        ]  # fmt: skip
        header = ["cause", "n", "flagged", "", "misnamed", "", "silent"]
        return Table(
            "In no catalogue (flagged: unknown is said; misnamed: a name is, and unknown is not)", header, rows
        )

    def sizes(self) -> Table:
        """Intervals and windows."""
        rows = []
        for kind in self.named_kinds:
            pairs = self.of(kind)
            inside = [i.inside for _, s in pairs for i in s.intervals]
            overlaps = [iou for _, s in pairs for _, iou in s.windows]
            rows.append([kind, str(len(inside)), *share(inside), str(len(overlaps)), _median(overlaps)])
        caption = "What was named right: truth within the 90 % intervals, and overlap of the windows of time"
        return Table(caption, ["kind", "parameters", "inside", "", "windows", "median overlap"], rows)

    def other_drive(self) -> Table:
        """Held-out improvement."""
        rows = []
        for kind in self.kinds:
            scores = [s for _, s in self.of(kind) if s.worse_path is not None]
            if scores:
                shares = [s.share for s in scores if s.share is not None]
                quarter = statistics.quantiles(shares, n=4)[0] if len(shares) > 1 else None
                rows.append([
                    kind, str(len(scores)), str(len(shares)), _median(shares),
                    "-" if quarter is None else f"{quarter:.2f}",
                    str(sum(s.worse or False for s in scores)), str(sum(s.worse_path or False for s in scores)),
                ])  # fmt: skip
        header = ["kind", "n", "counted", "median", "lower quartile", "residual worse", "path worse"]
        caption = (
            "Another drive of the same robot: share of the oracle's improvement of the residual (counted where that is "
            "no noise, and not too large for a linear model), and how often it is worse than no correction by more "
            "than 2 %; the path: also worse than with the truth taken off"
        )
        return Table(caption, header, rows)

    def methods(self) -> Table:
        """Beside what others would do."""
        names = sorted({name for r, _ in self.pairs for name in r.get("baselines", {})})
        rows = [[kind, *self._method_cells(self._with_methods(names, kind), names)] for kind in self.kinds]
        header = ["kind", "n"]
        for name in (OURS, *names):
            header += [f"{name}: claims", "top-1", "set"]
        rows = [r for r in rows if r[1] != "0"] if names else []
        return Table("Beside sparse regressions of the same library on the same recordings", header, rows)

    def _with_methods(self, names: Sequence[str], *kinds: str) -> list[Pair]:
        return [p for p in self.of(*kinds) if all(name in p[0].get("baselines", {}) for name in names)]

    @staticmethod
    def _method_cells(pairs: Sequence[Pair], names: Sequence[str]) -> Row:
        cells = [str(len(pairs))]
        for name in (OURS, *names):
            scores = [s if name == OURS else of_names(r, r["baselines"][name]) for r, s in pairs]
            nothing = not any(r["effects"] for r, _ in pairs)
            cells.append(share(s.claims for s in scores)[0])
            cells += ["-", "-"] if nothing else [share(s.top_1 for s in scores)[0], share(s.exact for s in scores)[0]]
        return cells

    def effects(self) -> Table:
        """Each effect of the catalogue alone."""
        kinds = [k for k in self.named_kinds if k.startswith("single d=") or k == "single event"]
        pairs = self.of(*kinds)
        rows = []
        for name in sorted({r["effects"][0]["effect"] for r, _ in pairs}):
            own = [p for p in pairs if p[0]["effects"][0]["effect"] == name]
            inside = [i.inside for _, s in own for i in s.intervals]
            overlaps = [iou for _, s in own for _, iou in s.windows]
            shares = [s.share for _, s in own if s.share is not None]
            cells = [share(s.top_1 for r, s in own if r["kind"] == kind)[0] for kind in kinds]
            all_of_it = [str(len(own)), *share(s.top_1 for _, s in own), share(s.top_1_class for _, s in own)[0]]
            rows.append([name, *cells, *all_of_it, share(inside)[0], _median(overlaps), _median(shares)])
        header = ["effect", *(k.removeprefix("single ") for k in kinds), "n", "top-1", "", "class", "coverage",
                  "overlap", "of the oracle"]  # fmt: skip
        return Table("Each effect alone: top-1 by visibility d, and all together", header, rows)

    def quoted(self) -> Table:
        """The few figures that a reader asks for first, beside other methods."""
        names = sorted({name for r, _ in self.pairs for name in r.get("baselines", {})})
        rows: list[Row] = []

        def add(text: str, pairs: Sequence[Pair], of: Callable[[Score], bool]) -> None:
            if not pairs:
                return
            cells = [_said(of(s) for _, s in pairs)]
            for name in names:
                own = [r for r, _ in pairs if name in r.get("baselines", {})]
                shown = share(of(of_names(r, r["baselines"][name])) for r in own)[0]
                cells.append(shown if len(own) in (0, len(pairs)) else f"{shown} of {len(own)}")
            rows.append([text, str(len(pairs)), *cells])

        add("nothing is missing, something is claimed", self.of(*self.null_kinds), lambda s: s.claims)
        for kind in self.named_kinds:
            pairs = self.of(kind)
            if kind.startswith("single d=") or kind == "single event":
                add(f"{kind}: the right name first", pairs, lambda s: s.top_1)
                add(
                    f"{kind}: the right name, or one that the drive cannot tell from it", pairs, lambda s: s.top_1_class
                )
                apart = [p for p in pairs if _is_separable(p)]
                add(f"{kind}: the right name first, on drives that tell it from all others", apart, lambda s: s.top_1)
        for kind in self.named_kinds:
            if kind.startswith(("pair", "triple")):
                pairs, set_text = self.of(kind), f"{kind}: exactly the right set"
                add(set_text, pairs, lambda s: s.exact)
                add(f"{set_text}, up to what cannot be told apart", pairs, lambda s: s.exact_class)
        add("in no catalogue: flagged as unknown", self.of(*self.unknown_kinds), lambda s: s.flagged)
        rows += self._quoted_ours(len(names))
        return Table("", ["figure (95 % Wilson interval)", "n", OURS, *names], rows)

    def _quoted_ours(self, others: int) -> list[Row]:
        named = [s for _, s in self.of(*self.named_kinds)]
        claims, inside = sum(s.named for s in named), [i.inside for s in named for i in s.intervals]
        false = [True] * sum(s.false_named for s in named)
        overlaps = [iou for s in named for _, iou in s.windows]
        shares = [s.share for s in named if s.share is not None]
        judged = [s for _, s in self.pairs if s.worse is not None]
        driven = [s for _, s in self.pairs if s.worse_path is not None]
        rows: list[tuple[str, int, str]] = [
            ("names that are wrong even as a class", claims, _said(false + [False] * (claims - len(false)))),
            ("truth within the 90 % intervals", len(inside), _said(inside)),
            ("median overlap of windows of time", len(overlaps), _median(overlaps)),
            ("median share of the oracle's improvement on another drive", len(shares), _median(shares)),
            ("residual of another drive worse by more than 2 %", len(judged), _count(s.worse for s in judged)),
            ("path of another drive worse by more than 2 %", len(driven), _count(s.worse_path for s in driven)),
        ]
        return [[text, str(n), value, *[""] * others] for text, n, value in rows if n]


def markdown(table: Table) -> str:
    """As a README has it."""
    rule = ["---", *["---:"] * (len(table.header) - 1)]
    return "\n".join("| " + " | ".join(row) + " |" for row in (table.header, rule, *table.rows)) + "\n"


def share(yes: Iterable[bool]) -> Row:
    """A share with its interval, as two cells."""
    flags = list(yes)
    if not flags:
        return ["-", ""]
    low, high = wilson(sum(flags), len(flags))
    return [f"{sum(flags) / len(flags):.2f}", f"({low:.2f}..{high:.2f})"]


def _said(yes: Iterable[bool]) -> str:
    return " ".join(share(yes))


def _count(yes: Iterable[bool | None]) -> str:
    return str(sum(map(bool, yes)))


def _median(values: Sequence[float]) -> str:
    return f"{statistics.median(values):.2f}" if values else "-"


def _kind_order(kind: str) -> tuple[str, float, str]:
    """Single d=8 before d=12."""
    name, _, d = kind.partition(" d=")
    return name, float(d or 0.0), kind


def _is_separable(pair: Pair) -> bool:
    """Whether no other name, nor one less, would do as well without noise."""
    effects = pair[0]["effects"]
    return bool(effects) and all(e.get("separable") for e in effects)


def _null_row(kind: str, pairs: Sequence[Pair]) -> Row:
    scores = [s for _, s in pairs]
    return [kind, str(len(pairs)), *share(s.claims for s in scores), *share(s.sure_claims for s in scores)]


def _found_row(kind: str, pairs: Sequence[Pair]) -> Row:
    scores = [s for _, s in pairs]
    false = [k < s.false_named for s in scores for k in range(s.named)]
    return [
        kind, str(len(pairs)), share(s.verdict for s in scores)[0],
        *share(s.top_1 for s in scores), *share(s.top_1_class for s in scores), *share(false),
    ]  # fmt: skip
