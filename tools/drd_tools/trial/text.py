"""The figures of a trial as text."""

import shlex
from collections.abc import Iterable, Sequence
from typing import Any

from drd_tools.trial.score import Record, Score, score, wilson

Row = list[str]


def told(results: dict[str, Any]) -> str:
    """All of a trial: figures, false claims, and what was confused."""
    records = [r for r in results["records"] if "not_made" not in r]
    scored = [(r, score(r)) for r in records]
    kinds = sorted({r["kind"] for r in records})
    nulls = [(k, [p for p in scored if p[0]["kind"] == k]) for k in kinds if "null" in k]
    others = [(k, [p for p in scored if p[0]["kind"] == k]) for k in kinds if "null" not in k]
    lines: list[str] = []
    if nulls:
        lines += ["Nothing is missing, and yet something is claimed (95 % Wilson intervals)"]
        lines += table([["kind", "n", "any claim", "", "above suspected", ""], *(_null_row(*pair) for pair in nulls)])
    if others:
        lines += ["", "Something is missing (strict: the name itself; class: it is among those that it also fits)"]
        head = ["kind", "n", "verdict", "top-1", "", "top-1 class", "", "set", "", "set class", ""]
        lines += table([head, *(_row(*pair) for pair in others), *_separable(others)])
        lines += ["", "90 % intervals of the parameters of what was named right: share that holds the truth"]
        lines += table([["kind", "n", "inside", ""], *(_coverage(*pair) for pair in others)])
    lines += _confused([p for _, pairs in nulls for p in pairs], "False claims", results["arguments"])
    lines += _confused([p for _, pairs in others for p in pairs if not p[1].exact], "Confused", results["arguments"])
    lines += _outside([p for _, pairs in others for p in pairs])
    lines += _not_made(results["records"])
    return "\n".join(lines)


def table(rows: Sequence[Row]) -> list[str]:
    """Aligned columns; the first to the left, others to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  " + "  ".join(c.ljust(w) if not i else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in rows
    ]


def share(yes: Iterable[bool]) -> Row:
    """A share with its interval, as two cells."""
    flags = list(yes)
    if not flags:
        return ["-", ""]
    low, high = wilson(sum(flags), len(flags))
    return [f"{sum(flags) / len(flags):.2f}", f"({low:.2f}..{high:.2f})"]


def _null_row(kind: str, pairs: Sequence[tuple[Record, Score]]) -> Row:
    scores = [s for _, s in pairs]
    return [kind, str(len(pairs)), *share(s.claims for s in scores), *share(s.sure_claims for s in scores)]


def _row(kind: str, pairs: Sequence[tuple[Record, Score]]) -> Row:
    scores = [s for _, s in pairs]
    return [
        kind, str(len(pairs)), share(s.verdict for s in scores)[0],
        *share(s.top_1 for s in scores), *share(s.top_1_class for s in scores),
        *share(s.exact for s in scores), *share(s.exact_class for s in scores),
    ]  # fmt: skip


def _separable(kinds: Sequence[tuple[str, Sequence[tuple[Record, Score]]]]) -> list[Row]:
    """The same, without the drives in which another name would do as well even without noise."""
    apart = [(k, [p for p in pairs if p[0]["effects"][0].get("separable")]) for k, pairs in kinds]
    return [_row(f"{kind}, separable", pairs) for kind, pairs in apart if pairs]


def _coverage(kind: str, pairs: Sequence[tuple[Record, Score]]) -> Row:
    inside = [i.inside for _, s in pairs for i in s.intervals]
    return [kind, str(len(inside)), *share(inside)]


def _confused(pairs: Sequence[tuple[Record, Score]], title: str, arguments: Sequence[str]) -> list[str]:
    wrong = [(r, s) for r, s in pairs if s.claims or r["effects"] or "error" in r]
    if not wrong:
        return []
    lines = ["", f"{title}: {len(wrong)}"]
    for record, s in sorted(wrong, key=lambda p: str(p[0]["case"])):
        mark = " (right as a class)" if s.exact_class else ""
        lines.append(f"  {record['case']}: {record['verdict']}{mark}")
        lines += [f"    true   {_effect(e)}" for e in record["effects"]]
        lines += [f"    said   {_finding(f)}" for f in record["findings"]] or ["    said   nothing"]
        if "truth_nats" in record:
            lines.append(
                f"    search the true effects, fitted, score {record['truth_nats']:+.1f} nats against what was said"
            )
        if "error" in record:
            lines.append(f"    error  {record['error']}")
        if "drive" in record:
            lines.append(f"    drive  {_plain(record['drive'])}")
        if "stress" in record:
            lines.append(f"    stress {_plain(record['stress'])}")
    lines.append("  Each of them alone:")
    lines.append(f"    python -m drd_tools.trial {shlex.join(arguments)} --only CASE --output DIR")
    return lines


def _effect(effect: dict[str, Any]) -> str:
    text = f"{effect['effect']} ({_plain(effect['parameters'])}"
    if effect.get("visibility") is not None:
        text += f"; d = {effect['visibility']:.1f}"
    if effect.get("rival"):
        text += f"; nearest {effect['rival']}, {effect['margin_nats']:.1f} nats worse without noise"
    return text + ")"


def _finding(finding: dict[str, Any]) -> str:
    evidence = finding["evidence"]
    values = ", ".join(
        f"{name} {q}" if isinstance(q, str) else f"{name} {q['value']:.4g} +- {q['std']:.2g}"
        for name, q in finding["parameters"].items()
    )
    text = f"{finding['effect']} ({values or finding['driver']}) {finding['status']}"
    text += f", {evidence['gain_nats']:.1f} nats, p {evidence['family_wise_p']:.2g}, e {evidence['e_value']:.2g}"
    return text + (f"; also fits {', '.join(finding['also_fits'])}" if finding["also_fits"] else "")


def _plain(values: dict[str, Any]) -> str:
    return ", ".join(
        f"{name} ({_plain(v)})" if isinstance(v, dict) else f"{name} {v:.7g}" if isinstance(v, float) else f"{name} {v}"
        for name, v in values.items()
    )


def _outside(pairs: Sequence[tuple[Record, Score]]) -> list[str]:
    wrong = [(r["case"], i) for r, s in pairs for i in s.intervals if not i.inside]
    if not wrong:
        return []
    head = ["case", "effect", "parameter", "true", "said", "+-", "sigmas"]
    rows = [
        [c, i.effect, i.parameter, f"{i.true:.4g}", f"{i.value:.4g}", f"{i.std:.2g}", f"{i.sigmas:+.1f}"]
        for c, i in sorted(wrong, key=lambda w: -abs(w[1].sigmas))
    ]
    return ["", f"Truth outside of the 90 % interval: {len(wrong)}", *table([head, *rows])]


def _not_made(records: Sequence[Record]) -> list[str]:
    missing = [r["not_made"] for r in records if "not_made" in r]
    return ["", "Not made:", *(f"  {text}" for text in missing)] if missing else []
