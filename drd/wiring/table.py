"""Findings as text for people."""

import textwrap
from collections import Counter
from collections.abc import Sequence

from drd.wiring.findings import Finding, Outcome, faults


def table(findings: Sequence[Finding], width: int = 120) -> str:
    """Findings as aligned text: outcome, check, evidence; below, with an arrow, what to do. The last line counts."""
    outcome_width, check_width = max(len(f.outcome.value) for f in findings), max(len(f.check) for f in findings)
    indent = " " * (outcome_width + check_width + 4)
    room = max(40, width - len(indent))
    lines = []
    for finding in findings:
        head = f"{finding.outcome.value:{outcome_width}}  {finding.check:{check_width}}  "
        parts = textwrap.wrap(finding.text, room)
        parts += textwrap.wrap(finding.remedy, room, initial_indent="-> ", subsequent_indent="   ")
        lines += [(head if i == 0 else indent) + part for i, part in enumerate(parts)]
    counts = Counter(finding.outcome for finding in findings)
    told = ", ".join(f"{counts[outcome]} {outcome.value}" for outcome in Outcome)
    return "\n".join([*lines, "", f"{len(findings)} checks: {told}"])


def sentences(findings: Sequence[Finding]) -> list[str]:
    """One line for each fault, for a summary; empty where there is none."""
    return [f"wiring: {f.check}: {f.text}. {f.remedy}" for f in faults(findings)]
