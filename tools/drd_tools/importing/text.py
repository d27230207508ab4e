"""Summary of an import as text."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from drd_tools.importing.checks import OK, WRONG, Finding
from drd_tools.importing.matching import Match
from drd_tools.importing.streams import Origin

WIDTH: Final = 116
MARKS: Final = {OK: "ok", WRONG: "WRONG"}
# A shorter standstill does not determine the bias.
LEAST_STANDSTILL_S: Final = 2.0


def summary(
    folder: Path,
    origins: dict[str, Origin],
    findings: Sequence[Finding],
    applied: dict[str, Any],
    after: Match | None,
    stands_s: float,
) -> str:
    """Summary of streams, findings with their evidence, corrections applied, and advice on the rest."""
    lines = ["Streams"]
    for name, o in origins.items():
        rate = "" if o.rate_hz is None else f", {o.rate_hz:.2f} Hz (median)"
        stamps = f"{o.stamps} stamps" if o.stamps in ("header", "receive") else f"time: {o.stamps}"
        lines += _entry(f"  {name:9}  ", f"{o.source}: {o.kind}, {o.rows} rows{rate}, {stamps}")
        for note in o.notes:
            lines += _entry(" " * 13, note)
    lines += ["", "Checks, of the data as the options have them"]
    width = max((len(f.check) for f in findings), default=0)
    for finding in findings:
        mark = MARKS.get(finding.verdict, "?")
        if finding.proposal and set(finding.proposal) <= set(applied["auto"]) and finding.verdict == WRONG:
            mark = "fixed"
        lines += _entry(f"  {mark:5}  {finding.check:{width}}  ", finding.text)
    if not findings:
        lines.append("  none: a single stream cannot be compared with anything")
    lines += [
        "",
        *_entry(
            "Applied: ",
            ", ".join(f"{name} {_shown(value)}" for name, value in applied.items() if value not in (None, [])),
        ),
    ]
    if after is not None:
        text = (
            f"gyro against wheels: correlation {after.correlation:+.3f}, gain {after.gain:.4g} +- "
            f"{after.gain_sigma:.2g}, delay {after.lag_s:+.3f} +- {after.lag_sigma_s:.3f} s"
        )
        lines += _entry("As written: ", text if after.is_clear else f"{text} (not clear)")
    return "\n".join([*lines, *_advice(folder, origins, findings, applied, stands_s)])


def _advice(
    folder: Path, origins: dict[str, Origin], findings: Sequence[Finding], applied: dict[str, Any], stands_s: float
) -> list[str]:
    lines = []
    options = [
        f"--{name} {value if name not in ('sign', 'shift-wheels', 'shift-reference', 'swap') else 'auto'}"
        for finding in findings
        if finding.verdict == WRONG
        for name, value in finding.proposal.items()
        if name not in applied["auto"]
    ]
    if options:
        lines += [
            "",
            *_entry("", f"Not corrected, as the options did not request it: {' '.join(dict.fromkeys(options))}"),
        ]
    if "wheels" in origins and stands_s >= LEAST_STANDSTILL_S and "standstill" not in applied:
        text = f"No wheel moves for the first {stands_s:.1f} s; --standstill states how long the bias may be measured."
        lines += ["", *_entry("", text)]
    if "wheels" not in origins:
        text = "Without wheels it is no recording that `drd replay` reads; fog.csv is a log for `drd calibrate noise`."
        lines += ["", *_entry("", text)]
    else:
        lines += ["", f"Next: drd replay {folder} --output poses.csv"]
    return lines


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return "(" + ", ".join(value) + ")"
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)


def _entry(head: str, text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=head, subsequent_indent=" " * len(head)) or [head.rstrip()]
