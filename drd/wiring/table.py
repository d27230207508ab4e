"""Findings as text for people."""

import textwrap
from collections import Counter
from collections.abc import Sequence

from drd.wiring.findings import Finding, Outcome, faults


def table(findings: Sequence[Finding], width: int = 120) -> str:
    """Aligned: outcome, check, evidence; what to do stands below with an arrow. The last line counts."""
    columns = [max(len(text) for text in texts) for texts in _columns(findings)]
    indent = " " * (sum(columns) + 4)
    room = max(40, width - len(indent))
    lines = []
    for finding in findings:
        head = f"{finding.outcome.value:{columns[0]}}  {finding.check:{columns[1]}}  "
        parts = textwrap.wrap(finding.text, room) + [
            ("-> " if i == 0 else "   ") + part for i, part in enumerate(textwrap.wrap(finding.remedy, room - 3))
        ]
        lines += [(head if i == 0 else indent) + part for i, part in enumerate(parts)]
    counts = Counter(finding.outcome for finding in findings)
    told = ", ".join(f"{counts[outcome]} {outcome.value}" for outcome in Outcome)
    return "\n".join([*lines, "", f"{len(findings)} checks: {told}"])


def _columns(findings: Sequence[Finding]) -> tuple[list[str], list[str]]:
    return [f.outcome.value for f in findings], [f.check for f in findings]


def sentences(findings: Sequence[Finding]) -> list[str]:
    """One line for each fault, for a summary; empty where there is none."""
    return [f"wiring: {f.check}: {f.text}. {f.remedy}" for f in faults(list(findings))]
