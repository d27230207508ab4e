"""A trial as text: its tables, and each failure with what is true and what was said."""

import shlex
from collections.abc import Sequence
from typing import Any

from drd_tools.trial.figures import Figures, Pair, Row

PROGRAM = "drd trial"


def told(figures: Figures, arguments: Sequence[str]) -> str:
    """All of a trial. `arguments`: those with which a case is drawn again."""
    lines: list[str] = []
    for made in figures.tables():
        lines += [*([""] if lines else []), made.caption, *table([made.header, *made.rows])]
    return "\n".join([*lines, *failures(figures, arguments)])


def failures(figures: Figures, arguments: Sequence[str]) -> list[str]:
    """False claims, what was confused, what is outside of its interval, and what could not be made."""
    nulls, others = figures.of(*figures.null_kinds), figures.of(*figures.named_kinds)
    unknown = figures.of(*figures.unknown_kinds)
    lines = _confused([p for p in nulls if p[1].claims or "error" in p[0]], "False claims")
    lines += _confused([p for p in others if not p[1].exact], "Confused")
    lines += _confused([p for p in unknown if not p[1].flagged], "In no catalogue, and not flagged")
    if lines:
        lines += ["", "Each of them alone:", f"  {PROGRAM} {shlex.join(arguments)} --only CASE --output DIR"]
    return [*lines, *_outside(others), *_not_made(figures)]


def table(rows: Sequence[Row]) -> list[str]:
    """Aligned columns; the first to the left, others to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  " + "  ".join(c.ljust(w) if not i else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in rows
    ]


def _confused(wrong: Sequence[Pair], title: str) -> list[str]:
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
        lines += [f"    {name:<6} {_plain(record[name])}" for name in ("drive", "stress") if name in record]
        if "error" in record:
            lines.append(f"    error  {record['error']}")
    return lines


def _effect(effect: dict[str, Any]) -> str:
    text = f"{effect['effect']} ({_plain(effect['parameters'])}"
    if effect.get("visibility") is not None:
        text += f"; d = {effect['visibility']:.1f}"
    if "margin_nats" in effect:
        text += f"; nearest {effect['rival'] or 'without it'}, {effect['margin_nats']:.1f} nats worse without noise"
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


def _outside(pairs: Sequence[Pair]) -> list[str]:
    wrong = [(r["case"], i) for r, s in pairs for i in s.intervals if not i.inside]
    if not wrong:
        return []
    head = ["case", "effect", "parameter", "true", "said", "+-", "sigmas"]
    rows = [
        [c, i.effect, i.parameter, f"{i.true:.4g}", f"{i.value:.4g}", f"{i.std:.2g}", f"{i.sigmas:+.1f}"]
        for c, i in sorted(wrong, key=lambda w: -abs(w[1].sigmas))
    ]
    return ["", f"Truth outside of the 90 % interval: {len(wrong)}", *table([head, *rows])]


def _not_made(figures: Figures) -> list[str]:
    return ["", "Not made:", *(f"  {r['not_made']}" for r in figures.not_made)] if figures.not_made else []
