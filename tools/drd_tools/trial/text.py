"""A trial as text: its tables, and each failure with truth and findings."""

import shlex
from collections.abc import Mapping, Sequence

import msgspec

from drd_tools.diagnose.results import Amount, Finding
from drd_tools.report.terminal import columns
from drd_tools.trial.figures import Figures, Pair
from drd_tools.trial.results import TrueEffect

PROGRAM = "drd trial"


def text(figures: Figures, arguments: Sequence[str]) -> str:
    """Text of a whole trial. `arguments`: those that draw a case again."""
    lines: list[str] = []
    for made in figures.tables():
        lines += [*([""] if lines else []), made.caption, *columns([made.header, *made.rows])]
    return "\n".join([*lines, *failures(figures, arguments)])


def failures(figures: Figures, arguments: Sequence[str]) -> list[str]:
    """Lines on false alarms, confused effects, truths outside their intervals, and cases that could not be made."""
    nulls, others = figures.of(*figures.null_kinds), figures.of(*figures.named_kinds)
    unknown = figures.of(*figures.unknown_kinds)
    lines = _confused([p for p in nulls if p[1].reports or isinstance(p[0].error, str)], "False alarms")
    lines += _confused([p for p in others if not p[1].exact], "Confused")
    lines += _confused([p for p in unknown if not p[1].flagged], "In no catalogue, and not flagged")
    if lines:
        lines += ["", "Each of them alone:", f"  {PROGRAM} {shlex.join(arguments)} --only CASE --output DIR"]
    lines += _outside(others)
    return lines + (["", "Not made:", *(f"  {r.not_made}" for r in figures.not_made)] if figures.not_made else [])


def _confused(wrong: Sequence[Pair], title: str) -> list[str]:
    if not wrong:
        return []
    lines = ["", f"{title}: {len(wrong)}"]
    for record, s in sorted(wrong, key=lambda p: p[0].case):
        lines.append(f"  {record.case}: {record.verdict}{' (right as a class)' if s.exact_class else ''}")
        lines += [f"    true     {_effect(e)}" for e in record.effects]
        lines += [f"    reported {_finding(f)}" for f in record.findings] or ["    reported nothing"]
        if isinstance(record.truth_nats, float):
            lines.append(
                f"    search   the true effects, fitted, score {record.truth_nats:+.1f} nats against what was found"
            )
        for name in ("drive", "stress"):
            if isinstance(row := getattr(record, name), msgspec.Struct):
                lines.append(f"    {name:<8} {_values(msgspec.structs.asdict(row))}")
        if isinstance(record.error, str):
            lines.append(f"    error    {record.error}")
    return lines


def _effect(true: TrueEffect) -> str:
    line = f"{true.effect} ({_values(true.parameters)}"
    if isinstance(true.detectability, float):
        line += f"; d = {true.detectability:.1f}"
    if isinstance(true.margin_nats, float):
        line += f"; nearest {true.rival or 'without it'}, {true.margin_nats:.1f} nats worse without noise"
    if isinstance(true.ceiling, float):
        line += f"; ceiling {true.ceiling:.3f}, {true.nearest} at d = {true.distance:.1f}"
    return line + ")"


def _finding(finding: Finding) -> str:
    evidence, parameters = finding.evidence, {**finding.choices, **finding.parameters}
    line = f"{finding.effect} ({_values(parameters) or finding.covariate}) {finding.status}"
    line += f", {finding.gain_nats:.1f} nats"
    for name, number in (("p", evidence.family_wise_p), ("e", evidence.e_value)):
        line += "" if number is None else f", {name} {number:.2g}"
    return line + (f"; also fits {', '.join(finding.also_fits)}" if finding.also_fits else "")


def _values(values: Mapping[str, object]) -> str:
    def shown(value: object) -> str:
        if isinstance(value, Amount):
            return f"{value.value:.4g} +- {value.std:.2g}"
        return f"{value:.7g}" if isinstance(value, float) else str(value)

    return ", ".join(f"{name} {shown(value)}" for name, value in values.items())


def _outside(pairs: Sequence[Pair]) -> list[str]:
    wrong = [(r.case, i) for r, s in pairs for i in s.intervals if not i.inside]
    if not wrong:
        return []
    head = ["case", "effect", "parameter", "true", "estimate", "+-", "sigmas"]
    rows = [
        [c, i.effect, i.parameter, f"{i.true:.4g}", f"{i.value:.4g}", f"{i.std:.2g}", f"{i.sigmas:+.1f}"]
        for c, i in sorted(wrong, key=lambda w: -abs(w[1].sigmas))
    ]
    return ["", f"Truth outside of the 90 % interval: {len(wrong)}", *columns([head, *rows])]
